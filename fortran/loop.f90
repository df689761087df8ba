! One integration as a machine of states. Where the problem has a field, `resume` calls it; else it
! returns when coefficients are needed somewhere, and is called again with them. So the same loop
! serves a function of one point and one of many, whose trajectories then wait for each other; and
! output, events and steps that are chosen or equal are in one place.
!
!   begin segment -> [first size] -> choose step -> stages -> finish step -> judge -> accepted
!        ^                               ^                                             |
!        |                               '--- rejected                                 v
!        '---------------- [jump] <- record <- [events] <- [interpolant] <-------------'
!
! A segment is what lies between two breakpoints.
module loop_m
  use kinds, only: wp
  use output_m, only: has_room, output_t
  use record_m, only: prepare, record
  use step_m, only: absorb_stage, finish, judge, reach_stage
  use step_size_m, only: begin, choose, choose_size, guess, try_guess
  use trajectory_m, only: accept_step, ask_end, begin_segment, choose_step, ended, &
                              finish_step, guess_first, judge_reply, judge_step, known_curvature, &
                              known_end, known_node, known_stage, known_start, problem_t, &
                              record_step, request, shared_guess, shared_size, take_node, &
                              take_stage, trajectory_t
  use within_step_m, only: absorb_node, know_end, reach_node
  use iso_fortran_env, only: int64
  use shared_numbers, only: buffer_full, finished, needs_field, needs_maximum, needs_minimum, &
                            paused
  implicit none
  private
  public :: resume

contains

  ! Goes on until something is needed, or the trajectory ends; its status tells what.
  subroutine resume(problem, trajectory, output, budget)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    type(output_t), intent(inout) :: output
    integer(int64), intent(inout) :: budget            ! trial steps until the next pause

    select case (trajectory%status)
    case (needs_field)
      call judge_reply(problem, trajectory, trajectory%want)
    case (needs_minimum, needs_maximum, paused, buffer_full)
      trajectory%status = finished
    end select
    do while (trajectory%status == finished .and. trajectory%phase /= ended)
      select case (trajectory%phase)
      case (begin_segment)
        call begin(problem, trajectory)
      case (guess_first)
        call guess(problem, trajectory)
      case (shared_guess)
        call try_guess(problem, trajectory)
      case (known_curvature)
        call choose_size(problem, trajectory)
      case (shared_size)
        trajectory%size = trajectory%shared
        trajectory%phase = choose_step
      case (choose_step)
        if (.not. has_room(output)) then
          trajectory%status = buffer_full
        else if (budget <= 0) then
          trajectory%status = paused
        else
          budget = budget - 1
          call choose(problem, trajectory)
        end if
      case (known_start)
        trajectory%slope(:) = trajectory%got
        trajectory%known = .true.
        trajectory%phase = take_stage
        if (problem%adaptive .and. .not. trajectory%size > 0) trajectory%phase = guess_first
      case (take_stage)
        call reach_stage(problem, trajectory)
      case (known_stage)
        call absorb_stage(problem, trajectory)
      case (finish_step)
        call finish(problem, trajectory)
      case (judge_step)
        call judge(problem, trajectory)
      case (accept_step)
        call prepare(problem, trajectory, output)
      case (ask_end)
        call request(problem, trajectory, trajectory%t, trajectory%y(:, 0), known_end)
      case (known_end)
        call know_end(problem, trajectory)
      case (take_node)
        call reach_node(problem, trajectory)
      case (known_node)
        call absorb_node(problem, trajectory)
      case (record_step)
        call record(problem, trajectory, output)
      end select
    end do
  end subroutine resume

end module loop_m
