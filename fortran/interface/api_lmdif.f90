! Interface for f2py of lmdif on a function in Python, in double precision.
! It is never `threadsafe`, since the function needs the interpreter's lock.
module lmdif_callback_m
  use, intrinsic :: iso_fortran_env, only: real64
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  use linalg_m, only: least_squares_t
  implicit none
  private
  public :: core_lmdif_callback

  abstract interface
    subroutine evaluate_i(n, x, m, f, flag) bind(c)
      import :: real64
      integer, intent(in) :: n, m
      real(real64), intent(in) :: x(n)
      real(real64), intent(out) :: f(m)
      integer, intent(out) :: flag
    end subroutine evaluate_i
  end interface

  type, extends(least_squares_t) :: callback_t
    procedure(evaluate_i), pointer, nopass :: evaluate => null()
  contains
    procedure :: residual
  end type callback_t

contains

  subroutine residual(self, x, f, flag)
    class(callback_t), intent(inout) :: self
    real(real64), intent(in) :: x(:)   ! (n)
    real(real64), intent(out) :: f(:)  ! (m)
    integer, intent(inout) :: flag

    call self%evaluate(size(x), x, size(f), f, flag)
  end subroutine residual

  subroutine core_lmdif_callback(evaluate, n, m, x, fvec, ftol, xtol, gtol, maxfev, epsfcn, diag, &
      mode, factor, info, nfev, fjac, ipvt, qtf) bind(c)
    procedure(evaluate_i) :: evaluate
    integer, intent(in) :: n, m, maxfev, mode
    real(real64), intent(inout) :: x(n), diag(n)
    real(real64), intent(in) :: ftol, xtol, gtol, epsfcn, factor
    real(real64), intent(out) :: fvec(m), fjac(m, n), qtf(n)
    integer, intent(out) :: info, nfev, ipvt(n)
    type(callback_t) :: problem
    type(lmdif_t) :: solver

    problem%evaluate => evaluate
    solver = lmdif_t(ftol=ftol, xtol=xtol, gtol=gtol, maxfev=maxfev, epsfcn=epsfcn, mode=mode, &
                      factor=factor, diag=diag)
    call lmdif(problem, x, fvec, solver)
    diag = solver%diag
    info = solver%info
    nfev = solver%nfev
    fjac = solver%fjac
    ipvt = solver%ipvt
    qtf = solver%qtf
  end subroutine core_lmdif_callback

end module lmdif_callback_m
