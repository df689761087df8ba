! Interface for f2py of the order conditions, of lmdif on them, and of conversions between kinds.
! Numbers of the wide kind are arrays of bytes in Python, and so scalars have length one here.
module api_m
  use, intrinsic :: iso_fortran_env, only: real64
  use conditions_m, only: order_conditions_t
  use kinds, only: wp
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  use shared_numbers, only: first_result
  use tree_tables, only: highest => highest_order
  implicit none

contains

  ! To double and back, rounded to nearest.
  subroutine to_double(n, x, y) bind(c)
    !f2py threadsafe
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)
    real(real64), intent(out) :: y(n)

    y = real(x, real64)
  end subroutine to_double

  subroutine from_double(n, x, y) bind(c)
    !f2py threadsafe
    integer, intent(in) :: n
    real(real64), intent(in) :: x(n)
    real(wp), intent(out) :: y(n)

    y = real(x, wp)
  end subroutine from_double

  ! The highest order for which there are trees
  subroutine highest_order(order) bind(c)
    !f2py threadsafe
    integer, intent(out) :: order

    order = highest
  end subroutine highest_order

  ! The residuals of order_conditions_t; a zero in the list of trees gives a zero.
  subroutine residuals(order, l, layout, n, x, m, trees, owner, r) bind(c)
    !f2py threadsafe
    integer, intent(in) :: order, l, n, m, layout(l)       ! layout: see read_layout
    real(wp), intent(in) :: x(n)
    integer, intent(in) :: trees(m), owner(m)
    real(wp), intent(out) :: r(m)
    type(order_conditions_t) :: conditions
    integer :: outcome

    outcome = 0
    call conditions%set_up(order, layout, trees, owner)
    call conditions%residual(x, r, outcome)
  end subroutine residuals

  ! The derivatives of the residuals by the unknowns
  subroutine jacobian(order, l, layout, n, x, m, trees, owner, jac) bind(c)
    !f2py threadsafe
    integer, intent(in) :: order, l, n, m, layout(l)       ! layout: see read_layout
    real(wp), intent(in) :: x(n)
    integer, intent(in) :: trees(m), owner(m)
    real(wp), intent(out) :: jac(m, n)
    type(order_conditions_t) :: conditions
    integer :: outcome

    outcome = 0
    call conditions%set_up(order, layout, trees, owner)
    call conditions%jacobian(x, jac, outcome)
  end subroutine jacobian

  ! MINPACK's lmdif on the order conditions. A zero in the list of trees adds a row of zeros.
  subroutine fit_lmdif(order, l, layout, n, x0, m, trees, ftol, xtol, maxfev, stop_flag, x, &
                       f, info, nfev) bind(c)
    !f2py threadsafe
    integer, intent(in) :: order, l, n, m, layout(l)       ! layout: see read_layout
    real(wp), intent(in) :: x0(n)                          ! packed weights
    integer, intent(in) :: trees(m), maxfev
    real(wp), intent(in) :: ftol(1), xtol(1)
    integer, intent(inout), target :: stop_flag(1)  ! zero; set by another thread to end the fit
    real(wp), intent(out) :: x(n), f(1)                    ! f: sum of squared residuals
    integer, intent(out) :: info, nfev
    type(order_conditions_t) :: conditions
    type(lmdif_t) :: solver
    real(wp) :: residual(m)

    call conditions%set_up(order, layout, trees, spread(first_result, 1, m))
    conditions%stop_flag => stop_flag(1)
    x = x0
    solver = lmdif_t(ftol=ftol(1), xtol=xtol(1), maxfev=maxfev)
    call lmdif(conditions, x, residual, solver)
    info = solver%info
    nfev = solver%nfev
    f(1) = sum(residual**2)
  end subroutine fit_lmdif

end module api_m
