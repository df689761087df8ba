! The state of a trajectory between steps, as arrays.
module saved_state_m
  use kinds, only: wp
  use inputs_m, only: grid_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: integers_of_state, reals_of_state, terminal_event
  use trajectory_m, only: continue_trajectory, trajectory_t
  implicit none
  private
  public :: load_state, save_state

contains

  ! Copies the state that a trajectory needs between steps to continue bit for bit.
  pure subroutine save_state(x, reals, integers, points, slopes)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(out) :: reals(:)        ! reals_of_state, then of each event five numbers
    integer(int64), intent(out) :: integers(integers_of_state)
    ! (point_size, 2), (dimension, 2 + columns of f, then f_before, impulse, last and jacobian of
    ! newton_t, or lu and pivot of stage_solver_t, which is zero for factors of other step sizes)
    real(wp), intent(out) :: points(:, :), slopes(:, :)
    integer, allocatable :: pivot(:, :)

    reals = [x%t, x%control%step_size, x%control%last_error, x%last%t, x%last%h, x%h, &
             x%newton%last_h, x%newton%rate_factor, x%newton%factored_h, x%grid%start, &
             x%grid%step, x%grid%last, x%grid%stop, x%h_before, x%events%before, &
             x%events%residual, x%events%time, &
             real(x%events%came_from, wp), real(x%events%count, wp)]
    integers = [transfer(x%counts, integers), merge(1_int64, 0_int64, &
                [x%slope_known, x%events%known, x%control%after_rejection, &
                 x%newton%has_jacobian, x%newton%fresh, x%newton%moved]), &
                int(x%control%suspicion, int64), x%control%attempts, x%grid%steps, x%grid_done]
    integers(1) = int(x%status, int64)       ! counts have it in results alone
    points = spread(x%y(:, 0), 2, 2)
    slopes(:, :2) = spread(x%slope, 2, 2)
    slopes(:, 3:2 + size(x%f, 2)) = x%f
    associate (rest => slopes(:, 3 + size(x%f, 2):), solver => x%solver)
      if (allocated(x%f_before)) then
        rest = x%f_before
      else if (allocated(x%joints%impulse)) then
        rest = reshape(x%joints%impulse, shape(rest))
      else if (allocated(x%newton%last)) then
        rest = reshape([x%newton%last, x%newton%jacobian], shape(rest))
      else if (allocated(solver%lu)) then
        pivot = merge(0, solver%pivot, &
                      spread(solver%factored_h /= x%h, 1, size(solver%pivot, 1)))
        rest = reshape([solver%lu, real(pivot, wp)], shape(rest))
      end if
    end associate
    if (allocated(x%last%y)) points(:, 2) = x%last%y
    if (allocated(x%last%slope)) slopes(:, 2) = x%last%slope
  end subroutine save_state

  ! Restores what save_state has copied.
  pure subroutine load_state(x, reals, integers, points, slopes)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: reals(:)
    integer(int64), intent(in) :: integers(integers_of_state)
    real(wp), intent(in) :: points(:, :), slopes(:, :)
    real(wp), allocatable :: numbers(:)

    x%t = reals(1)
    x%control%step_size = reals(2)
    x%control%last_error = reals(3)
    x%last%t = reals(4)
    x%last%h = reals(5)
    x%h = reals(6)
    x%newton%last_h = reals(7)
    x%newton%rate_factor = reals(8)
    x%counts = transfer(integers(:8), x%counts)
    x%slope_known = integers(9) == 1
    x%events%known = integers(10) == 1
    x%control%after_rejection = integers(11) == 1
    x%newton%has_jacobian = integers(12) == 1
    x%newton%fresh = integers(13) == 1
    x%newton%moved = integers(14) == 1
    x%control%suspicion = int(integers(15))
    x%control%attempts = integers(16)
    x%y(:, 0) = points(:, 1)
    x%slope = slopes(:, 1)
    x%last%y = points(:, 2)
    x%last%slope = slopes(:, 2)
    x%f = slopes(:, 3:2 + size(x%f, 2))
    x%newton%factored_h = reals(9)
    x%grid = grid_t(reals(10), reals(11), reals(12), reals(13), integers(17))
    x%grid_done = integers(18)
    x%h_before = reals(14)
    associate (events => x%events, n => size(x%events%before), k => reals_of_state)
      events%before = reals(k + 1:k + n)
      events%residual = reals(k + n + 1:k + 2 * n)
      events%time = reals(k + 2 * n + 1:k + 3 * n)
      events%came_from = nint(reals(k + 3 * n + 1:k + 4 * n))
      events%count = nint(reals(k + 4 * n + 1:k + 5 * n), int64)
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
        numbers = reshape(rest, [size(rest)])
        solver%lu = reshape(numbers, shape(solver%lu))
        solver%pivot = reshape(nint(numbers(size(solver%lu) + 1:)), shape(solver%pivot))
        solver%factored_h = merge(x%h, 0.0_wp, any(solver%pivot > 0, dim=1))
      end if
    end associate
    x%weighted_by = 0.0_wp
    call continue_trajectory(x)
    if (integers(1) == terminal_event) x%status = terminal_event
  end subroutine load_state

end module saved_state_m
