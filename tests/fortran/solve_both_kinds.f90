! Solves small problems in one kind and prints what came out, a line each:
! name, info, nfev, |f|, x. Runs with floating-point traps set.
module problems_m
  use kinds, only: wp
  use least_squares_m, only: least_squares_t
  implicit none
  private
  public :: rosenbrock_t, helical_valley_t, bard_t, stubborn_t

  type, extends(least_squares_t) :: rosenbrock_t
  contains
    procedure :: residual => rosenbrock
  end type rosenbrock_t

  type, extends(least_squares_t) :: helical_valley_t
  contains
    procedure :: residual => helical_valley
  end type helical_valley_t

  type, extends(least_squares_t) :: bard_t
  contains
    procedure :: residual => bard
  end type bard_t

  ! Stops the solver with flag -7 once `patience` calls are used up.
  type, extends(least_squares_t) :: stubborn_t
    integer :: patience = 0
  contains
    procedure :: residual => stubborn
  end type stubborn_t

contains

  subroutine rosenbrock(self, x, f, flag)
    class(rosenbrock_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: f(:)
    integer, intent(inout) :: flag

    f = [10 * (x(2) - x(1)**2), 1 - x(1)]
  end subroutine rosenbrock

  subroutine helical_valley(self, x, f, flag)
    class(helical_valley_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: f(:)
    integer, intent(inout) :: flag
    real(wp), parameter :: pi = acos(-1.0_wp)
    real(wp) :: turns

    turns = atan(x(2) / x(1)) / (2 * pi)
    if (x(1) < 0) turns = turns + 0.5_wp
    f = [10 * (x(3) - 10 * turns), 10 * (norm2(x(:2)) - 1), x(3)]
  end subroutine helical_valley

  subroutine bard(self, x, f, flag)
    class(bard_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: f(:)
    integer, intent(inout) :: flag
    integer, parameter :: hundredths(15) = &
        [14, 18, 22, 25, 29, 32, 35, 39, 37, 58, 73, 96, 134, 210, 439]
    real(wp) :: u, v
    integer :: i

    do i = 1, 15
      u = real(i, wp)
      v = 16 - u
      f(i) = real(hundredths(i), wp) / 100 - (x(1) + u / (x(2) * v + x(3) * min(u, v)))
    end do
  end subroutine bard

  subroutine stubborn(self, x, f, flag)
    class(stubborn_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: f(:)
    integer, intent(inout) :: flag

    f = x - 1
    self%patience = self%patience - 1
    if (self%patience < 0) flag = -7
  end subroutine stubborn

end module problems_m

program solve_both_kinds
  use kinds, only: wp
  use least_squares_m, only: least_squares_t
  use linalg_m, only: enorm
  use levenberg_marquardt_m, only: lmdif, solver_t
  use problems_m, only: rosenbrock_t, helical_valley_t, bard_t, stubborn_t
  implicit none
  real(wp), parameter :: eps = epsilon(1.0_wp)
  type(stubborn_t) :: stubborn

  call by_differences('rosenbrock', rosenbrock_t(), 2, [-1.2_wp, 1.0_wp])
  call by_differences('helical-valley', helical_valley_t(), 3, [-1.0_wp, 0.0_wp, 0.0_wp])
  call by_differences('bard', bard_t(), 15, [1.0_wp, 1.0_wp, 1.0_wp])
  call by_differences('too-few-residuals', rosenbrock_t(), 2, [1.0_wp, 1.0_wp, 1.0_wp])

  stubborn%patience = 0
  call by_differences('stops-at-once', stubborn, 2, [5.0_wp, 5.0_wp])
  stubborn%patience = 2
  call by_differences('stops-in-differences', stubborn, 2, [5.0_wp, 5.0_wp])
  stubborn%patience = 3
  call by_differences('stops-at-trial', stubborn, 2, [5.0_wp, 5.0_wp])

  call norm_of('norm-large', [huge(1.0_wp) / 4, huge(1.0_wp) / 4], huge(1.0_wp) / 4)
  call norm_of('norm-small', [tiny(1.0_wp), tiny(1.0_wp)], tiny(1.0_wp))
  call norm_of('norm-mixed', [tiny(1.0_wp), 1.0_wp, 1.0_wp, 1.0e-30_wp], 1.0_wp)
  call norm_of('norm-of-none', [real(wp) ::], 1.0_wp)

contains

  subroutine by_differences(name, problem, m, start)
    character(*), intent(in) :: name
    class(least_squares_t), intent(in) :: problem
    integer, intent(in) :: m
    real(wp), intent(in) :: start(:)
    class(least_squares_t), allocatable :: mine
    type(solver_t) :: solver
    real(wp) :: x(size(start)), f(m)

    allocate (mine, source=problem)
    x = start
    solver = solver_t(ftol=eps, xtol=eps, maxfev=1000)
    call lmdif(mine, x, f, solver)
    call report(name, solver%info, solver%nfev, norm2(f), x)
  end subroutine by_differences

  subroutine norm_of(name, v, unit)
    character(*), intent(in) :: name
    real(wp), intent(in) :: v(:), unit

    call report(name, 0, 0, enorm(v) / unit, v)
  end subroutine norm_of

  subroutine report(name, info, nfev, norm, x)
    character(*), intent(in) :: name
    integer, intent(in) :: info, nfev
    real(wp), intent(in) :: norm, x(:)

    print '(a, 1x, i0, 1x, i0, *(1x, es46.35e4))', name, info, nfev, norm, x
  end subroutine report

end program solve_both_kinds
