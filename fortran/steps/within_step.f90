! The interpolant of a step of a trajectory.
! Its nodes are requested one after the other, until it is complete.
module within_step_m
  use kinds, only: wp
  use free_motion_m, only: add_free_motion
  use flow_interpolant_m, only: reserve_interpolant, set_ends
  use interpolant_m, only: add_node, begin_interpolant, evaluate_interpolant, &
                           flows_of_evaluation, make_cubic, next_node
  use requests_m, only: reject_stage, request
  use phases_m
  use trajectory_m, only: fail, problem_t, trajectory_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: out_of_memory, paused, step_too_long
  implicit none
  private
  public :: store_begin, store_node, interpolate, store_end, point_at, request_ends, request_node, &
            request_interpolant, time_at

contains

  ! Requests the interpolant of the last step, and no further step.
  subroutine request_interpolant(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: memory

    trajectory%interpolate_only = .true.
    trajectory%status = paused
    trajectory%phase = phase_request_end
    call reserve_interpolant(problem%frame, problem%scheme, trajectory%interpolant, memory)
    if (trajectory%last%cut) then
      trajectory%phase = phase_record_step
    else if (memory /= 0) then
      call fail(trajectory, out_of_memory, trajectory%t)
    else if (trajectory%slope_known) then
      call interpolate_last(problem, trajectory, trajectory%slope)
    end if
  end subroutine request_interpolant

  ! Requests the coefficients at the ends of a step that aren't known; then its interpolant starts.
  subroutine request_ends(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory)
      if (.not. x%slope_known) then
        call request(problem, trajectory, x%t, x%y(:, 0), phase_begin_received)
      else if (.not. x%end_known) then
        call request(problem, trajectory, x%t_end, x%y(:, x%result), phase_end_received)
      else
        call interpolate(problem, trajectory)
      end if
    end associate
  end subroutine request_ends

  ! Stores the coefficients at the start of a step.
  subroutine store_begin(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%slope(:) = trajectory%request%received
    trajectory%slope_known = .true.
    call request_ends(problem, trajectory)
  end subroutine store_begin

  ! Stores the coefficients at the end of a step, and starts its interpolant.
  subroutine store_end(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory)
      if (x%interpolate_only) then
        x%slope(:) = x%request%received
        x%slope_known = abs(x%t - x%request%t) <= 0
        call interpolate_last(problem, trajectory, x%slope)
      else
        x%end_slope(:) = x%request%received
        x%end_known = .true.
        call interpolate(problem, trajectory)
      end if
    end associate
  end subroutine store_end

  ! Starts the interpolant of the present step. If only events may need it, they are sought first
  ! along what is known of it from the ends of the step.
  subroutine interpolate(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: exists

    associate (x => trajectory)
      call set_ends(x%interpolant, x%t, x%t_end - x%t, x%y(:, 0), x%y(:, x%result), x%slope, &
                    x%end_slope)
      call complete_ends(problem, trajectory)
      call begin_interpolant(problem%frame, problem%scheme, problem%free, x%f, x%interpolant, &
                             exists)
      if (x%needs_interpolant .or. x%interpolant%complete) then
        call advance_interpolant(problem, trajectory, exists, x%interpolant%nexp)
      else
        call make_cubic(problem%scheme, exists, x%interpolant)
        x%phase = phase_detect_events
      end if
    end associate
  end subroutine interpolate

  ! Adds the free motion to the coefficients of splitting methods at both ends.
  subroutine complete_ends(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    if (.not. problem%method%splitting) return
    associate (interpolant => trajectory%interpolant)
      call add_free_motion(problem%frame, interpolant%y0, interpolant%field(:, 1))
      call add_free_motion(problem%frame, interpolant%y1, interpolant%field(:, 2))
    end associate
  end subroutine complete_ends

  ! Starts the interpolant of the step before.
  subroutine interpolate_last(problem, trajectory, slope)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: slope(:)       ! (dimension) at its end
    logical :: exists

    associate (x => trajectory)
      call set_ends(x%interpolant, x%last%t, x%last%h, x%last%y, x%y(:, 0), x%last%slope, slope)
      call complete_ends(problem, trajectory)
      call begin_interpolant(problem%frame, problem%scheme, problem%free, x%f, x%interpolant, &
                             exists)
      call advance_interpolant(problem, trajectory, exists, x%interpolant%nexp)
    end associate
  end subroutine interpolate_last

  ! Chooses the phase after a node of the interpolant.
  subroutine advance_interpolant(problem, trajectory, exists, flows)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical, intent(in) :: exists
    integer, intent(in) :: flows                       ! that the node has taken

    trajectory%counts%nexp = trajectory%counts%nexp + int(flows, int64)
    trajectory%phase = phase_node_received
    if (.not. exists) then
      call reject_stage(problem, trajectory, step_too_long, trajectory%interpolant%t0)
    else
      trajectory%phase = merge(phase_record_step, phase_next_node, trajectory%interpolant%complete)
    end if
  end subroutine advance_interpolant

  ! Moves to the next node and requests the coefficients there.
  subroutine request_node(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: theta

    associate (x => trajectory)
      call next_node(problem%frame, problem%scheme, x%interpolant, theta)
      x%counts%nexp = x%counts%nexp + int(flows_of_evaluation(problem%scheme, x%interpolant), int64)
      call request(problem, trajectory, x%interpolant%t0 + theta * x%interpolant%h, &
                   x%interpolant%y, phase_node_received)
    end associate
  end subroutine request_node

  ! Stores the coefficients at a node.
  subroutine store_node(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: before
    logical :: exists

    associate (x => trajectory)
      before = x%interpolant%nexp
      if (problem%method%splitting) &
        call add_free_motion(problem%frame, x%interpolant%y, x%request%received)
      call add_node(problem%frame, problem%scheme, x%request%received, x%interpolant, exists)
      call advance_interpolant(problem, trajectory, exists, x%interpolant%nexp - before)
    end associate
  end subroutine store_node

  ! Evaluates the solution at a fraction theta of the step.
  subroutine point_at(problem, trajectory, theta, y)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: theta
    real(wp), contiguous, intent(out) :: y(:)

    if (.not. theta < 1) then
      y = trajectory%y(:, trajectory%result)
    else if (.not. theta > 0) then
      y = trajectory%y(:, 0)
    else
      call evaluate_interpolant(problem%frame, problem%scheme, trajectory%interpolant, theta, y)
    end if
  end subroutine point_at

  ! The time at a fraction of the step
  pure real(wp) function time_at(trajectory, x)
    type(trajectory_t), intent(in) :: trajectory
    real(wp), intent(in) :: x

    time_at = trajectory%t_end
    if (x < 1) time_at = trajectory%t + x * (trajectory%t_end - trajectory%t)
  end function time_at

end module within_step_m
