! Starts segments, the times between two breakpoints, and chooses the sizes of steps; the first size
! follows Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", section II.4.
!
! Variable steps of symmetric methods that stay reversible: E. Hairer, G. Söderlind, "Explicit, time
! reversible, adaptive step size control", SIAM J. Sci. Comput. 26 (2005). The user's function s of
! the configuration says how steps vary, h s. Their density rho_(n + 1/2) = rho_(n - 1/2) -
! h d/dt log s(q_n) is carried from step to step, at first from 1 / s by half as much. A step is
! h / rho_(n + 1/2). Backward, the derivative changes its sign.
module step_size_m
  use kinds, only: wp
  use controller_m, only: first_guess, first_size, resolution, tried_size
  use coordinates_m, only: error_norm, error_scales, point_sizes, tangent
  use free_motion_m, only: add_free_motion
  use frames_m, only: apply_flows, restore, turning
  use inputs_m, only: max_step_at, make_grid
  use requests_m, only: evaluate_at_start, request, share
  use step_events_m, only: max_adaptive_angle
  use phases_m
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: copy
  use shared_numbers, only: max_growth, no_stop, raised, slope_not_finite, splitting_kind, &
                            step_function_failed, step_too_small, time_not_finite, too_many_steps
  implicit none
  private
  public :: begin_segment, choose_step, choose_first_size, guess_size, receive_slope, &
            request_curvature

contains

  ! Starts the next segment that isn't empty, or ends the trajectory.
  subroutine begin_segment(x)
    type(trajectory_t), intent(inout) :: x

    ! a stop may lie behind: f isn't evaluated beyond it
    if ((x%problem%stops(x%segment) - x%t) &
        * sign(1.0_wp, x%problem%stops(size(x%problem%stops)) - x%t) <= 0) then
      if (x%segment == size(x%problem%stops)) then
        x%phase = phase_ended
      else
        x%segment = x%segment + 1
      end if
      return
    end if
    if (x%problem%events%count > 0 .and. .not. x%events_known) then
      call evaluate_at_start(x)
      if (x%status /= no_stop) return
    end if
    associate (stop => x%problem%stops(x%segment))
      ! an interrupted segment goes on with its grid
      if (.not. (x%problem%adaptive .or. x%problem%step_function%count > 0) .and. ( &
          x%grid%stop /= stop .or. x%grid%start + real(x%grid%done, wp) * x%grid%step /= x%t)) then
        call make_grid(x%t, stop, x%problem%record%h, x%grid)
      end if
      x%h = sign(x%h, stop - x%t)
    end associate
    x%phase = phase_choose_step
    if (x%problem%adaptive .and. .not. x%control%step_size > 0) then
      x%phase = phase_guess_size
      if (.not. x%slope_known) call request(x, x%t, x%y(:, 0), phase_start_received)
    end if
  end subroutine begin_segment

  ! Guesses a first size from the norms of the point and of its derivative.
  subroutine guess_size(x)
    type(trajectory_t), intent(inout) :: x

    associate (norms => x%norms, control => x%control, y => x%y(:, 0))
      call error_scales(x%frame, x%tolerances, y, y, norms%difference, norms%scale)
      call point_sizes(x%frame, x%tolerances, y, norms%difference)
      control%point_norm = error_norm(x%tolerances, norms%difference, norms%scale)
      call tangent(x%frame, x%tolerances, x%slope, y, norms%change)
      control%slope_norm = error_norm(x%tolerances, norms%change, norms%scale)
      if (abs(control%slope_norm) <= huge(1.0_wp)) then
        call share(x, -first_guess(control%point_norm, control%slope_norm, span(x)), &
                   phase_guess_shared)
      else
        call fail(x, slope_not_finite, x%t)
      end if
    end associate
  end subroutine guess_size

  ! Requests the coefficients at the end of a step of the guessed size, which give the curvature.
  subroutine request_curvature(x)
    type(trajectory_t), intent(inout) :: x

    associate (ahead => x%y(:, x%result))
      x%control%guessed_size = bounded(x, -x%request%shared)
      x%h = sign(x%control%guessed_size, x%problem%stops(x%segment) - x%t)
      call copy(size(ahead), x%y(:, 0), ahead)
      x%v(:, 1) = x%h * x%slope
      call apply_flows(x%frame, 1, x%v, ahead)
      call restore(x%frame, ahead)
      x%counts%nexp = x%counts%nexp + 1
      call request(x, x%t + x%h, ahead, phase_curvature_received)
    end associate
  end subroutine request_curvature

  ! Chooses the first size by the curvature, the change of the slope over the guessed size.
  subroutine choose_first_size(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: curvature, h

    h = x%control%guessed_size
    if (all(abs(x%request%answer) < huge(1.0_wp))) then
      call tangent(x%frame, x%tolerances, x%slope, x%y(:, 0), x%norms%change)
      call tangent(x%frame, x%tolerances, x%request%answer, x%y(:, x%result), x%norms%difference)
      curvature = error_norm(x%tolerances, x%norms%difference - x%norms%change, x%norms%scale) / h
      h = bounded(x, min(max_growth * h, first_size( &
        x%control%point_norm, x%control%slope_norm, curvature, x%tolerances%exponent)))
    end if
    call share(x, -h, phase_size_shared)
  end subroutine choose_first_size

  ! The time to the end of the segment
  pure real(wp) function span(x)
    type(trajectory_t), intent(in) :: x

    span = abs(x%problem%stops(x%segment) - x%t)
    if (.not. span <= huge(span)) span = 1.0_wp        ! no end: one unit of time
  end function span

  ! A first size, bounded by the span and max_step, and at least the rounding of t
  pure real(wp) function bounded(x, h)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: h

    bounded = max(min(h, span(x), x%tolerances%max_step), &
                  min(nearest(abs(x%t), 1.0_wp) - abs(x%t), span(x)))
  end function bounded

  ! Stores the coefficients at the start, by which a size may be chosen, or chosen again.
  subroutine receive_slope(x)
    type(trajectory_t), intent(inout) :: x

    x%slope(:) = x%request%answer
    x%slope_known = .true.
    x%phase = phase_next_stage
    if (.not. x%problem%adaptive) return
    if (x%control%step_size > max_step_by_turn(x)) then      ! which the slope has just limited
      x%control%attempts = x%control%attempts - 1
      x%phase = phase_choose_step
    end if
    if (.not. x%control%step_size > 0) x%phase = phase_guess_size
  end subroutine receive_slope

  ! The longest step where events are looked for in each part of a turn: as far as a step is
  ! accepted at all; a turn where there is no end, so that steps of ever more don't take ever longer
  pure real(wp) function max_step_by_turn(x)
    type(trajectory_t), intent(in) :: x
    real(wp), parameter :: turn = 1.98_wp * acos(-1.0_wp)    ! before the pole of dexp^-1 at 2 pi
    real(wp) :: longest, rate                ! an angle, and how many of them in a unit of time

    max_step_by_turn = x%tolerances%max_step
    if (x%problem%record%common .or. .not. x%slope_known .or. size(x%events) == 0) return
    longest = merge(turn, 0.9_wp * max_adaptive_angle, abs(x%problem%stops(x%segment)) > huge(rate))
    rate = turning(x%frame, x%slope, fields=.false.) / longest
    if (rate * max_step_by_turn > 1) max_step_by_turn = 1 / rate
  end function max_step_by_turn

  ! Chooses the size of a step and starts it. Full steps of a grid are exactly equal.
  subroutine choose_step(x)
    type(trajectory_t), intent(inout) :: x

    if (x%control%attempts >= x%problem%record%max_steps) call fail(x, too_many_steps, x%t)
    if (x%status /= no_stop) return
    x%control%attempts = x%control%attempts + 1
    if (x%problem%step_function%count > 0) then
      call choose_reversibly(x, x%problem%stops(x%segment))
    else if (x%problem%adaptive) then
      call choose_adaptively(x, x%problem%stops(x%segment))
    else
      x%h = x%grid%step
      x%t_end = x%grid%start + real(x%grid%done + 1, wp) * x%grid%step
      if (x%grid%done + 1 == x%grid%steps) then
        x%h = x%grid%last
        x%t_end = x%problem%stops(x%segment)
      end if
    end if
    if (x%status /= no_stop) return
    x%weight(:) = x%h * x%method%flows%weight
    x%stage = 1
    x%collocation%iteration = 0
    x%implicit%first_stage = 0
    x%paths_followed = 0
    x%end_known = .false.
    x%phase = phase_next_stage
    ! splitting methods that begin with a drift need no force at the start
    if (x%method%kind == splitting_kind .and. x%method%c(1) /= 0) return
    if (.not. x%slope_known) call request(x, x%t, x%y(:, 0), phase_start_received)
  end subroutine choose_step

  ! Chooses the size and the end of the next step: the proposed one, within limits.
  subroutine choose_adaptively(x, stop)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: stop
    ! Sums of stages over a step don't overflow before it; an infinite step isn't made shorter.
    real(wp), parameter :: max_time = 1e-3_wp * huge(1.0_wp)
    real(wp) :: longest, min_size

    min_size = resolution(x%t)
    associate (control => x%control, max_step => x%tolerances%max_step)
      longest = max(max_step_at(x%problem%step_limits, x%t, stop - x%t), min_size)
      control%unshortened_size = min(control%step_size, max_step)
      control%step_size = tried_size(control%step_size, min_size, abs(stop - x%t), &
                                     min(max_step_by_turn(x), longest), control%after_rejection)
      if (control%step_size < 0) then
        if (.not. (x%problem%record%common .and. x%estimate%error <= 1)) then
          call fail(x, step_too_small, x%t)
          return
        end if
        ! others with common steps fail here, and this one goes on without them
        control%step_size = min(min_size, abs(stop - x%t), max_step)
      end if
      x%h = sign(control%step_size, stop - x%t)
      x%t_end = x%t + x%h
      ! A rest that is smaller than the smallest step belongs to this step.
      control%shortened = (x%t_end - stop) * sign(1.0_wp, x%h) >= -min_size
      if (control%shortened) x%t_end = stop
      control%shortened = control%shortened .or. control%unshortened_size > longest
      x%h = x%t_end - x%t
      if (abs(stop) > huge(stop) .and. .not. abs(x%t_end) <= max_time) &
        call fail(x, time_not_finite, x%t)
    end associate
  end subroutine choose_adaptively

  ! Chooses the size and the end of the next step. A stop doesn't change the size after it.
  subroutine choose_reversibly(x, stop)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: stop
    real(wp) :: v(x%frame%dimension), values(-1:1), offset, log_change, density
    real(wp), parameter :: probe = 1e-2_wp   ! the fraction of a step in the difference of s
    integer :: i

    v = 0.0_wp
    call add_free_motion(x%frame, x%y(:, 0), v)
    v(x%frame%forces + 1:) = 0.0_wp
    call evaluate_size(x, 0 * v, values(0))
    offset = probe * x%problem%record%h * values(0)
    do i = -1, 1, 2
      if (x%status /= raised) call evaluate_size(x, real(i, wp) * offset * v, values(i))
    end do
    if (x%status == raised) return
    log_change = sign(1.0_wp, stop - x%t) * x%problem%record%h * log(values(1) / values(-1)) &
                 / (2 * offset)
    if (x%control%step_size > 0) then
      density = x%problem%record%h / x%control%step_size - log_change
    else
      density = 1 / values(0) - log_change / 2
    end if
    if (density > 0) x%control%step_size = x%problem%record%h / density
    x%h = sign(x%control%step_size, stop - x%t)
    x%t_end = x%t + x%h
    if (.not. (density > 0 .and. x%t_end /= x%t)) call fail(x, step_too_small, x%t)
    if (abs(x%t_end - x%t) < (1 - epsilon(1.0_wp)) * abs(stop - x%t)) return
    x%t_end = stop
    x%h = stop - x%t
  end subroutine choose_reversibly

  ! Evaluates the function at the end of a flow; the trajectory fails unless it is positive.
  subroutine evaluate_size(x, v, value)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: v(x%frame%dimension)
    real(wp), intent(out) :: value
    real(wp) :: y(x%frame%point_size), values(1)

    y = x%y(:, 0)
    call apply_flows(x%frame, 1, v, y)
    call x%problem%step_function%observe(x%member, x%t, y, values, x%status)
    value = values(1)
    if (x%status == no_stop .and. value > 0 .and. value <= huge(value)) return
    value = 1.0_wp
    call fail(x, raised, x%t, step_function_failed)
  end subroutine evaluate_size

end module step_size_m
