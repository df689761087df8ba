! Interface for f2py of lmdif on a function in Python, in double precision.
! It is never `threadsafe`, since the function needs the interpreter's lock.
module api_lmdif_m
  use, intrinsic :: iso_c_binding, only: c_intptr_t, c_null_ptr
  use callback_m, only: callback_t
  use kinds, only: wp
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  use linalg_m, only: least_squares_t
  use shared_numbers, only: residual_operation, stopped_by_user
  implicit none
  private
  public :: lmdif_of_python

  type, extends(least_squares_t) :: python_function_t
    type(callback_t) :: python
  contains
    procedure :: residual
  end type python_function_t

contains

  subroutine residual(self, x, f, flag)
    class(python_function_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)   ! (n)
    real(wp), intent(out) :: f(:)  ! (m)
    integer, intent(inout) :: flag
    logical :: failed

    call self%python%apply(residual_operation, x, x(:0), f, failed)
    if (failed) flag = stopped_by_user
  end subroutine residual

  subroutine lmdif_of_python(context, n, m, x0, diag, ftol, xtol, gtol, maxfev, epsfcn, &
                             factor, x, fvec, info, nfev, fjac, ipvt, qtf) bind(c)
    integer(c_intptr_t), intent(in) :: context     ! the function
    integer, intent(in) :: n, m, maxfev
    real(wp), intent(in) :: diag(n)                ! zeros if it isn't given
    real(wp), intent(in) :: x0(n), ftol, xtol, gtol, epsfcn, factor
    real(wp), intent(out) :: x(n), fvec(m), fjac(m, n), qtf(n)
    integer, intent(out) :: info, nfev, ipvt(n)
    type(python_function_t) :: problem
    type(lmdif_t) :: solver

    problem%python%context = transfer(context, c_null_ptr)
    solver = lmdif_t(ftol=ftol, xtol=xtol, gtol=gtol, maxfev=maxfev, epsfcn=epsfcn, &
                     factor=factor)
    if (all(diag > 0)) solver%diag = diag
    x = x0
    call lmdif(problem, x, fvec, solver)
    info = solver%info
    nfev = solver%nfev
    fjac = solver%fjac
    ipvt = solver%ipvt
    qtf = solver%qtf
  end subroutine lmdif_of_python

end module api_lmdif_m
