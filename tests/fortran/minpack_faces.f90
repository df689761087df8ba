! C faces of the real(8) solver and its linear algebra, for tests that reach
! what the package keeps to itself.
module minpack_faces
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use linalg_m, only: enorm, lmpar, qrfac, qrsolv
  implicit none
  private

contains

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

end module minpack_faces
