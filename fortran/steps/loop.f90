! The loop over steps of one trajectory, as a state machine that can pause anywhere and be resumed.
! A right-hand side that isn't vectorized is called at once. Otherwise `resume` returns a status:
! needs_rhs for coefficients at request%t and request%y, needs_events for values of events at
! `query`, needs_maximum for the largest request%shared of all with common steps, or paused.
! It is called again with the answer, and continues with the phase. Phases follow each other as
!
!   begin segment -> [first size] -> choose step -> stages -> finish step -> decide -> accepted
!        ^                               ^                                     |          |
!        |                               |'------------ rejected --------------'          v
!        |                               '------------- [tried again] ------ [interpolant, events]
!        '------------------- store output <- complete step <-----------------------------'
!
! A segment is the time between two breakpoints; brackets mark what only some steps need.
module loop_m
  use output_m, only: output_t
  use accepted_step_m, only: complete_step, detect_events, examine_step, prepare_inner, &
                             request_ends, request_node, receive_end, receive_node, store_output
  use collocation_m, only: receive_column
  use step_m, only: receive_error, receive_stage, finish_step, accept_or_reject, request_stage
  use step_size_m, only: begin_segment, choose_step, choose_first_size, guess_size, &
                         receive_slope, request_curvature
  use requests_m, only: retry_step
  use phases_m
  use trajectory_m, only: trajectory_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: finished, needs_events, needs_maximum, no_stop, paused, polynomial_kind
  implicit none
  private
  public :: resume

contains

  ! Advances a trajectory until it needs something from the caller or ends; its status says which.
  subroutine resume(x, output, budget)
    type(trajectory_t), target, intent(inout) :: x
    type(output_t), intent(inout) :: output
    integer(int64), intent(inout) :: budget            ! steps to try until the next pause

    if (any(x%status == [needs_maximum, paused])) x%status = no_stop
    do while (x%status == no_stop .and. x%phase /= phase_ended)
      call advance(x, output, budget)
      if (x%status == needs_events) exit
      x%queries%count = 0                          ! the phase that needed values of events is done
      x%queries%answered = 0
    end do
    if (x%status == no_stop) x%status = finished
  end subroutine resume

  ! Runs the procedure of the phase, which sets the next phase.
  subroutine advance(x, output, budget)
    type(trajectory_t), target, intent(inout) :: x
    type(output_t), intent(inout) :: output
    integer(int64), intent(inout) :: budget

    select case (x%phase)
    case (phase_begin_segment)
      call begin_segment(x)
    case (phase_guess_size)
      call guess_size(x)
    case (phase_guess_shared)
      call request_curvature(x)
    case (phase_curvature_received)
      call choose_first_size(x)
    case (phase_size_shared)
      x%control%step_size = -x%request%shared
      x%phase = phase_choose_step
    case (phase_choose_step)
      if (budget <= 0) then
        x%status = paused
      else
        budget = budget - 1
        call choose_step(x)
      end if
    case (phase_start_received)
      call receive_slope(x)
    case (phase_next_stage)
      call request_stage(x)
    case (phase_stage_received)
      call receive_stage(x)
    case (phase_column_received)
      call receive_column(x)
    case (phase_error_received)
      call receive_error(x)
    case (phase_finish_step)
      if (x%method%kind == polynomial_kind) call prepare_inner(x, output)
      call finish_step(x)
    case (phase_decide_step)
      call accept_or_reject(x)
    case (phase_accepted)
      call examine_step(x, output)
    case (phase_request_ends)
      call request_ends(x)
    case (phase_interpolant_start_received, phase_end_received)
      call receive_end(x)
    case (phase_next_node)
      call request_node(x)
    case (phase_node_received)
      call receive_node(x)
    case (phase_detect_events)
      call detect_events(x, output)
    case (phase_complete_step)
      call complete_step(x, output)
    case (phase_step_shared)
      x%phase = phase_store_output
      if (x%request%shared > 0) call retry_step(x)     ! as another trajectory has to
    case (phase_store_output)
      call store_output(x, output)
    end select
  end subroutine advance

end module loop_m
