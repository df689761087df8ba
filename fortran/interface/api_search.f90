! Interface for f2py of lmdif on the order conditions.
! It never calls Python, so that threads can run many fits at once.

! MINPACK's lmdif on the order conditions. Zeros in the list of trees are rows of zeros: the
! solver wants at least as many rows as unknowns.
subroutine core_fit_lmdif(order, l, layout, n, x0, m, trees, ftol, xtol, maxfev, stop_flag, &
                           x, f, info, nfev)
  use kinds, only: wp
  use conditions_m, only: order_conditions_t
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  implicit none
  integer, intent(in) :: order, l, n, m, layout(l)       ! layout: see read_layout
  real(wp), intent(in) :: x0(n)               ! packed weights
  integer, intent(in) :: trees(m)
  real(wp), intent(in) :: ftol(1), xtol(1)
  integer, intent(in) :: maxfev
  integer, intent(inout), target :: stop_flag(1)  ! zero; set by another thread to end the fit
  real(wp), intent(out) :: x(n), f(1)                    ! f: sum of squared residuals
  integer, intent(out) :: info, nfev
  type(order_conditions_t) :: conditions
  type(lmdif_t) :: solver
  real(wp) :: residual(m)

  call conditions%set_up(order, layout, trees)
  conditions%stop_flag => stop_flag(1)
  x = x0
  solver = lmdif_t(ftol=ftol(1), xtol=xtol(1), maxfev=maxfev)
  call lmdif(conditions, x, residual, solver)
  info = solver%info
  nfev = solver%nfev
  f(1) = sum(residual**2)
end subroutine core_fit_lmdif
