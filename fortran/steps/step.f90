! One step: its stages and its results. Points are ends of the paths of method_t, y_path = exp(h
! sum_k weight_k f_stage(k)) ... y_origin, by flows of the frame; methods on the Lie algebra have
! the coordinates u of a point instead, y = exp(u) y_0. For the error see error_estimate.f90.
module step_m
  use kinds, only: wp
  use algebra_m, only: bracket, dexpinv
  use blocks_m, only: combine_flows
  use collocation_m, only: converges_fast, keep_step, request_collocation, store_collocation
  use controller_m, only: accepted_size, min_last_predicted, predicted_size, raised_by_rejection, &
                          max_suspicion, rejected_size, resumed_size, suspected_error
  use error_estimate_m, only: estimate_error
  use frames_m, only: apply_flows, restore
  use free_motion_m, only: move_by_kicks
  use implicit_m, only: prepare_stage, store_value
  use method_m, only: method_t
  use requests_m, only: reject_stage, request, share_error, within_segment
  use phases_m
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: copy, finite
  use iso_fortran_env, only: int64
  use shared_numbers
  implicit none
  private
  public :: store_error, store_stage, finish_step, accept_or_reject, request_stage

contains

  ! Moves to the point of the next stage and requests the coefficients there. The first stage is at
  ! the start, unless it is at a node of its own. Functions of time need no points.
  subroutine request_stage(x)
    type(trajectory_t), intent(inout) :: x
    integer :: path

    associate (method => x%problem%method)
      if (method%collocation) then
        call request_collocation(x)
        return
      else if (method%implicit) then
        call prepare_stage(x)
        if (x%phase == phase_finish_step) return
      else if (x%stage == 1 .and. .not. abs(method%c(1)) > 0) then
        x%f(:, 1) = x%slope
        if (method%two_registers) then
          x%y(:, 1) = x%y(:, 0)
          call advance_register(x)
        end if
        x%stage = 2
      end if
      if (x%stage > stages(x)) then
        x%phase = phase_finish_step
        return
      end if
      if (x%problem%of_time .and. .not. (method%implicit .or. associated(x%problem%field))) then
        call evaluate_nodes(x)
        return
      end if
      path = merge(1, method%stage_path(x%stage), method%two_registers)
      if (x%problem%of_time) path = 0
      associate (t => x%t + method%c(x%stage) * x%h)
        if (.not. method%two_registers) call follow_paths(x, path)
        if (method%two_registers .or. method%implicit) then
          call request(x, t, x%y(:, path), phase_stage_received, x%request%received)
        else
          call request(x, t, x%y(:, path), phase_stage_received, x%f(:, x%stage), &
                       method%goes_on(path))
        end if
      end associate
    end associate
  end subroutine request_stage

  ! The number of stages; one at the end that only an error estimate needs is left out without it.
  pure integer function stages(x)
    type(trajectory_t), intent(in) :: x

    stages = size(x%problem%method%c)
    if (x%problem%method%power == 0 .and. .not. x%problem%adaptive) stages = stages - 1
  end function stages

  ! Evaluates a vectorized function of time for all remaining stages of the step.
  subroutine evaluate_nodes(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: times(stages(x) - x%stage + 1)
    real(wp) :: members(size(times)), answer(size(x%slope) * size(times))
    logical :: failed
    integer :: k

    associate (method => x%problem%method)
      times = within_segment(x, x%t + method%c(x%stage:stages(x)) * x%h)
      members = real(x%member - 1, wp)
      call x%problem%frame%callback%apply(fields_operation, [times, members], x%y(:, 0), answer, &
                                            failed)
      x%counts%nfev = x%counts%nfev + size(times, kind=int64)
      if (failed) then
        call fail(x, raised, x%t)
        return
      else if (.not. finite(size(answer), answer)) then
        call reject_stage(x, field_not_finite, x%t)
        return
      end if
      do k = 1, size(times)
        x%request%received(:) = answer((k - 1) * size(x%slope) + 1:k * size(x%slope))
        call store_stage(x)
        if (x%phase /= phase_next_stage) return
      end do
      x%phase = phase_finish_step
    end associate
  end subroutine evaluate_nodes

  ! Stores the coefficients at a stage. On a Lie algebra they become derivatives of coordinates.
  subroutine store_stage(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    associate (method => x%problem%method)
      if (method%collocation) then
        call store_collocation(x)
        return
      else if (method%implicit) then
        call store_value(x)
        return
      end if
      if (method%two_registers) then
        x%f(:, 1) = method%a(x%stage) * x%f(:, 1) + x%request%received
        call advance_register(x)
      else
        if (.not. associated(x%problem%field)) x%f(:, x%stage) = x%request%received
        if (x%stage == method%final_stage .or. (x%problem%of_time .and. &
                                                .not. abs(method%c(x%stage) - 1) > 0)) then
          x%end_slope(:) = x%f(:, x%stage)
          x%end_known = .true.
        end if
        if (method%on_algebra .and. method%stage_path(x%stage) > 0) then
          if (x%path_of_u /= method%stage_path(x%stage)) then
            call combine_coordinates(method, method%stage_path(x%stage), x)
          end if
          call dexpinv(x%problem%frame, method%series, x%u, x%f(:, x%stage), exists)
          if (.not. exists) then
            call reject_stage(x, step_too_long, x%t)
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
  subroutine follow_paths(x, last)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: last
    integer :: i, begin, end

    associate (method => x%problem%method, frame => x%problem%frame)
      do i = x%paths + 1, last
        if (x%problem%of_time .and. .not. method%leads(i)) cycle
        begin = method%path_first(i)
        end = method%path_first(i + 1)
        call copy(frame%point_size, x%y(:, method%origin(i)), x%y(:, i))
        if (method%on_algebra) then
          call combine_coordinates(method, i, x)
          call apply_flows(frame, 1, x%u, x%y(:, i))
        else if (method%splitting) then
          call move_by_kicks(frame, method%flows, x%weight, x%h * method%drift, begin, end - 1, &
                             x%f, x%y(:, i))
        else
          call combine_flows(method%flows, x%weight, begin, end - 1, frame%dimension, x%f, x%v)
          if (method%polynomial) frame%blocks%action%granted = &
            abs(x%h) / max(abs(x%h), x%problem%duration)
          call apply_flows(frame, end - begin, x%v, x%y(:, i))
          if (method%polynomial) frame%blocks%action%granted = 0.0_wp
        end if
        if (i == method%result .or. i == method%embedded) call restore(frame, x%y(:, i))
        x%counts%nexp = x%counts%nexp + int(merge(1, end - begin, method%polynomial), int64)
      end do
      x%paths = max(x%paths, last)
    end associate
  end subroutine follow_paths

  ! Computes the coordinates of the end of a path that has one flow.
  subroutine combine_coordinates(method, path, x)
    type(method_t), intent(in) :: method
    integer, intent(in) :: path
    type(trajectory_t), intent(inout) :: x

    x%path_of_u = path
    associate (flow => method%path_first(path))
      call combine_flows(method%flows, x%weight, flow, flow, size(x%u), x%f, x%u)
    end associate
  end subroutine combine_coordinates

  ! Moves the point of a two-register method along h b Z.
  subroutine advance_register(x)
    type(trajectory_t), intent(inout) :: x

    x%u = (x%h * x%problem%method%b(x%stage)) * x%f(:, 1)
    call apply_flows(x%problem%frame, 1, x%u, x%y(:, 1))
    call restore(x%problem%frame, x%y(:, 1))
    x%counts%nexp = x%counts%nexp + 1
  end subroutine advance_register

  ! Computes the brackets of the fields at the stages, times the step size.
  subroutine add_brackets(x)
    type(trajectory_t), intent(inout) :: x
    real(wp), dimension(x%problem%frame%dimension) :: u, v
    integer :: j, k

    associate (problem => x%problem, weight => x%problem%method%bracket)
      do j = 1, size(weight, 3)
        u = 0.0_wp
        v = 0.0_wp
        do k = 1, size(problem%method%c) + j - 1
          u = u + (x%h * weight(k, 1, j)) * x%f(:, k)
          v = v + weight(k, 2, j) * x%f(:, k)
        end do
        call bracket(problem%frame, u, v, x%f(:, size(problem%method%c) + j))
      end do
    end associate
  end subroutine add_brackets

  ! Computes the results and estimates the error.
  subroutine finish_step(x)
    type(trajectory_t), intent(inout) :: x
    integer :: last

    associate (method => x%problem%method)
      if (.not. method%two_registers) then
        last = method%result
        if (x%problem%adaptive) last = max(last, method%embedded, method%third)
        call add_brackets(x)
        call follow_paths(x, last)
      end if
      x%phase = phase_decide_step
      if (x%problem%adaptive) then
        x%error = huge(1.0_wp)
        if (finite(size(x%y, 1), x%y(:, x%result))) call estimate_error(x)
        if (method%collocation .and. x%error > 1 .and. x%error < huge(1.0_wp) &
            .and. (x%control%after_rejection .or. x%newton%moved &
                   .or. .not. abs(x%newton%last_h) > 0)) then
          call request_error(x)
        else
          call share_error(x, x%error)
        end if
      else if (.not. finite(size(x%y, 1), x%y(:, x%result))) then
        call fail(x, solution_not_finite, x%t_end)
      end if
    end associate
  end subroutine finish_step

  ! Requests the coefficients at the start displaced by the estimated error, with which the estimate
  ! is damped once more: with one solution only, stiff components are far too large where they
  ! aren't in equilibrium.
  subroutine request_error(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: y(x%problem%frame%point_size)

    y = x%y(:, 0)
    x%u = -x%u
    call apply_flows(x%problem%frame, 1, x%u, y)
    x%counts%nexp = x%counts%nexp + 1
    call request(x, x%t, y, phase_error_received, x%request%received)
  end subroutine request_error

  ! Stores these coefficients and estimates the error again.
  subroutine store_error(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%request%received
    call estimate_error(x)
    call share_error(x, x%error)
  end subroutine store_error

  ! Accepts a step, or rejects it and chooses a smaller size.
  subroutine accept_or_reject(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: predicted, error

    associate (exponent => x%problem%tolerances%exponent, control => x%control, &
               newton => x%newton, collocation => x%problem%method%collocation)
      x%phase = phase_accepted
      predicted = 0.0_wp
      if (x%problem%adaptive) then
        ! trajectories with common steps must choose the same size
        if (collocation) predicted = predicted_size( &
          abs(x%h), x%request%shared, exponent, merge(1, newton%iteration, x%problem%common), &
          x%problem%common .or. converges_fast(x), abs(newton%last_h), control%last_error)
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
        ! a step that was shortened shortens the next one only as far as its error does
        if (control%shortened .and. .not. control%after_rejection) &
          control%step_size = max(control%step_size, resumed_size( &
            control%unshortened_size, abs(x%h), error, exponent))
        control%after_rejection = .false.
        control%suspicion = max(control%suspicion - 1, 0)
        if (x%problem%method%has_nodes) then
          x%f_before(:, :) = x%f
          x%h_before = x%h
        end if
      end if
      if (collocation) call keep_step(x)
    end associate
  end subroutine accept_or_reject

end module step_m
