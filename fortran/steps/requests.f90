! Requests of a trajectory for coefficients of the right-hand side and for values of events. A
! right-hand side of one point is called at once; for a vectorized one the loop returns with the
! request and is called again with the answer, so that one call can answer many trajectories.
! Vectorized events are requested likewise; a phase that needs their values begins again with them.
module requests_m
  use kinds, only: wp
  use free_motion_m, only: complete_forces
  use controller_m, only: rejected_size
  use derivatives_m, only: coefficients_of
  use shared_numbers, only: joints_not_solved, needs_events, needs_maximum, needs_rhs, no_stop, &
                            out_of_memory, raised, raised_in_python, rhs_not_finite, &
                            splitting_kind, stage_not_finite, stopped_by_rhs
  use phases_m
  use trajectory_m, only: fail, point_at, query_event, query_numbers, query_theta, query_time, &
                          time_at, trajectory_t
  use inputs_m, only: evaluate_rhs
  use vectors_m, only: add_columns, copy, finite
  implicit none
  private
  public :: check_coefficients, evaluate_at_start, evaluate_events, reject_accepted_step, &
            reject_stage, request, retry_step, share, share_error, within_segment

contains

  ! The time t, moved into the segment from a breakpoint, where the right-hand side may change
  pure elemental real(wp) function within_segment(x, t)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: t
    real(wp) :: direction

    within_segment = t
    direction = sign(1.0_wp, x%h)
    associate (stops => x%problem%stops, i => x%segment)
      if (i > 1) then
        if ((t - stops(i - 1)) * direction <= 0) within_segment = nearest(stops(i - 1), direction)
      end if
      if (i < size(stops)) then
        if ((t - stops(i)) * direction >= 0) within_segment = nearest(stops(i), -direction)
      end if
    end associate
  end function within_segment

  ! Requests the coefficients at a point, for the phase `next`. A compiled function gets the copy
  ! of the point, which it may overwrite.
  subroutine request(x, t, y, next)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: t, y(x%frame%point_size)
    integer, intent(in) :: next                        ! phase

    x%request%t = t
    if (size(x%problem%stops) > 1) x%request%t = within_segment(x, t)
    x%phase = next
    x%status = needs_rhs
    x%counts%nfev = x%counts%nfev + 1
    call copy(size(y), y, x%request%y)
    if (x%problem%record%vectorized) return
    x%problem%rhs%member = x%member
    if (x%frame%derivatives) then
      call evaluate_rhs(x%problem%rhs, size(y), size(y), x%request%t, x%request%y, &
                        x%request%slope, x%request%detail)
      call coefficients_of(x%frame, x%request%t, y, x%request%slope, x%request%answer)
    else
      call evaluate_rhs(x%problem%rhs, size(y), x%frame%dimension, x%request%t, x%request%y, &
                        x%request%answer, x%request%detail)
    end if
    call check_coefficients(x, y)
  end subroutine request

  ! Checks the answer to a request: finite coefficients go to the next phase, others reject the
  ! step. Answers of mechanical systems are forces; splitting methods take them alone.
  subroutine check_coefficients(x, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: y(x%frame%point_size)
    logical :: splits
    integer :: status

    associate (f => x%request%answer, code => x%request%detail)
      if (code == 0 .and. x%frame%forces > 0 .and. x%frame%tangents == 0) then
        splits = x%method%kind == splitting_kind
        ! splitting methods add impulses of joints to kicks, their interpolants need the forces
        call complete_forces(x%frame, y, splits, .not. splits .or. x%phase == phase_node_received, &
                             f, status)
        if (status == joints_not_solved) call reject_stage(x, status, x%request%t)
        if (all(status /= [no_stop, joints_not_solved])) call fail(x, status, x%request%t)
        if (status /= no_stop) return
      end if
      if (code == 0 .and. finite(size(f), f)) then
        x%status = no_stop
      else if (code == raised_in_python) then
        call fail(x, raised, x%request%t)
      else if (.not. finite(size(y), y)) then
        call reject_stage(x, stage_not_finite, x%request%t)
      else if (code /= 0) then
        call fail(x, stopped_by_rhs, x%request%t)
      else
        call reject_stage(x, rhs_not_finite, x%request%t)
      end if
    end associate
  end subroutine check_coefficients

  ! Tries a smaller step after a stage that doesn't exist or isn't finite; equal steps fail.
  subroutine reject_stage(x, status, t)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    if (any(x%phase == [phase_node_received, phase_end_received])) then
      call reject_accepted_step(x, status, t)
    else if (x%phase == phase_curvature_received) then
      x%request%answer = huge(1.0_wp)               ! choose_first_size keeps the guess
      x%status = no_stop
    else if (x%problem%adaptive .and. any(x%phase == [ &
             phase_stage_received, phase_next_stage, phase_finish_step, phase_error_received])) then
      x%status = no_stop
      call share_error(x, huge(1.0_wp))
    else
      call fail(x, status, t)
    end if
  end subroutine reject_stage

  ! Tries an accurate step again that is too long for output; equal and past steps fail.
  subroutine reject_accepted_step(x, status, t)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    x%status = no_stop
    if (x%last%requested .or. .not. x%problem%adaptive) then
      if (.not. x%last%requested) x%counts%steps = x%counts%steps - 1
      call fail(x, status, t)
    else if (x%problem%record%common) then
      x%estimate%error = huge(1.0_wp)
      call share(x, 1.0_wp, phase_step_shared)
    else
      call retry_step(x)
    end if
  end subroutine reject_accepted_step

  ! Tries an accurate step again with a smaller size.
  subroutine retry_step(x)
    type(trajectory_t), intent(inout) :: x

    x%counts%steps = x%counts%steps - 1
    x%counts%nrejected = x%counts%nrejected + 1
    x%control%after_rejection = .true.
    x%control%step_size = rejected_size(abs(x%h), huge(1.0_wp), x%tolerances%exponent)
    x%phase = phase_choose_step
    if (allocated(x%zeros)) deallocate (x%zeros)
  end subroutine retry_step

  ! Goes to the phase `next` with a number; trajectories with common steps get their largest number.
  ! They share step sizes with a negative sign, since the smallest size counts.
  subroutine share(x, number, next)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: number
    integer, intent(in) :: next                        ! phase

    x%request%shared = number
    x%phase = next
    if (x%problem%record%common) x%status = needs_maximum
  end subroutine share

  ! Sets the error of a step, huge if it isn't finite, and shares it.
  subroutine share_error(x, error)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: error

    x%estimate%error = merge(error, huge(error), error < huge(error))
    call share(x, x%estimate%error, phase_decide_step)
  end subroutine share_error

  ! Evaluates the function of an event at a fraction theta of the step, or for event 0 those of all
  ! events. Vectorized functions are requested, and values taken from the answer once it is there.
  ! The trajectory fails if a function does.
  subroutine evaluate_events(x, event, theta, values)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), intent(in) :: theta
    real(wp), intent(inout) :: values(:)               ! (1) or (events)
    logical :: failed
    integer :: alloc_status, i, k

    k = 0
    associate (query => x%queries%columns(:, :x%queries%answered), &
               offset => query_numbers + x%frame%point_size + max(event, 1) - 1)
      if (x%queries%answered > 0) k = findloc( &
        nint(query(query_event, :)) == event .and. query(query_theta, :) == theta, .true., 1)
      if (k > 0) then
        values = query(offset + 1:offset + size(values), k)
        if (.not. all(abs(values) <= huge(values))) call fail(x, raised, query(query_time, k))
        return
      end if
    end associate
    associate (y => x%point, t => time_at(x, theta), queries => x%queries)
      call point_at(x, theta, y)
      if (x%problem%events%vectorized) then
        if (queries%count == size(queries%columns, 2)) &
          call add_columns(queries%columns, 1, alloc_status)
        if (queries%count == size(queries%columns, 2)) then
          call fail(x, out_of_memory, t)
          return
        end if
        queries%count = queries%count + 1
        queries%columns(:query_numbers + size(y), queries%count) = [ &
          real(event, wp), theta, t, real(x%member - 1, wp), y]
        x%status = needs_events
        return
      end if
      do i = 1, size(values)
        call x%problem%events%value(x%member, max(event - 1, 0) + i, t, y, values(i), failed)
        if (failed) call fail(x, raised, t)
        if (failed) return
      end do
    end associate
  end subroutine evaluate_events

  ! Evaluates the functions of all events at the start of a step. A zero where an event has just
  ! happened, or where a jump has left its function, isn't another event.
  subroutine evaluate_at_start(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: values(size(x%events)), smallest

    call evaluate_events(x, 0, 0.0_wp, values)
    if (x%status /= no_stop) return
    smallest = epsilon(1.0_wp) * maxval(abs(x%y(:x%problem%events%width, 0)))
    x%events_known = .true.
    x%events%at_start = values
    where (x%events%sign_before /= 0 .and. abs(values) <= max(x%events%zero_tolerance, smallest))
      x%events%at_start = 0.0_wp
      x%events%residual = values
    elsewhere
      x%events%sign_before = 0
    end where
    x%events%zero_tolerance = 8 * abs(x%events%residual)
  end subroutine evaluate_at_start

end module requests_m
