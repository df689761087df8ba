! One step: its stages, its results and its error estimate.
! Points are reached along the paths of method_t, by flows of the frame.
module step_m
  use kinds, only: wp
  use algebra_m, only: dexpinv, remove_isotropy, turning
  use collocation_m, only: converges_fast, keep_step, request_collocation, store_collocation
  use controller_m, only: accepted_size, min_last_predicted, predicted_size, raised_by_rejection, &
                          max_suspicion, rejected_size, suspected_error
  use error_norm_m, only: norm, point_difference, scales, tangent
  use frames_m, only: apply_flows, flow_along, restore
  use free_motion_m, only: move_by_kicks
  use implicit_m, only: prepare_stage, store_value
  use method_m, only: method_t
  use newton_m, only: filtered
  use node_difference_m, only: node_difference
  use requests_m, only: reject_stage, request, within_segment
  use phases_m
  use trajectory_m, only: fail, problem_t, trajectory_t
  use vectors_m, only: copy, finite
  use iso_fortran_env, only: int64
  use shared_numbers, only: fields_operation, needs_maximum, raised, solution_not_finite, &
                            step_too_long
  implicit none
  private
  public :: store_error, store_stage, finish_step, accept_or_reject, request_stage

  ! Angle of a step, in radians, up to which estimates have been compared with errors
  real(wp), parameter :: max_angle = 20.0_wp
  real(wp), parameter :: least_excess = 0.1_wp         ! below which steps may grow freely

contains

  ! Moves to the point of the next stage and requests the coefficients there. The first stage is at
  ! the start, unless it is at a node of its own. Functions of time need no points.
  subroutine request_stage(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: path

    associate (x => trajectory, method => problem%method)
      if (method%collocation) then
        call request_collocation(problem, trajectory)
        return
      else if (method%implicit) then
        call prepare_stage(problem, trajectory)
        if (x%phase == phase_finish_step) return
      else if (x%stage == 1 .and. .not. abs(method%c(1)) > 0) then
        x%f(:, 1) = x%slope
        if (method%two_registers) then
          x%y(:, 1) = x%y(:, 0)
          call advance_register(problem, trajectory)
        end if
        x%stage = 2
      end if
      if (x%stage > stages(problem)) then
        x%phase = phase_finish_step
        return
      end if
      if (problem%of_time .and. .not. (method%implicit .or. associated(problem%field))) then
        call evaluate_nodes(problem, trajectory)
        return
      end if
      path = merge(1, method%stage_path(x%stage), method%two_registers)
      if (problem%of_time) path = 0
      if (.not. method%two_registers) call follow_paths(problem, trajectory, path)
      call request(problem, trajectory, x%t + method%c(x%stage) * x%h, x%y(:, path), &
                   phase_stage_received)
    end associate
  end subroutine request_stage

  ! The number of stages; one at the end that only an error estimate needs is left out without it.
  pure integer function stages(problem)
    type(problem_t), intent(in) :: problem

    stages = size(problem%method%c)
    if (problem%method%power == 0 .and. .not. problem%adaptive) stages = stages - 1
  end function stages

  ! Evaluates a vectorized function of time for all remaining stages of the step.
  subroutine evaluate_nodes(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: times(stages(problem) - trajectory%stage + 1)
    real(wp) :: members(size(times)), answer(size(trajectory%request%received) * size(times))
    integer :: k

    associate (x => trajectory, method => problem%method)
      times = within_segment(problem, x, x%t + method%c(x%stage:stages(problem)) * x%h)
      members = real(x%member - 1, wp)
      call problem%frame%callback%apply(fields_operation, [times, members], x%y(:, 0), &
                                         answer)
      if (.not. finite(answer)) then                   ! Python has raised an exception
        call fail(x, raised, x%t)
        return
      end if
      x%counts%nfev = x%counts%nfev + size(times, kind=int64)
      do k = 1, size(times)
        associate (n => size(x%request%received))
          x%request%received(:) = answer((k - 1) * n + 1:k * n)
        end associate
        call store_stage(problem, trajectory)
        if (x%phase /= phase_next_stage) return
      end do
      x%phase = phase_finish_step
    end associate
  end subroutine evaluate_nodes

  ! Stores the coefficients at a stage. On a Lie algebra they become derivatives of coordinates.
  subroutine store_stage(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: exists

    associate (x => trajectory, method => problem%method)
      if (method%collocation) then
        call store_collocation(problem, trajectory)
        return
      else if (method%implicit) then
        call store_value(problem, trajectory)
        return
      end if
      if (method%two_registers) then
        x%f(:, 1) = method%a(x%stage) * x%f(:, 1) + x%request%received
        call advance_register(problem, trajectory)
      else
        x%f(:, x%stage) = x%request%received
        if (x%stage == method%final_stage .or. (problem%of_time .and. &
                                                .not. abs(method%c(x%stage) - 1) > 0)) then
          x%end_slope(:) = x%request%received
          x%end_known = .true.
        end if
        if (method%on_algebra .and. method%stage_path(x%stage) > 0) then
          if (x%path_of_u /= method%stage_path(x%stage)) then
            call combine_coordinates(method, method%stage_path(x%stage), trajectory)
          end if
          call dexpinv(problem%frame, method%series, x%u, x%f(:, x%stage), exists)
          if (.not. exists) then
            call reject_stage(problem, trajectory, step_too_long, x%t)
            return
          end if
        end if
      end if
      x%stage = x%stage + 1
      x%phase = phase_next_stage
    end associate
  end subroutine store_stage

  ! Computes the ends of all paths up to one. On a path the flow of the lowest stage comes first.
  ! Rounding off the manifold is removed from results only, since it doesn't accumulate in stages.
  subroutine follow_paths(problem, trajectory, last)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: last
    integer :: i

    associate (x => trajectory, method => problem%method, frame => problem%frame)
      do i = x%paths + 1, last
        if (problem%of_time .and. .not. method%leads(i)) cycle
        call copy(frame%point_size, x%y(:, method%origin(i)), x%y(:, i))
        if (method%on_algebra) then
          call combine_coordinates(method, i, trajectory)
          call flow_along(frame, x%u, x%y(:, i))
        else if (method%splitting) then
          call move_by_kicks(frame, x%flows, x%h * method%drift, method%path_first(i), &
                             method%path_first(i + 1) - 1, x%f, x%y(:, i))
        else
          call apply_flows(frame, x%flows, method%path_first(i), method%path_first(i + 1) - 1, &
                           x%f, x%y(:, i))
        end if
        if (i == method%result .or. i == method%embedded) call restore(frame, x%y(:, i))
        x%counts%nexp = x%counts%nexp &
                        + int(merge(1, method%path_first(i + 1) - method%path_first(i), &
                                    method%polynomial), int64)
      end do
      x%paths = max(x%paths, last)
    end associate
  end subroutine follow_paths

  ! Computes the coordinates of the end of a path that has one flow.
  subroutine combine_coordinates(method, path, trajectory)
    type(method_t), intent(in) :: method
    integer, intent(in) :: path
    type(trajectory_t), intent(inout) :: trajectory
    integer :: flow, k

    associate (x => trajectory, flows => trajectory%flows)
      x%path_of_u = path
      flow = method%path_first(path)
      k = flows%first(flow)
      x%u = flows%weight(k) * x%f(:, flows%stage(k))
      do k = k + 1, flows%first(flow + 1) - 1
        x%u = x%u + flows%weight(k) * x%f(:, flows%stage(k))
      end do
    end associate
  end subroutine combine_coordinates

  ! Moves the point of a two-register method along h b Z.
  subroutine advance_register(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory)
      x%u = (x%h * problem%method%b(x%stage)) * x%f(:, 1)
      call flow_along(problem%frame, x%u, x%y(:, 1))
      call restore(problem%frame, x%y(:, 1))
      x%counts%nexp = x%counts%nexp + 1
    end associate
  end subroutine advance_register

  ! Computes the results and estimates the error.
  subroutine finish_step(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer :: last

    associate (x => trajectory, method => problem%method)
      if (.not. method%two_registers) then
        last = method%result
        if (problem%adaptive) last = max(last, method%embedded, method%third)
        call follow_paths(problem, trajectory, last)
      end if
      x%phase = phase_decide_step
      if (problem%adaptive) then
        x%error = huge(1.0_wp)
        if (finite(x%y(:, x%result))) call estimate_error(problem, trajectory)
        if (method%collocation .and. x%error > 1 .and. x%error < huge(1.0_wp) &
            .and. (x%control%after_rejection .or. .not. abs(x%newton%last_h) > 0)) then
          call request_error(problem, trajectory)
        else
          call share_error(problem, trajectory)
        end if
      else if (.not. finite(x%y(:, x%result))) then
        call fail(trajectory, solution_not_finite, x%t_end)
      end if
    end associate
  end subroutine finish_step

  ! Requests the coefficients at the start displaced by the estimated error, with which the estimate
  ! is damped once more: with one solution only, stiff components are far too large where they
  ! aren't in equilibrium.
  subroutine request_error(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: y(problem%frame%point_size)

    y = trajectory%y(:, 0)
    trajectory%u = -trajectory%u
    call flow_along(problem%frame, trajectory%u, y)
    trajectory%counts%nexp = trajectory%counts%nexp + 1
    call request(problem, trajectory, trajectory%t, y, phase_error_received)
  end subroutine request_error

  ! Stores these coefficients and estimates the error again.
  subroutine store_error(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%f(:, 1) = trajectory%request%received
    call estimate_error(problem, trajectory)
    call share_error(problem, trajectory)
  end subroutine store_error

  ! Makes the error known to trajectories with common steps.
  subroutine share_error(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    if (.not. trajectory%error < huge(1.0_wp)) trajectory%error = huge(1.0_wp)
    trajectory%request%shared = trajectory%error
    trajectory%phase = phase_decide_step
    if (problem%common) trajectory%status = needs_maximum
  end subroutine share_error

  ! Estimates the error in tolerances: from differences of results and from weighted sums of stages.
  ! Two estimates with norms e1 and e2 are combined to e1 (e1 / hypot(e1, factor e2))^power, which
  ! has the order of the error of the step. In DOP853 the factor is 1/10 and the power is 1, and e1
  ! is the larger one of two, see kink_weights in cg/method/end_weights.py. With a power of 0 (same
  ! file) sums see the end of the step, which results don't, and the larger of e1 and factor e2
  ! counts, where with two sums e2 is e2 (e2 / hypot(e2, e3)).
  subroutine estimate_error(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: errors(3), error, ratio
    integer :: i, k, place, sums

    associate (x => trajectory, frame => problem%frame, tolerances => problem%tolerances, &
               method => problem%method, v => trajectory%u)
      call scales(frame, tolerances, x%y(:, 0), x%y(:, x%result), x%control%work, x%control%scale)
      errors = 0.0_wp
      sums = size(method%error, 2)
      if (method%embedded > 0) then
        if (.not. finite(x%y(:, method%embedded))) return
        errors(1) = distance(problem, trajectory, method%embedded)
        if (method%third > 0) errors(2) = distance(problem, trajectory, method%third)
      end if
      x%path_of_u = 0
      do i = 1, sums
        v = x%h * method%error(1, i) * x%f(:, 1)
        do k = 2, size(x%f, 2)
          v = v + x%h * method%error(k, i) * x%f(:, k)
        end do
        if (method%collocation) call filtered(frame, method%transformation, x%newton, v)
        call remove_isotropy(frame, x%y(:, x%result), v)
        call tangent(frame, tolerances, v, x%y(:, x%result), x%control%work)
        place = merge(2 + i - sums, 1 + 2 * (i - 1) / sums, method%embedded > 0)
        if (method%power == 0) place = 1 + i
        error = norm(tolerances, x%control%work, x%control%scale)
        if (method%polynomial) error = hypot(errors(place), error)
        if (.not. error <= errors(place)) errors(place) = error
      end do
      ratio = 1.0_wp
      if (errors(1) > 0 .and. errors(2) <= huge(ratio)) &
        ratio = errors(1) / hypot(errors(1), method%factor * errors(2))
      x%error = errors(1) * ratio**method%power
      if (method%power == 0) then
        if (errors(3) > 0 .and. errors(3) <= huge(ratio)) &
          errors(2) = errors(2) * (errors(2) / hypot(errors(2), errors(3)))
        x%error = max(errors(1), method%factor * errors(2))
      end if
      call limit_angle(problem, trajectory)
      if (method%has_nodes .and. abs(x%h_before) > 0) then
        call node_difference(method%c, x%f, x%h_before / x%h, x%f_before, v)
        v = x%h * v
        call remove_isotropy(frame, x%y(:, x%result), v)
        call tangent(frame, tolerances, v, x%y(:, x%result), x%control%work)
        x%error = max(x%error, norm(tolerances, x%control%work, x%control%scale))
      end if
    end associate
  end subroutine estimate_error

  ! Raises the error of a step that turns by more than max_angle, so that the next one is shorter,
  ! unless coefficients change by less than the tolerances: constant ones may turn by any angle.
  subroutine limit_angle(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: excess
    integer :: k

    associate (x => trajectory, frame => problem%frame, v => trajectory%u)
      if (problem%method%collocation .or. problem%method%polynomial) return
      excess = (abs(x%h) * turning(frame, x%f(:, 1)) / max_angle)**(1 / problem%tolerances%exponent)
      if (excess <= max(x%error, least_excess)) return
      x%path_of_u = 0
      do k = 2, size(x%f, 2)
        v = x%h * (x%f(:, k) - x%f(:, 1))
        call tangent(frame, problem%tolerances, v, x%y(:, x%result), x%control%work)
        if (.not. norm(problem%tolerances, x%control%work, x%control%scale) <= 1) then
          x%error = excess
          exit
        end if
      end do
    end associate
  end subroutine limit_angle

  ! The norm of the difference of the result from another one
  real(wp) function distance(problem, trajectory, path)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: path

    associate (x => trajectory)
      call point_difference(problem%frame, problem%tolerances, x%y(:, path), x%y(:, x%result), &
                            x%control%v)
      distance = norm(problem%tolerances, x%control%v, x%control%scale)
    end associate
  end function distance

  ! Accepts a step, or rejects it and chooses a smaller size.
  subroutine accept_or_reject(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: predicted, error

    associate (x => trajectory, exponent => problem%tolerances%exponent, &
               control => trajectory%control, &
               newton => trajectory%newton, collocation => problem%method%collocation)
      x%phase = phase_accepted
      predicted = 0.0_wp
      if (problem%adaptive) then
        ! trajectories with common steps must choose the same size
        if (collocation) predicted = predicted_size( &
          abs(x%h), x%request%shared, exponent, merge(1, newton%iteration, problem%common), &
          problem%common .or. converges_fast(x), abs(newton%last_h), control%last_error)
        error = suspected_error(x%request%shared, abs(x%h), x%t, &
                                merge(0, control%suspicion, collocation))
        if (.not. error <= 1) then
          x%counts%nrejected = x%counts%nrejected + 1
          control%after_rejection = .true.
          control%suspicion = min(control%suspicion + raised_by_rejection, max_suspicion)
          control%step_size = rejected_size(abs(x%h), error, exponent)
          if (collocation) control%step_size = predicted
          x%phase = phase_choose_step
          return
        end if
        if (collocation) then
          control%step_size = merge(min(predicted, abs(x%h)), predicted, control%after_rejection)
          control%last_error = max(x%request%shared, min_last_predicted)
        else
          call accepted_size(abs(x%h), error, exponent, control%after_rejection, &
                             control%last_error, control%step_size)
        end if
        ! a step that was shortened to end with its segment doesn't shorten the next one
        if (control%shortened .and. .not. control%after_rejection) &
          control%step_size = max(control%step_size, control%unshortened_size)
        control%after_rejection = .false.
        control%suspicion = max(control%suspicion - 1, 0)
        if (problem%method%has_nodes) then
          x%f_before(:, :) = x%f
          x%h_before = x%h
        end if
      end if
      if (collocation) call keep_step(trajectory)
    end associate
  end subroutine accept_or_reject

end module step_m
