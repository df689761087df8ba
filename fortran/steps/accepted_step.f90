! The output of an accepted step: its interpolant, whose nodes are requested one after the other,
! events, points at output times, and its end, where the next step starts, or after a jump.
module accepted_step_m
  use kinds, only: wp
  use blocks_m, only: combine_flows
  use collocation_m, only: keep_step
  use controller_m, only: resolution
  use free_motion_m, only: add_constraint_forces
  use interpolant_m, only: add_node, begin_interpolant, flows_of_evaluation, make_cubic, next_node
  use linear_action_m, only: move_polynomially
  use output_m, only: output_t, store_interpolant, store_point, store_step
  use step_events_m, only: ends_step, find_zeros, store_zeros
  use requests_m, only: evaluate_events, reject_accepted_step, request, share, within_segment
  use phases_m
  use trajectory_m, only: fail, forget_step, last_step_times_t, point_at, time_at, trajectory_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: callback_block, collocation_kind, jumps_without_progress, no_stop, &
                            observer_failed, paused, polynomial_kind, registers_kind, &
                            splitting_kind, step_too_long, terminal_event
  use vectors_m, only: finite, nan
  use zero_finding_m, only: crosses
  implicit none
  private
  public :: complete_step, detect_events, examine_step, prepare_inner, &
            request_ends, request_node, receive_end, receive_node, store_output

  ! consecutive jumps, each within ten resolutions of time, above which they count as endless
  integer, parameter :: max_jumps_in_place = 20
  ! a value of an event's function that counts as zero, relative to its values at both ends
  real(wp), parameter :: small_value = 1e-9_wp

contains

  ! Starts the interpolant of an accepted step if there are output times in it, or functions whose
  ! zeros are events. Where such a function has another sign at the end of the step, or the step
  ! starts from its zero, the accurate interpolant is needed in any case.
  subroutine examine_step(x, output)
    type(trajectory_t), target, intent(inout) :: x
    type(output_t), intent(in) :: output

    if (size(x%events) > 0) then
      call evaluate_events(x, 0, 1.0_wp, x%events%at_end)
      if (x%status /= no_stop) return
    end if
    x%counts%steps = x%counts%steps + 1
    x%grid%done = x%grid%done + 1
    x%phase = phase_complete_step
    x%interpolant%needed = size(x%events) == 0 .and. has_output(x, output)
    if (size(x%events) > 0) x%interpolant%needed = any(x%events%sign_before /= 0 .or. &
      (crosses(x%events%at_start, x%events%at_end, x%problem%events%table) .and. &
       (x%events%at_end /= 0 .or. &
        (x%problem%record%goes_on .and. ends_step(x%events, x%problem%events%table)))))
    if (x%interpolant%needed .or. size(x%events) > 0) call request_ends(x)
  end subroutine examine_step

  ! Whether there is output before the end of the step
  pure logical function has_output(x, output)
    type(trajectory_t), intent(in) :: x
    type(output_t), intent(in) :: output

    has_output = output%record%dense
    if (x%outputs_passed < output%outputs) has_output = has_output .or. &
        (output%times(x%outputs_passed + 1) - x%t_end) * sign(1.0_wp, x%h) < 0
  end function has_output

  ! Completes the interpolant of a step if a function changes its sign along the cubic, or for the
  ! output. Zeros just at the end of the step don't need it. Events are sought along the cubic first
  ! where there is output too, so that output doesn't change which are found.
  subroutine detect_events(x, output)
    type(trajectory_t), intent(inout) :: x
    type(output_t), intent(in) :: output
    integer :: k

    call find_zeros(x)
    if (.not. allocated(x%zeros)) return     ! values are requested, or the step isn't accepted
    x%phase = phase_complete_step
    x%interpolant%needed = .false.
    ! a stepper may interpolate in a step that an event ends
    do k = 1, size(x%zeros)
      associate (zero => x%zeros(k), i => x%zeros(k)%event)
        if (zero%theta < 1 .or. x%events(i)%at_end /= 0 .or. (x%problem%record%goes_on .and. &
            ends_step(x%events(i), x%problem%events%table(i)))) x%interpolant%needed = .true.
      end associate
    end do
    if (x%interpolant%needed) deallocate (x%zeros)         ! they aren't accurate
    x%interpolant%needed = x%interpolant%needed .or. has_output(x, output)
    if (x%interpolant%needed .and. x%status == no_stop) call interpolate(x)
  end subroutine detect_events

  ! Finds the events of a step. Trajectories with common steps then accept it together.
  subroutine complete_step(x, output)
    type(trajectory_t), intent(inout) :: x
    type(output_t), intent(in) :: output

    if (size(x%events) > 0 .and. .not. (x%last%requested .or. allocated(x%zeros))) then
      call find_zeros(x)
      if (x%status /= no_stop .or. .not. allocated(x%zeros)) return
    end if
    x%phase = phase_store_output
    if (x%last%requested) return
    if (x%problem%adaptive .and. x%problem%record%common .and. (size(x%events) > 0 .or. &
        output%record%dense .or. output%outputs > 0)) call share(x, 0.0_wp, phase_step_shared)
  end subroutine complete_step

  ! Requests unknown coefficients at the ends of a step, then starts its interpolant.
  subroutine request_ends(x)
    type(trajectory_t), intent(inout) :: x

    if (x%last%requested .and. .not. finite(size(x%last%slope), x%last%slope)) then
      call request(x, x%last%start, x%last%y, phase_interpolant_start_received)
    else if (.not. (x%last%requested .or. x%slope_known)) then
      call request(x, x%t, x%y(:, 0), phase_interpolant_start_received)
    else if (x%end_known) then
      call interpolate(x)
    else if (x%last%requested) then
      call request(x, x%t, x%y(:, 0), phase_end_received)
    else
      call request(x, x%t_end, x%y(:, x%result), phase_end_received)
    end if
  end subroutine request_ends

  ! Stores the coefficients at an end of a step; with both ends its interpolant starts.
  subroutine receive_end(x)
    type(trajectory_t), intent(inout) :: x

    associate (begins => x%phase == phase_interpolant_start_received)
      if (begins .and. x%last%requested) then
        x%last%slope(:) = x%request%answer
      else if (begins) then
        x%slope(:) = x%request%answer
        x%slope_known = .true.
      else
        x%end_slope(:) = x%request%answer
        x%end_known = .true.
        x%slope_known = x%slope_known .or. (x%last%requested .and. x%t == x%request%t)
        if (x%last%requested) x%slope(:) = x%end_slope
      end if
      if (begins) then
        call request_ends(x)
      else
        call interpolate(x)
      end if
    end associate
  end subroutine receive_end

  ! Starts the interpolant of the present step, or of the last one, whose end is the present point.
  ! If only events may need it, they are sought first along the cubic through the ends.
  subroutine interpolate(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists
    integer :: status

    associate (self => x%interpolant)
      self%noisy = x%problem%record%heated
      if (x%last%requested) then
        self%t0 = x%last%t
        self%h = x%last%h
        self%y0(:) = x%last%y
        self%y1(:) = x%y(:, 0)
        self%vectors(:, 1) = x%last%slope
      else
        self%t0 = x%t
        self%h = x%t_end - x%t
        self%y0(:) = x%y(:, 0)
        self%y1(:) = x%y(:, x%result)
        self%vectors(:, 1) = x%slope
      end if
      self%vectors(:, 2) = x%end_slope
      if (size(x%joints%impulse) > 0) then   ! slopes are forces alone
        call add_constraint_forces(x%frame, self%y0, .true., self%vectors(:, 1), status)
        if (status == no_stop) &
          call add_constraint_forces(x%frame, self%y1, .true., self%vectors(:, 2), status)
        if (status /= no_stop) then
          call fail(x, status, self%t0)
          return
        end if
      end if
    end associate
    if (any(x%frame%blocks%kind == callback_block)) &
      x%interpolant%step_flows = flows_of_step(x, x%interpolant%h)
    call begin_interpolant(logical(x%problem%record%unique_flows), x%f, x%interpolant, exists)
    if (x%interpolant%needed .or. x%last%requested .or. x%interpolant%complete) then
      call advance_interpolant(x, exists)
    else
      call make_cubic(exists, x%interpolant)
      x%phase = phase_detect_events
    end if
  end subroutine interpolate

  ! The flows of a step of a frame in Python; none of a method that doesn't keep what they combine
  function flows_of_step(x, h) result(flows)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: h
    real(wp), allocatable :: flows(:), v(:, :)         ! v: coefficients of all flows
    integer :: path

    allocate (flows(0))
    if (x%method%kind == registers_kind .or. x%method%kind == splitting_kind) return
    allocate (v(size(x%f, 1), size(x%method%flows%first) - 1))
    call combine_flows(x%method%flows, h * x%method%flows%weight, 1, size(v, 2), size(v, 1), x%f, v)
    path = x%method%result
    do while (path > 0)
      flows = [v(:, x%method%path_first(path):x%method%path_first(path + 1) - 1), flows]
      path = x%method%origin(path)
    end do
  end function flows_of_step

  ! Chooses the phase after a node of the interpolant.
  subroutine advance_interpolant(x, exists)
    type(trajectory_t), intent(inout) :: x
    logical, intent(in) :: exists

    x%counts%nexp = x%counts%nexp + int(x%interpolant%nexp, int64)
    x%interpolant%nexp = 0
    if (.not. exists) then
      call reject_accepted_step(x, step_too_long, x%interpolant%t0)
    else
      x%phase = merge(phase_complete_step, phase_next_node, x%interpolant%complete)
    end if
  end subroutine advance_interpolant

  ! Requests the coefficients at the next node of the interpolant.
  subroutine request_node(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: theta

    call next_node(x%interpolant, theta)
    x%counts%nexp = x%counts%nexp + int(flows_of_evaluation(x%interpolant), int64)
    call request(x, x%interpolant%t0 + theta * x%interpolant%h, &
                 x%interpolant%y, phase_node_received)
  end subroutine request_node

  ! Adds the coefficients at the node to the interpolant.
  subroutine receive_node(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    call add_node(x%request%answer, x%interpolant, exists)
    call advance_interpolant(x, exists)
  end subroutine receive_node

  ! Stores the output of a step, up to the first event that ends it, and starts the next step.
  subroutine store_output(x, output)
    type(trajectory_t), target, intent(inout) :: x
    type(output_t), intent(inout) :: output
    real(wp) :: theta_end                    ! where an event ends the step, as a fraction of it
    logical :: by_event                      ! whether an event ended the step

    if (x%last%requested) then
      call store_interpolant(output, x%member, x%t, x%interpolant)
      x%last%requested = .false.
      x%phase = phase_choose_step
      x%status = merge(paused, output%status, output%status == no_stop)
      return
    end if
    by_event = .false.
    if (allocated(x%zeros)) then
      ! the interpolant has all its nodes, so that their memory is free
      call store_zeros(x, output, theta_end, by_event, x%interpolant%y)
      if (x%status /= no_stop) return
      deallocate (x%zeros)
    end if
    if (by_event) then
      call store_until(x, time_at(x, theta_end), x%interpolant%y, by_event, output)
    else
      call store_until(x, x%t_end, x%y(:, x%result), by_event, output)
    end if
  end subroutine store_output

  ! Stores the output of a step up to time t, where the solution is y.
  subroutine store_until(x, t, y, by_event, output)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    logical, intent(in) :: by_event                    ! whether an event ended the step
    type(output_t), intent(inout) :: output
    logical :: last

    call store_outputs(x, t, y, output)
    if (output%record%dense) call store_interpolant(output, x%member, t, x%interpolant)
    last = by_event .or. t == x%problem%stops(size(x%problem%stops))
    if (output%status == no_stop) call store_step(output, x%counts%steps, t, y, last)
    if (output%status /= no_stop) then
      call fail(x, output%status, t, observer_failed)
      return
    end if
    if (size(x%last%y) > 0) then
      x%last%last_step_times_t = last_step_times_t( &
        cut=by_event, t=x%t, h=x%t_end - x%t, start=within_segment(x, x%t))
      x%last%y(:) = x%y(:, 0)
      x%last%slope(:) = x%slope
      if (.not. x%slope_known) x%last%slope = nan
    end if
    call begin_next_step(x, t, y, by_event)
  end subroutine store_until

  ! Starts the next step at y, after a jump or at a breakpoint without memory, or ends.
  subroutine begin_next_step(x, t, y, by_event)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    logical, intent(in) :: by_event
    logical :: at_stop, jumps                          ! whether f or the solution may jump

    at_stop = t == x%problem%stops(x%segment)
    jumps = by_event .or. (at_stop .and. x%segment < size(x%problem%stops))
    if (abs(t - x%t) > 10 * resolution(t)) x%jumps_in_place = 0
    if (by_event) then
      x%jumps_in_place = x%jumps_in_place + 1
      x%events%zero_tolerance = max( &
        small_value * max(abs(x%events%at_start), abs(x%events%at_end)), 2 * abs(x%events%residual))
    end if
    ! not before, since a step that is too long for events is tried again
    if (x%problem%adaptive .and. x%method%uses_last_nodes) then
      x%estimate%f_before(:, :) = x%f
      x%estimate%h_before = x%h
    end if
    if (x%method%kind == collocation_kind) call keep_step(x)
    x%t = t
    x%y(:, 0) = y
    x%phase = merge(phase_begin_segment, phase_choose_step, at_stop)
    x%slope_known = x%end_known .and. .not. jumps
    if (x%slope_known) x%slope(:) = x%end_slope
    if (jumps) call forget_step(x, near=.false.)
    if (.not. by_event) then
      x%events%at_start = x%events%at_end
    else if (any(x%events%count >= x%problem%events%table%limit) &
             .and. .not. x%problem%record%goes_on) then
      x%phase = phase_ended
      x%status = terminal_event
    else if (x%jumps_in_place > max_jumps_in_place) then
      call fail(x, jumps_without_progress, t)
    else
      x%events_known = .false.
      x%control%step_size = 0.0_wp
      x%control%last_error = 1.0_wp
      x%phase = phase_begin_segment
      if (.not. any(x%events%count >= x%problem%events%table%limit)) return
      x%status = terminal_event                        ! a stepper goes on after it
      where (x%events%count >= x%problem%events%table%limit) x%events%count = 0
    end if
  end subroutine begin_next_step

  ! Stores the points at the output times up to t, where the solution is y.
  subroutine store_outputs(x, t, y, output)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    type(output_t), intent(inout) :: output

    associate (point => x%point, passed => x%outputs_passed, inner => x%problem%inner)
      do while (passed < output%outputs)
        associate (time => output%times(passed + 1))
          if ((time - t) * sign(1.0_wp, x%h) > 0) return
          if (time == t) then
            point = y
          else if (x%method%kind == polynomial_kind) then
            call compute_next_output(x, output)
            point = inner%y(:, passed + 1 - inner%passed)
          else
            call point_at(x, (time - x%t) / (x%t_end - x%t), point)
            x%counts%nexp = x%counts%nexp + int(flows_of_evaluation(x%interpolant), int64)
          end if
        end associate
        passed = passed + 1
        call store_point(output, x%member, passed, point)
        if (output%status /= no_stop) return
      end do
    end associate
  end subroutine store_outputs

  ! Lets the next flow along a polynomial compute points at as many output times as have room.
  subroutine prepare_inner(x, output)
    type(trajectory_t), intent(inout) :: x
    type(output_t), intent(in) :: output
    integer :: count

    count = min(size(x%problem%inner%theta), output%outputs - x%outputs_passed)
    associate (inner => x%problem%inner, &
               times => output%times(x%outputs_passed + 1:x%outputs_passed + count))
      inner%owner = x%member
      inner%passed = x%outputs_passed
      inner%theta(:count) = (times - x%t) / (x%t_end - x%t)      ! may round to 1 before the end
      inner%count = findloc([(times - x%t_end) * sign(1.0_wp, x%h) < 0, .false.], .false., 1) - 1
    end associate
  end subroutine prepare_inner

  ! Computes the point at the next output time, along a polynomial, unless it is known.
  subroutine compute_next_output(x, output)
    type(trajectory_t), intent(inout) :: x
    type(output_t), intent(in) :: output

    associate (point => x%point, inner => x%problem%inner, &
               first => x%method%path_first(x%method%result), &
               last => x%method%path_first(x%method%result + 1) - 1)
      ! members with common steps may have prepared points of theirs in the meantime
      if (inner%owner == x%member .and. x%outputs_passed - inner%passed < inner%count) return
      call prepare_inner(x, output)
      point = x%y(:, 0)
      call combine_flows(x%method%flows, x%weight, first, last, size(x%f, 1), x%f, x%v)
      call move_polynomially(x%frame%blocks(1)%action, x%v(:, :last - first + 1), 0.0_wp, point, &
                             inner)
      x%counts%nexp = x%counts%nexp + 1
    end associate
  end subroutine compute_next_output

end module accepted_step_m
