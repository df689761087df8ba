! Where segments begin, and how large steps are.
! A segment is what lies between two breakpoints.
module step_size_m
  use kinds, only: wp
  use controller_m, only: first_guess, first_size, tried_size
  use error_norm_m, only: norm, point_sizes, scales, tangent
  use frames_m, only: flow_along, restore
  use time_grid_m, only: make_grid
  use trajectory_m, only: choose_step, copy, ended, evaluate_events, fail, guess_first, known_curvature, &
                              known_start, problem_t, request, shared_guess, shared_size, take_stage, &
                              trajectory_t
  use shared_numbers, only: needs_minimum, slope_not_finite, step_too_small, &
                            too_many_steps
  implicit none
  private
  public :: begin, choose, choose_size, guess, try_guess

contains

  subroutine begin(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: values(size(trajectory%value))
    logical :: stopped

    if (.not. abs(problem%stops(trajectory%segment) - trajectory%t) > 0) then
      if (trajectory%segment == size(problem%stops)) then
        trajectory%phase = ended
      else
        trajectory%segment = trajectory%segment + 1
      end if
      return
    end if
    associate (stop => problem%stops(trajectory%segment))
      if (.not. problem%adaptive) then
        call make_grid(trajectory%t, stop, problem%h, trajectory%grid)
        trajectory%done = 0
      end if
      trajectory%h = sign(trajectory%h, stop - trajectory%t)
    end associate
    trajectory%phase = choose_step
    if (problem%adaptive .and. .not. trajectory%size > 0) then
      trajectory%phase = guess_first
      if (.not. trajectory%known) then
        call request(problem, trajectory, trajectory%t, trajectory%y(:, 0), known_start)
      end if
    end if
    if (.not. associated(problem%events)) return
    if (any(trajectory%count > 0) .or. trajectory%steps > 0) return
    call evaluate_events(problem, trajectory, trajectory%t, trajectory%y(:, 0), values, stopped)
    if (.not. stopped) trajectory%value = values
  end subroutine begin

  ! A first size from the norms of the point and of its derivative
  subroutine guess(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (frame => problem%frame, tolerances => problem%tolerances, x => trajectory)
      call scales(frame, tolerances, x%y(:, 0), x%y(:, 0), x%spare, x%scale)
      call point_sizes(frame, tolerances, x%y(:, 0), x%v)
      x%norms(1) = norm(tolerances, x%v, x%scale)
      call tangent(frame, tolerances, x%slope, x%y(:, 0), x%v)
      x%norms(2) = norm(tolerances, x%v, x%scale)
      if (.not. abs(x%norms(2)) <= huge(1.0_wp)) then
        call fail(trajectory, slope_not_finite, x%t)
        return
      end if
      x%shared = first_guess(x%norms(1), x%norms(2), span(problem, trajectory))
    end associate
    trajectory%phase = shared_guess
    if (problem%common) trajectory%status = needs_minimum
  end subroutine guess

  ! The coefficients where the first guess leads tell the curvature.
  subroutine try_guess(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory, moved => trajectory%y(:, trajectory%result))
      x%guess = max(min(x%shared, span(problem, x), problem%tolerances%max_step), &
                    smallest_first(problem, x))
      x%h = sign(x%guess, problem%stops(x%segment) - x%t)
      call copy(size(moved), x%y(:, 0), moved)
      x%u = x%h * x%slope
      call flow_along(problem%frame, x%u, moved)
      call restore(problem%frame, moved)
      x%nexp = x%nexp + 1
      call request(problem, x, x%t + x%h, moved, known_curvature)
    end associate
  end subroutine try_guess

  subroutine choose_size(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: start_value(size(trajectory%v))

    associate (x => trajectory, tolerances => problem%tolerances)
      x%shared = x%guess
      if (all(abs(x%got) < huge(1.0_wp))) then
        call tangent(problem%frame, tolerances, x%slope, x%y(:, 0), start_value)
        call tangent(problem%frame, tolerances, x%got, x%y(:, x%result), x%v)
        x%norms(3) = norm(tolerances, x%v - start_value, x%scale)
        x%shared = first_size(x%norms(1), x%norms(2), x%norms(3) / x%guess, tolerances%exponent)
        x%shared = max(min(100 * x%guess, x%shared, span(problem, x), tolerances%max_step), &
                       smallest_first(problem, x))
      end if
    end associate
    trajectory%phase = shared_size
    if (problem%common) trajectory%status = needs_minimum
  end subroutine choose_size

  pure real(wp) function span(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory

    span = abs(problem%stops(trajectory%segment) - trajectory%t)
    if (.not. span <= huge(span)) span = 1.0_wp        ! no end: a unit of time tells as little
  end function span

  ! Not zero, however tiny the span
  pure real(wp) function smallest_first(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory

    smallest_first = min(nearest(abs(trajectory%t), 1.0_wp) - abs(trajectory%t), &
                         span(problem, trajectory))
  end function smallest_first

  ! Full steps of a grid take its step itself, not differences of rounded times, so that all are
  ! equal.
  subroutine choose(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory, stop => problem%stops(trajectory%segment))
      if (.not. problem%adaptive) then
        x%h = x%grid%step
        x%end = x%grid%start + real(x%done + 1, wp) * x%grid%step
        if (x%done + 1 == x%grid%steps) then
          x%h = x%grid%last
          x%end = stop
        end if
      else
        if (x%attempts >= problem%max_steps) then
          call fail(x, too_many_steps, x%t)
          return
        end if
        x%size = tried_size(x%size, x%t, stop, problem%tolerances%max_step, x%after_rejection)
        if (x%size < 0) then
          call fail(x, step_too_small, x%t)
          return
        end if
        x%attempts = x%attempts + 1
        x%wanted_size = x%size
        x%h = sign(x%size, stop - x%t)
        x%end = x%t + x%h
        x%shortened = (x%end - stop) * sign(1.0_wp, x%h) >= 0
        if (x%shortened) x%end = stop
        x%h = x%end - x%t
      end if
      if (abs(x%h - x%weighted_by) > 0) then
        x%flows%weight(:) = x%h * problem%method%flows%weight
        x%weighted_by = x%h
      end if
      x%stage = 1
      x%paths = 0
      x%path_of_u = 0
      x%end_known = .false.
      x%phase = take_stage
      if (.not. x%known) call request(problem, x, x%t, x%y(:, 0), known_start)
    end associate
  end subroutine choose

end module step_size_m
