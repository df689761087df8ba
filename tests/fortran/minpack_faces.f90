! C faces of the real(8) solver and its linear algebra, for tests that reach
! what the package keeps to itself.
module minpack_faces
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use least_squares_r64, only: differentiable_t
  use linalg_r64, only: enorm, lmpar, qrfac, qrsolv
  use lmder_r64, only: lmder
  implicit none
  private

  abstract interface
    ! f takes the residual if flag is 1, the Jacobian by columns if it is 2.
    subroutine evaluate_i(n, m, x, f, flag) bind(c)
      import :: c_double, c_int
      integer(c_int), value :: n, m
      real(c_double), intent(in) :: x(n)
      real(c_double), intent(inout) :: f(*)
      integer(c_int), intent(inout) :: flag
    end subroutine evaluate_i
  end interface

  type, extends(differentiable_t) :: foreign_t
    procedure(evaluate_i), pointer, nopass :: evaluate => null()
  contains
    procedure :: residual
    procedure :: jacobian
  end type foreign_t

contains

  subroutine residual(self, x, f, flag)
    class(foreign_t), intent(inout) :: self
    real(c_double), intent(in) :: x(:)
    real(c_double), intent(out) :: f(:)
    integer, intent(inout) :: flag

    call self%evaluate(size(x), size(f), x, f, flag)
  end subroutine residual

  subroutine jacobian(self, x, jac, flag)
    class(foreign_t), intent(inout) :: self
    real(c_double), intent(in) :: x(:)
    real(c_double), intent(out) :: jac(:,:)
    integer, intent(inout) :: flag

    call self%evaluate(size(x), size(jac, 1), x, jac, flag)
  end subroutine jacobian

  real(c_double) function face_enorm(n, x) bind(c)
    integer(c_int), value :: n
    real(c_double), intent(in) :: x(n)

    face_enorm = enorm(x)
  end function face_enorm

  subroutine face_qrfac(m, n, a, ipvt, rdiag, acnorm) bind(c)
    integer(c_int), value :: m, n
    real(c_double), intent(inout) :: a(m, n)
    integer(c_int), intent(out) :: ipvt(n)
    real(c_double), intent(out) :: rdiag(n), acnorm(n)

    call qrfac(a, ipvt, rdiag, acnorm)
  end subroutine face_qrfac

  subroutine face_qrsolv(n, r, ipvt, diag, qtb, x, sdiag) bind(c)
    integer(c_int), value :: n
    real(c_double), intent(inout) :: r(n, n)
    integer(c_int), intent(in) :: ipvt(n)
    real(c_double), intent(in) :: diag(n), qtb(n)
    real(c_double), intent(out) :: x(n), sdiag(n)

    call qrsolv(r, ipvt, diag, qtb, x, sdiag)
  end subroutine face_qrsolv

  subroutine face_lmpar(n, r, ipvt, diag, qtb, delta, par, x, sdiag) bind(c)
    integer(c_int), value :: n
    real(c_double), intent(inout) :: r(n, n)
    integer(c_int), intent(in) :: ipvt(n)
    real(c_double), intent(in) :: diag(n), qtb(n)
    real(c_double), value :: delta
    real(c_double), intent(inout) :: par
    real(c_double), intent(out) :: x(n), sdiag(n)

    call lmpar(r, ipvt, diag, qtb, delta, par, x, sdiag)
  end subroutine face_lmpar

  subroutine face_lmder(evaluate, n, m, x, fvec, ftol, xtol, gtol, maxfev, diag, mode, factor, &
      info, nfev, njev, fjac, ipvt, qtf) bind(c)
    procedure(evaluate_i) :: evaluate
    integer(c_int), value :: n, m, maxfev, mode
    real(c_double), intent(inout) :: x(n), diag(n)
    real(c_double), intent(out) :: fvec(m), fjac(m, n), qtf(n)
    real(c_double), value :: ftol, xtol, gtol, factor
    integer(c_int), intent(out) :: info, nfev, njev, ipvt(n)
    type(foreign_t) :: problem

    problem%evaluate => evaluate
    call lmder(problem, x, fvec, ftol, xtol, gtol, maxfev, diag, mode, factor, info, nfev, &
        njev, fjac, ipvt, qtf)
  end subroutine face_lmder

end module minpack_faces
