! What an accepted step brings: events, points at wanted times, its end, where the next one begins
module record_m
  use kinds, only: wp
  use controller_m, only: smallest_size
  use interpolant_m, only: flows_of_evaluation
  use output_m, only: keep_dense, keep_step, output_t
  use step_events_m, only: crosses, keep_events, locate_events
  use trajectory_m, only: begin_segment, choose_step, ended, evaluate_events, fail, known_end, &
                              problem_t, record_step, request, trajectory_t
  use within_step_m, only: interpolate, point_at
  use iso_fortran_env, only: int64
  use shared_numbers, only: jumps_without_progress, paused, raised, terminal_event
  implicit none
  private
  public :: prepare, record

  integer, parameter :: max_stuck = 20
  real(wp), parameter :: small_value = 1e-9_wp         ! of an event's function, of those at the step

contains

  ! Looks for what happens within an accepted step, and asks for the interpolant if something does.
  subroutine prepare(problem, trajectory, output)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    type(output_t), intent(in) :: output
    real(wp) :: values(size(trajectory%value))
    logical :: stopped
    integer :: i

    associate (x => trajectory)
      x%steps = x%steps + 1
      x%done = x%done + 1
      x%within = output%dense
      if (x%used < output%wanted) then
        if ((output%times(x%used + 1) - x%end) * sign(1.0_wp, x%h) < 0) x%within = .true.
      end if
      x%crossed = .false.
      call evaluate_events(problem, trajectory, x%end, x%y(:, x%result), values, stopped)
      if (stopped) return
      x%value_after = values
      do i = 1, size(x%value)
        if (crosses(problem, x, i)) x%crossed = .true.
        if (crosses(problem, x, i) .and. abs(x%value_after(i)) > 0) x%within = .true.
      end do
      if (x%jumped > 0) then
        x%within = .true.
        x%crossed = .true.
      end if
      x%phase = record_step
      if (.not. x%within) return
      if (x%end_known) then
        call interpolate(problem, trajectory)
      else
        call request(problem, trajectory, x%end, x%y(:, x%result), known_end)
      end if
    end associate
  end subroutine prepare

  ! Keeps what is wanted of a step, up to the first event that ends it, and goes on to the next one.
  subroutine record(problem, trajectory, output)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    type(output_t), intent(inout) :: output

    if (trajectory%alone) then
      call keep_dense(output, trajectory%member, trajectory%t, trajectory%interpolant)
      trajectory%alone = .false.
      trajectory%phase = choose_step
      trajectory%status = paused
      return
    end if
    if (trajectory%crossed) then
      call record_events(problem, trajectory, output)
    else
      call record_step_to(problem, trajectory, trajectory%end, &
                          trajectory%y(:, trajectory%result), 0, output)
    end if
  end subroutine record

  subroutine record_events(problem, trajectory, output)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    type(output_t), intent(inout) :: output
    real(wp), allocatable :: theta(:)
    real(wp) :: until, t, y(problem%frame%point_size), after(problem%frame%point_size)
    integer :: event
    logical :: stopped

    associate (x => trajectory)
      call locate_events(problem, trajectory, theta, stopped)
      if (.not. stopped) call keep_events(problem, trajectory, theta, output, until, event, after, &
                                          stopped)
      if (stopped) then
        call fail(x, raised, x%end)
        return
      end if
      t = x%end
      if (until < 1) t = x%t + until * (x%end - x%t)
      if (event > 0) then
        y = after
      else
        call point_at(problem, trajectory, until, y)
      end if
      call record_step_to(problem, trajectory, t, y, event, output)
    end associate
  end subroutine record_events

  ! Of a step that ends at t with y
  subroutine record_step_to(problem, trajectory, t, y, event, output)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    integer, intent(in) :: event                       ! that ended it, 0 for none
    type(output_t), intent(inout) :: output

    associate (x => trajectory)
      call keep_wanted(problem, trajectory, t, y, output)
      if (output%dense) call keep_dense(output, x%member, t, x%interpolant)
      call keep_step(output, x%steps, t, y, .not. abs(t - problem%stops(size(problem%stops))) > 0 &
                     .or. event > 0)
      if (x%keep_last) then
        x%t_old = x%t
        x%h_old = x%end - x%t
        x%y_old(:) = x%y(:, 0)
        x%slope_old(:) = x%slope
      end if
      call move_on(problem, trajectory, t, y, event)
    end associate
  end subroutine record_step_to

  subroutine move_on(problem, trajectory, t, y, event)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    integer, intent(in) :: event                       ! that ended the step, 0 for none
    logical :: ends, stopped
    real(wp) :: size_of, values(size(trajectory%value))

    associate (x => trajectory)
      ends = .not. abs(t - problem%stops(x%segment)) > 0
      if (event > 0) then
        if (abs(t - x%t) > 10 * smallest_size(t)) x%stuck = 0
        x%stuck = x%stuck + 1
      end if
      x%t = t
      x%y(:, 0) = y
      x%phase = choose_step
      x%known = x%end_known .and. event == 0 .and. .not. (ends .and. x%segment < size(problem%stops))
      if (x%known) x%slope(:) = x%end_slope
      size_of = 0.0_wp
      if (event > 0) size_of = max(abs(x%value(event)), abs(x%value_after(event)))
      if (size(x%value) > 0) x%value(:) = x%value_after
      x%jumped = 0
      if (ends) x%phase = begin_segment
      if (event == 0) return
      if (x%count(event) >= problem%events%most(event)) then
        x%phase = ended
        x%status = terminal_event
        return
      end if
      if (x%stuck > max_stuck) then
        call fail(x, jumps_without_progress, t)
        return
      end if
      call evaluate_events(problem, trajectory, t, y, values, stopped)
      if (stopped) return
      x%value = values
      ! where the jump leaves the function at its zero, the same event can't happen again
      if (abs(x%value(event)) <= small_value * size_of) then
        x%jumped_from = x%value(event)
        x%value(event) = 0.0_wp
        x%jumped = event
      end if
      x%size = 0.0_wp
      x%last_error = 1.0_wp
      x%phase = begin_segment
    end associate
  end subroutine move_on

  ! The points at the wanted times of a step that goes to t, where it ends at y
  subroutine keep_wanted(problem, trajectory, t, y, output)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    type(output_t), intent(inout) :: output

    associate (x => trajectory)
      do while (x%used < output%wanted)
        associate (time => output%times(x%used + 1))
          if ((time - t) * sign(1.0_wp, x%h) > 0) return
          x%used = x%used + 1
          if (.not. abs(time - t) > 0) then
            output%y(:, x%member, x%used) = y
          else
            call point_at(problem, trajectory, (time - x%t) / (x%end - x%t), &
                          output%y(:, x%member, x%used))
            x%nexp = x%nexp + int(flows_of_evaluation(problem%scheme, x%interpolant), int64)
          end if
        end associate
      end do
    end associate
  end subroutine keep_wanted

end module record_m
