! The solution within a step, for which coefficients are asked for at nodes
module within_step_m
  use kinds, only: wp
  use interpolant_m, only: add_node, begin_interpolant, evaluate_interpolant, &
                               flows_of_evaluation, next_node, reserve_interpolant, set_ends
  use trajectory_m, only: ask_end, fail, known_node, problem_t, record_step, reject_stage, &
                              request, take_node, trajectory_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: out_of_memory, paused, step_too_long
  implicit none
  private
  public :: absorb_node, interpolate, know_end, point_at, reach_node, request_interpolant

contains

  ! The solution within the last step is wanted, and nothing else.
  subroutine request_interpolant(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: memory

    trajectory%alone = .true.
    trajectory%status = paused
    trajectory%phase = ask_end
    call reserve_interpolant(problem%frame, problem%scheme, trajectory%interpolant, memory)
    if (memory /= 0) then
      call fail(trajectory, out_of_memory, trajectory%t)
    else if (trajectory%known) then
      call interpolate_last(problem, trajectory, trajectory%slope)
    end if
  end subroutine request_interpolant

  subroutine know_end(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory)
      if (x%alone) then
        x%slope(:) = x%got
        x%known = x%segment == size(problem%stops) .or. abs(x%t - x%want_t) <= 0
        call interpolate_last(problem, trajectory, x%slope)
      else
        x%end_slope(:) = x%got
        x%end_known = .true.
        call interpolate(problem, trajectory)
      end if
    end associate
  end subroutine know_end

  subroutine interpolate(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: exists

    associate (x => trajectory)
      call set_ends(x%interpolant, x%t, x%end - x%t, x%y(:, 0), x%y(:, x%result), x%slope, &
                    x%end_slope)
      call begin_interpolant(problem%frame, problem%scheme, problem%free, x%f, x%interpolant, &
                             exists)
      call go_on_within(problem, trajectory, exists, x%interpolant%nexp)
    end associate
  end subroutine interpolate

  subroutine interpolate_last(problem, trajectory, slope)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: slope(:)       ! (dimension) at its end
    logical :: exists

    associate (x => trajectory)
      call set_ends(x%interpolant, x%t_old, x%h_old, x%y_old, x%y(:, 0), x%slope_old, slope)
      call begin_interpolant(problem%frame, problem%scheme, problem%free, x%f, x%interpolant, &
                             exists)
      call go_on_within(problem, trajectory, exists, x%interpolant%nexp)
    end associate
  end subroutine interpolate_last

  ! On to the next node of the interpolant, or past the last one
  subroutine go_on_within(problem, trajectory, exists, flows)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical, intent(in) :: exists
    integer, intent(in) :: flows                       ! that were taken

    trajectory%nexp = trajectory%nexp + int(flows, int64)
    trajectory%phase = known_node
    if (.not. exists) then
      call reject_stage(problem, trajectory, step_too_long, trajectory%interpolant%t0)
    else
      trajectory%phase = merge(record_step, take_node, trajectory%interpolant%complete)
    end if
  end subroutine go_on_within

  subroutine reach_node(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: theta

    associate (x => trajectory)
      call next_node(problem%frame, problem%scheme, x%interpolant, theta)
      x%nexp = x%nexp + int(flows_of_evaluation(problem%scheme, x%interpolant), int64)
      call request(problem, trajectory, x%interpolant%t0 + theta * x%interpolant%h, &
                   x%interpolant%y, known_node)
    end associate
  end subroutine reach_node

  subroutine absorb_node(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: before
    logical :: exists

    associate (x => trajectory)
      before = x%interpolant%nexp
      call add_node(problem%frame, problem%scheme, x%got, x%interpolant, exists)
      call go_on_within(problem, trajectory, exists, x%interpolant%nexp - before)
    end associate
  end subroutine absorb_node

  ! The point at a fraction of the step
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

end module within_step_m
