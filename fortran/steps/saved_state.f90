! The state of a trajectory between steps, as arrays.
module saved_state_m
  use kinds, only: wp
  use inputs_m, only: grid_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: counters_t, state_record_t, terminal_event
  use trajectory_m, only: continue_trajectory, trajectory_t
  implicit none
  private
  public :: load_state, save_state

contains

  ! Copies the state that a trajectory needs between steps to continue bit for bit.
  pure subroutine save_state(x, numbers, points, slopes)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(out) :: numbers(:)      ! those of state_record_t, then five of each event
    ! (point_size, 2), (dimension, 2 + columns of f, then f_before, impulse, last and jacobian of
    ! newton_t, or lu and pivot of stage_solver_t, which is zero for factors of other step sizes)
    real(wp), intent(out) :: points(:, :), slopes(:, :)
    type(state_record_t) :: state
    integer, allocatable :: pivot(:, :)

    associate (control => x%control, newton => x%newton, grid => x%grid)
      state = state_record_t( &
        t=x%t, h=x%h, h_before=x%h_before, slope_known=flag(x%slope_known), &
        next_step=control%step_size, last_error=control%last_error, &
        after_rejection=flag(control%after_rejection), suspicion=int(control%suspicion, int64), &
        attempts=control%attempts, last_t=x%last%t, last_h=x%last%h, &
        newton_last_h=newton%last_h, newton_rate_factor=newton%rate_factor, &
        newton_factored_h=newton%factored_h, newton_has_jacobian=flag(newton%has_jacobian), &
        newton_fresh=flag(newton%fresh), newton_moved=flag(newton%moved), &
        grid_start=grid%start, grid_step=grid%step, grid_last=grid%last, grid_stop=grid%stop, &
        grid_steps=grid%steps, grid_done=x%grid_done, events_known=flag(x%events%known))
    end associate
    numbers = [transfer(state, numbers), x%events%before, x%events%residual, x%events%time, &
               real(x%events%came_from, wp), real(x%events%count, wp)]
    ! without a last step the second columns repeat the present ones
    points = spread(x%y(:, 0), 2, 2)
    slopes(:, :2) = spread(x%slope, 2, 2)
    if (allocated(x%last%y)) points(:, 2) = x%last%y
    if (allocated(x%last%slope)) slopes(:, 2) = x%last%slope
    slopes(:, 3:2 + size(x%f, 2)) = x%f
    associate (rest => slopes(:, 3 + size(x%f, 2):), solver => x%solver)
      if (allocated(x%f_before)) then
        rest = x%f_before
      else if (allocated(x%joints%impulse)) then
        rest = reshape(x%joints%impulse, shape(rest))
      else if (allocated(x%newton%last)) then
        rest = reshape([x%newton%last, x%newton%jacobian], shape(rest))
      else if (allocated(solver%lu)) then
        pivot = merge(0, solver%pivot, spread(solver%factored_h /= x%h, 1, size(solver%pivot, 1)))
        rest = reshape([solver%lu, real(pivot, wp)], shape(rest))
      end if
    end associate
  end subroutine save_state

  ! Restores what save_state has copied.
  pure subroutine load_state(x, counts, numbers, points, slopes)
    type(trajectory_t), intent(inout) :: x
    type(counters_t), intent(in) :: counts
    real(wp), intent(in) :: numbers(:), points(:, :), slopes(:, :)
    type(state_record_t) :: state
    real(wp), allocatable :: factors(:)

    state = transfer(numbers, state)
    x%counts = counts
    x%t = state%t
    x%h = state%h
    x%h_before = state%h_before
    x%slope_known = state%slope_known == 1
    x%control%step_size = state%next_step
    x%control%last_error = state%last_error
    x%control%after_rejection = state%after_rejection == 1
    x%control%suspicion = int(state%suspicion)
    x%control%attempts = state%attempts
    x%last%t = state%last_t
    x%last%h = state%last_h
    x%newton%last_h = state%newton_last_h
    x%newton%rate_factor = state%newton_rate_factor
    x%newton%factored_h = state%newton_factored_h
    x%newton%has_jacobian = state%newton_has_jacobian == 1
    x%newton%fresh = state%newton_fresh == 1
    x%newton%moved = state%newton_moved == 1
    x%grid = grid_t(state%grid_start, state%grid_step, state%grid_last, state%grid_stop, &
                    state%grid_steps)
    x%grid_done = state%grid_done
    x%events%known = state%events_known == 1
    x%y(:, 0) = points(:, 1)
    x%slope = slopes(:, 1)
    x%last%y = points(:, 2)
    x%last%slope = slopes(:, 2)
    x%f = slopes(:, 3:2 + size(x%f, 2))
    associate (events => x%events, n => size(x%events%before))
      associate (rows => reshape(numbers(size(numbers) - 5 * n + 1:), [n, 5]))
        events%before = rows(:, 1)
        events%residual = rows(:, 2)
        events%time = rows(:, 3)
        events%came_from = nint(rows(:, 4))
        events%count = nint(rows(:, 5), int64)
      end associate
    end associate
    associate (rest => slopes(:, 3 + size(x%f, 2):), solver => x%solver, newton => x%newton)
      if (allocated(x%f_before)) then
        x%f_before = rest
      else if (allocated(x%joints%impulse)) then
        x%joints%impulse = reshape(rest, shape(x%joints%impulse))
      else if (allocated(newton%last)) then
        newton%last = rest(:, :size(newton%last, 2))
        newton%jacobian = rest(:, size(newton%last, 2) + 1:)
      else if (allocated(solver%lu)) then
        factors = reshape(rest, [size(rest)])
        solver%lu = reshape(factors, shape(solver%lu))
        solver%pivot = reshape(nint(factors(size(solver%lu) + 1:)), shape(solver%pivot))
        solver%factored_h = merge(x%h, 0.0_wp, any(solver%pivot > 0, dim=1))
      end if
    end associate
    call continue_trajectory(x)
    if (counts%status == terminal_event) x%status = terminal_event
  end subroutine load_state

  pure integer(int64) function flag(condition)
    logical, intent(in) :: condition

    flag = merge(1_int64, 0_int64, condition)
  end function flag

end module saved_state_m
