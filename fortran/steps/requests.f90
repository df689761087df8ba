! Requests of a trajectory for coefficients of the right-hand side and for values of events. If the
! problem has a field, `request` calls it at once; otherwise the loop returns with the request and
! is called again with the answer, so that one call can answer many trajectories.
module requests_m
  use kinds, only: wp
  use controller_m, only: rejected_size
  use frames_m, only: complete_coefficients
  use free_motion_m, only: add_free_motion, take_forces
  use shared_numbers, only: field_not_finite, finished, needs_field, needs_maximum, raised, &
                            raised_in_python, stage_not_finite, stopped_by_field
  use phases_m
  use trajectory_m, only: fail, problem_t, trajectory_t
  use vectors_m, only: finite
  implicit none
  private
  public :: check_coefficients, evaluate_at_start, evaluate_events, reject_stage, request, within_segment

contains

  ! The time at which the right-hand side is evaluated in place of t. Times at breakpoints, where it
  ! may change, are moved into the segment.
  pure elemental real(wp) function within_segment(problem, trajectory, t)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory
    real(wp), intent(in) :: t
    real(wp) :: direction

    within_segment = t
    direction = sign(1.0_wp, trajectory%h)
    associate (stops => problem%stops, i => trajectory%segment)
      if (i > 1) then
        if ((t - stops(i - 1)) * direction <= 0) within_segment = nearest(stops(i - 1), direction)
      end if
      if (i < size(stops)) then
        if ((t - stops(i)) * direction >= 0) within_segment = nearest(stops(i), -direction)
      end if
    end associate
  end function within_segment

  ! Requests the coefficients at a point, for the phase `next`.
  subroutine request(problem, trajectory, t, y, next)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    integer, intent(in) :: next                        ! phase

    trajectory%request%t = within_segment(problem, trajectory, t)
    trajectory%phase = next
    trajectory%status = needs_field
    trajectory%counts%nfev = trajectory%counts%nfev + 1
    trajectory%request%y(:) = y
    if (.not. associated(problem%field)) return
    problem%field%member = trajectory%member
    call problem%field%coefficients(problem%frame%point_size, problem%frame%dimension, &
                                    trajectory%request%t, trajectory%request%y, &
                                      trajectory%request%received, trajectory%request%flag)
    call check_coefficients(problem, trajectory, y)
  end subroutine request

  ! Checks the answer to a request: finite coefficients go to the next phase, others are a failure.
  ! Of mechanical systems the answer is forces; splitting methods take them alone.
  subroutine check_coefficients(problem, trajectory, y)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) where f was evaluated

    if (trajectory%request%flag == 0) then
      if (problem%frame%forces > 0) then
        call take_forces(problem%frame, y, trajectory%request%received)
        if (.not. problem%method%splitting) &
          call add_free_motion(problem%frame, y, trajectory%request%received)
      end if
      call complete_coefficients(problem%frame, y, trajectory%request%received)
      if (finite(trajectory%request%received)) then
        trajectory%status = finished
        return
      end if
    end if
    if (trajectory%request%flag == raised_in_python) then
      call fail(trajectory, raised, trajectory%request%t)
    else if (.not. finite(y)) then
      call reject_stage(problem, trajectory, stage_not_finite, trajectory%request%t)
    else if (trajectory%request%flag /= 0) then
      call fail(trajectory, stopped_by_field, trajectory%request%t)
    else
      call fail(trajectory, field_not_finite, trajectory%request%t)
    end if
  end subroutine check_coefficients

  ! Tries a step again with a smaller size after a stage that doesn't exist; equal steps fail.
  subroutine reject_stage(problem, trajectory, status, t)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    if (.not. problem%adaptive) then
      call fail(trajectory, status, t)
      return
    end if
    select case (trajectory%phase)
    case (phase_curvature_received)
      trajectory%request%received = huge(1.0_wp)               ! choose_first_size keeps the guess
      trajectory%status = finished
    case (phase_stage_received, phase_next_stage, phase_finish_step, phase_error_received)
      trajectory%error = huge(1.0_wp)
      trajectory%request%shared = trajectory%error
      trajectory%status = finished
      trajectory%phase = phase_decide_step
      if (problem%common) trajectory%status = needs_maximum
    case (phase_node_received)
      ! the step is accurate, but too long for its interpolant
      if (trajectory%interpolate_only .or. problem%common) then
        call fail(trajectory, status, t)
        return
      end if
      trajectory%counts%steps = trajectory%counts%steps - 1
      trajectory%counts%nrejected = trajectory%counts%nrejected + 1
      trajectory%control%after_rejection = .true.
      trajectory%control%step_size = rejected_size(abs(trajectory%h), huge(1.0_wp), &
                                           problem%tolerances%exponent)
      trajectory%status = finished
      trajectory%phase = phase_choose_step
    case default
      call fail(trajectory, status, t)
    end select
  end subroutine reject_stage

  ! Evaluates the functions of all events at a point; the trajectory fails if one of them does.
  subroutine evaluate_events(problem, trajectory, t, y, values, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(inout) :: values(:)               ! (events)
    logical, intent(out) :: stopped
    integer :: i

    stopped = .false.
    do i = 1, size(values)
      call problem%events%value(trajectory%member, i, t, y, values(i), stopped)
      if (.not. stopped) cycle
      call fail(trajectory, raised, t)
      return
    end do
  end subroutine evaluate_events

  ! Evaluates the functions of all events at the start of a step. Where an event has just happened,
  ! or a jump has left its function at zero, this zero isn't another event.
  subroutine evaluate_at_start(problem, trajectory, t, y, small, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(in) :: small(:)                   ! (events) values that count as zero
    logical, intent(out) :: stopped
    real(wp) :: values(size(small))

    call evaluate_events(problem, trajectory, t, y, values, stopped)
    if (stopped) return
    associate (events => trajectory%events)
      events%before = values
      where (events%came_from /= 0 &
             .and. abs(values) <= max(small, epsilon(t) * maxval(abs(y(:problem%events%width)))))
        events%before = 0.0_wp
        events%value_after = values
      elsewhere
        events%came_from = 0
      end where
    end associate
  end subroutine evaluate_at_start

end module requests_m
