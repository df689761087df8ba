! One step: its stages, its results and whether it is accepted. Stages are in implicit.f90,
! collocation.f90 and, explicit ones with paths, in paths.f90, the error in error_estimate.f90.
module step_m
  use kinds, only: wp
  use free_motion_m, only: try_close_joints
  use collocation_m, only: converges_fast, request_collocation, receive_collocation
  use controller_m, only: accepted_size, min_last_predicted, predicted_size, rejected_size, &
                          resumed_size, suspected_error
  use error_estimate_m, only: estimate_error
  use paths_m, only: find_brackets, follow_paths, receive_explicit, request_on_path, start_explicit
  use frames_m, only: apply_flows
  use implicit_m, only: request_implicit, receive_implicit
  use requests_m, only: request, share_error, within_segment
  use phases_m
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: finite
  use shared_numbers, only: at_end_estimate, collocation_kind, euclidean_block, implicit_kind, &
                            max_suspicion, needs_rhs, no_stop, raised_by_rejection, &
                            registers_kind, solution_not_finite
  implicit none
  private
  public :: receive_answers, receive_error, receive_stage, finish_step, accept_or_reject, &
            request_stage, get_times, times_asked

contains

  ! Requests the coefficients at the next stage, or finishes the step after the last one. The first
  ! explicit stage is at the start, unless it is at a node of its own.
  subroutine request_stage(x)
    type(trajectory_t), intent(inout) :: x

    select case (x%method%kind)
    case (collocation_kind)
      call request_collocation(x)
    case (implicit_kind)
      call request_implicit(x)
    case default
      if (x%stage == 1 .and. x%method%c(1) == 0) call start_explicit(x)
      if (x%stage > stages(x)) then
        x%phase = phase_finish_step
      else
        call request_on_path(x)
      end if
    end select
  end subroutine request_stage

  ! Stores the coefficients at a stage by the kind of method.
  subroutine receive_stage(x)
    type(trajectory_t), intent(inout) :: x

    select case (x%method%kind)
    case (collocation_kind)
      call receive_collocation(x)
    case (implicit_kind)
      call receive_implicit(x)
    case default
      call receive_explicit(x)
    end select
  end subroutine receive_stage

  ! The number of stages; one at the end that only an error estimate needs is left out without it.
  pure integer function stages(x)
    type(trajectory_t), intent(in) :: x

    stages = size(x%method%c)
    if (x%method%estimate == at_end_estimate .and. .not. x%problem%adaptive) stages = stages - 1
  end function stages

  ! The number of times asked for together: by a vectorized function of time, all that are left
  pure integer function times_asked(x)
    type(trajectory_t), intent(in) :: x

    times_asked = 1
    if (all(x%method%kind /= [collocation_kind, implicit_kind]) .and. x%problem%record%of_time &
        .and. x%phase == phase_stage_received) times_asked = stages(x) - x%stage + 1
  end function times_asked

  ! Gets the times that times_asked counts.
  pure subroutine get_times(x, times)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(out) :: times(:)        ! (times_asked)

    times = x%request%t
    if (size(times) > 1) times = within_segment(x, x%t + x%method%c(x%stage:stages(x)) * x%h)
  end subroutine get_times

  ! Stores coefficients at stages, but leaves the last, or the first not finite, as the answer.
  subroutine receive_answers(x, m, times, answers)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: m, times                    ! numbers of coefficients and times
    real(wp), intent(in) :: answers(m, times)
    integer :: k

    do k = 1, times
      if (k > 1) x%request%t = within_segment(x, x%t + x%method%c(x%stage) * x%h)
      x%request%answer(:m) = answers(:, k)
      if (k == times .or. .not. finite(m, answers(:, k))) return
      x%status = no_stop
      call receive_stage(x)
      if (x%phase /= phase_next_stage) return          ! the step is rejected
      x%counts%nfev = x%counts%nfev + 1
      x%phase = phase_stage_received
      x%status = needs_rhs
    end do
  end subroutine receive_answers

  ! Computes the results and estimates the error.
  subroutine finish_step(x)
    type(trajectory_t), intent(inout) :: x
    integer :: last

    if (x%method%kind /= registers_kind) then
      last = x%method%result
      if (x%problem%adaptive) last = max(last, x%method%embedded, x%method%third)
      if (size(x%method%bracket, 3) > 0) call find_brackets(x)
      call follow_paths(x, last)
      if (x%status /= no_stop) return
    end if
    x%phase = phase_decide_step
    if (x%problem%adaptive) then
      x%estimate%error = huge(1.0_wp)
      if (finite(size(x%y, 1), x%y(:, x%result))) call estimate_error(x)
      associate (error => x%estimate%error, newton => x%collocation)
        if (x%method%kind == collocation_kind .and. error > 1 .and. error < huge(1.0_wp) .and. &
            (x%control%after_rejection .or. newton%replaced .or. newton%h_before == 0)) then
          call request_error(x)
        else
          call share_error(x, error)
        end if
      end associate
    else if (.not. finite(size(x%y, 1), x%y(:, x%result))) then
      call fail(x, solution_not_finite, x%t_end)
    end if
  end subroutine finish_step

  ! Requests the coefficients at the start displaced by the estimated error, to damp the estimate
  ! once more: its stiff components are far too large outside equilibrium.
  subroutine request_error(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: y(x%frame%point_size)

    y = x%y(:, 0)
    x%v(:, 1) = -x%norms%displacement
    call apply_flows(x%frame, 1, x%v, y)
    x%counts%nexp = x%counts%nexp + 1
    call request(x, x%t, y, phase_error_received)
  end subroutine request_error

  ! Stores the coefficients at the displaced start, and estimates the error again.
  subroutine receive_error(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%request%answer
    call estimate_error(x)
    call share_error(x, x%estimate%error)
  end subroutine receive_error

  ! Accepts a step, or chooses a smaller one in its place.
  subroutine accept_or_reject(x)
    type(trajectory_t), intent(inout) :: x
    logical :: rejected

    rejected = .false.
    if (x%problem%adaptive) call control_size(x, rejected)
    x%phase = merge(phase_choose_step, phase_accepted, rejected)
    if (rejected) return
    ! other methods than RATTLE have moved along forces that keep joints closed up to their error
    if (x%frame%jointed .and. size(x%joints%impulse) == 0) &
      call try_close_joints(x%frame, x%y(:, x%result))
  end subroutine accept_or_reject

  ! Decides by the error of a step whether it is rejected, and chooses the size of the next one. The
  ! error, and all else that enters, is common to trajectories with common steps.
  subroutine control_size(x, rejected)
    type(trajectory_t), intent(inout) :: x
    logical, intent(out) :: rejected
    real(wp) :: predicted, error

    associate (control => x%control, newton => x%collocation, exponent => x%tolerances%exponent, &
               h => abs(x%h), common => x%problem%record%common, &
               collocation => x%method%kind == collocation_kind, &
               turns => any(x%frame%blocks%kind /= euclidean_block))
      predicted = 0.0_wp
      if (collocation) predicted = predicted_size(h, x%request%shared, exponent, &
        merge(1, newton%iteration, common), common .or. converges_fast(x), abs(newton%h_before), &
        control%last_error)
      error = suspected_error(x%request%shared, h, x%t, merge(0, control%suspicion, collocation))
      rejected = .not. error <= 1
      if (rejected) then
        x%counts%nrejected = x%counts%nrejected + 1
        ! iterations that fail since the Jacobian turns with the point soon fail again
        if (.not. collocation .or. .not. error < huge(error) .and. turns) &
          control%suspicion = min(control%suspicion + raised_by_rejection, max_suspicion)
        control%step_size = merge(predicted, rejected_size(h, error, exponent), collocation)
      else
        if (collocation) then
          control%step_size = merge(min(predicted, h), predicted, &
                                    control%after_rejection .or. control%suspicion > 0)
          control%last_error = max(x%request%shared, min_last_predicted)
        else
          call accepted_size(h, error, exponent, control%after_rejection, control%last_error, &
                             control%step_size)
        end if
        ! a step that was shortened shortens the next one only as far as its error does
        if (control%shortened .and. .not. control%after_rejection) control%step_size = &
          max(control%step_size, resumed_size(control%unshortened_size, h, error, exponent))
        control%suspicion = max(control%suspicion - 1, 0)
      end if
      control%after_rejection = rejected
    end associate
  end subroutine control_size

end module step_m
