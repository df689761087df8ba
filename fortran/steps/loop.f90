! The loop over steps of one trajectory, as a state machine that can pause anywhere and be resumed.
! The same loop serves functions in C of one point and vectorized functions.
!
! Where the problem has a field, requests for coefficients are answered at once. Otherwise `resume`
! returns with a status (needs_field: coefficients at request_t, request_y; needs_minimum,
! needs_maximum: of a number over all trajectories with common steps; buffer_full; paused) and is
! called again with the answer. The phase says where to continue. Phases follow each other as
!
!   begin segment -> [first size] -> choose step -> stages -> finish step -> decide -> accepted
!        ^                               ^                                     |          |
!        |                               '------------- rejected --------------'          v
!        '-------- [jump] <- record step <- [interpolant] <- [detect events] <------------'
!
! A segment is the time between two breakpoints; brackets mark what only some steps need.
module loop_m
  use kinds, only: wp
  use output_m, only: has_room, output_t
  use record_m, only: detect_events, examine_step, prepare_inner, record_step
  use collocation_m, only: store_column
  use step_m, only: store_error, store_stage, finish_step, accept_or_reject, request_stage
  use step_size_m, only: begin_segment, choose_step, choose_first_size, guess_size, &
                         request_curvature
  use requests_m, only: check_coefficients, request
  use phases_m
  use trajectory_m, only: problem_t, trajectory_t
  use within_step_m, only: store_begin, store_node, store_end, request_node
  use iso_fortran_env, only: int64
  use shared_numbers, only: buffer_full, finished, needs_field, needs_maximum, needs_minimum, &
                            paused
  implicit none
  private
  public :: resume

contains

  ! Advances a trajectory until it needs something from the caller or ends; its status says which.
  subroutine resume(problem, trajectory, output, budget)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    type(output_t), intent(inout) :: output
    integer(int64), intent(inout) :: budget            ! steps to try until the next pause

    select case (trajectory%status)
    case (needs_field)
      call check_coefficients(problem, trajectory, trajectory%request%y)
    case (needs_minimum, needs_maximum, paused, buffer_full)
      trajectory%status = finished
    end select
    do while (trajectory%status == finished .and. trajectory%phase /= phase_ended)
      select case (trajectory%phase)
      case (phase_begin_segment)
        call begin_segment(problem, trajectory)
      case (phase_guess_size)
        call guess_size(problem, trajectory)
      case (phase_guess_shared)
        call request_curvature(problem, trajectory)
      case (phase_curvature_received)
        call choose_first_size(problem, trajectory)
      case (phase_size_shared)
        trajectory%control%step_size = trajectory%request%shared
        trajectory%phase = phase_choose_step
      case (phase_choose_step)
        if (.not. has_room(output)) then
          trajectory%status = buffer_full
        else if (budget <= 0) then
          trajectory%status = paused
        else
          budget = budget - 1
          call choose_step(problem, trajectory)
        end if
      case (phase_start_received)
        trajectory%slope(:) = trajectory%request%received
        trajectory%slope_known = .true.
        trajectory%phase = phase_next_stage
        if (problem%adaptive .and. .not. trajectory%control%step_size > 0) &
          trajectory%phase = phase_guess_size
      case (phase_next_stage)
        call request_stage(problem, trajectory)
      case (phase_stage_received)
        call store_stage(problem, trajectory)
      case (phase_column_received)
        call store_column(problem, trajectory)
      case (phase_error_received)
        call store_error(problem, trajectory)
      case (phase_finish_step)
        if (problem%method%polynomial) call prepare_inner(problem, trajectory, output)
        call finish_step(problem, trajectory)
      case (phase_decide_step)
        call accept_or_reject(problem, trajectory)
      case (phase_accepted)
        call examine_step(problem, trajectory, output)
      case (phase_request_end)
        call request(problem, trajectory, trajectory%t, trajectory%y(:, 0), phase_end_received)
      case (phase_begin_received)
        call store_begin(problem, trajectory)
      case (phase_end_received)
        call store_end(problem, trajectory)
      case (phase_next_node)
        call request_node(problem, trajectory)
      case (phase_node_received)
        call store_node(problem, trajectory)
      case (phase_detect_events)
        call detect_events(problem, trajectory)
      case (phase_record_step)
        call record_step(problem, trajectory, output)
      end select
    end do
  end subroutine resume

end module loop_m
