! Vectors of real numbers, and the routines of BLAS and LAPACK that are called, by their addresses.
! SciPy provides them, so that nothing has to be linked: cg/support/capsules.py.
module vectors_m
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  implicit none
  private
  public :: add_columns, add_multiple, combine, copy, cross, finite

  ! ieee_value would save and restore the floating-point state, as ieee_is_finite would
  real(wp), parameter, public :: nan = transfer(int(z'7FF8000000000000', int64), 1.0_wp)

  ! Numbers and matrices without a type are real or complex.
  abstract interface
    subroutine syrk_i(uplo, trans, n, k, alpha, a, lda, beta, c, ldc) bind(c)
      character, intent(in) :: uplo, trans
      integer, intent(in) :: n, k, lda, ldc
      type(*), intent(in) :: alpha, beta, a(lda, *)          ! (lda, k)
      type(*), intent(inout) :: c(ldc, *)                    ! (ldc, n)
    end subroutine syrk_i
    subroutine potrf_i(uplo, n, a, lda, info) bind(c)
      character, intent(in) :: uplo
      integer, intent(in) :: n, lda
      type(*), intent(inout) :: a(lda, *)                    ! (lda, n)
      integer, intent(out) :: info
    end subroutine potrf_i
    subroutine potrs_i(uplo, n, nrhs, a, lda, b, ldb, info) bind(c)
      character, intent(in) :: uplo
      integer, intent(in) :: n, nrhs, lda, ldb
      type(*), intent(in) :: a(lda, *)                       ! (lda, n)
      type(*), intent(inout) :: b(ldb, *)                    ! (ldb, nrhs)
      integer, intent(out) :: info
    end subroutine potrs_i
    subroutine getrf_i(m, n, a, lda, pivot, info) bind(c)
      integer, intent(in) :: m, n, lda
      type(*), intent(inout) :: a(lda, *)                    ! (lda, n)
      integer, intent(inout) :: pivot(*)                     ! (min(m, n))
      integer, intent(out) :: info
    end subroutine getrf_i
    subroutine getrs_i(trans, n, nrhs, a, lda, pivot, b, ldb, info) bind(c)
      character, intent(in) :: trans
      integer, intent(in) :: n, nrhs, lda, ldb, pivot(*)     ! (n)
      type(*), intent(in) :: a(lda, *)                       ! (lda, n)
      type(*), intent(inout) :: b(ldb, *)                    ! (ldb, nrhs)
      integer, intent(out) :: info
    end subroutine getrs_i
    subroutine gemm_i(transa, transb, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc) bind(c)
      character, intent(in) :: transa, transb
      integer, intent(in) :: m, n, k, lda, ldb, ldc
      type(*), intent(in) :: alpha, beta, a(lda, *), b(ldb, *)   ! (lda, k), (ldb, n)
      type(*), intent(inout) :: c(ldc, *)                    ! (ldc, n)
    end subroutine gemm_i
    subroutine syevd_i(jobz, uplo, n, a, lda, w, work, lwork, iwork, liwork, info) bind(c)
      character, intent(in) :: jobz, uplo
      integer, intent(in) :: n, lda, lwork, liwork
      type(*), intent(inout) :: a(lda, *), w(*), work(*)     ! (lda, n), (n), (lwork)
      integer, intent(inout) :: iwork(*)                     ! (liwork)
      integer, intent(out) :: info
    end subroutine syevd_i
  end interface

  procedure(syrk_i), pointer, public :: dsyrk => null()
  procedure(potrf_i), pointer, public :: dpotrf => null()
  procedure(potrs_i), pointer, public :: dpotrs => null()
  procedure(getrf_i), pointer, public :: dgetrf => null(), zgetrf => null()
  procedure(getrs_i), pointer, public :: dgetrs => null(), zgetrs => null()
  procedure(gemm_i), pointer, public :: dgemm => null(), zgemm => null()
  procedure(syevd_i), pointer, public :: dsyevd => null()

contains

  pure logical function finite(n, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)

    finite = all(abs(x) <= huge(x))
  end function finite

  ! A weighted sum of vectors, without those of weight zero. Shapes are explicit, for speed.
  pure subroutine combine(m, n, weight, k, total)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: weight(n), k(m, n)
    real(wp), intent(out) :: total(m)
    integer :: j

    total = 0.0_wp
    do j = 1, n
      if (weight(j) /= 0) call add_multiple(m, weight(j), k(:, j), total)
    end do
  end subroutine combine

  ! Adds a multiple of a vector to another one, by a loop for long ones.
  pure subroutine add_multiple(n, factor, x, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: factor, x(n)
    real(wp), intent(inout) :: y(n)
    integer :: i

    !GCC$ vector
    do i = 1, n
      y(i) = y(i) + factor * x(i)
    end do
  end subroutine add_multiple

  ! Copies a vector. In a procedure the compiler knows that columns of an array don't overlap.
  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)

    to = from
  end subroutine copy

  ! Adds columns to an array, so that it grows in few steps; without memory for them it is the same.
  subroutine add_columns(array, least, alloc_status)
    real(wp), allocatable, intent(inout) :: array(:, :)
    integer, intent(in) :: least             ! number of columns, at least
    integer, intent(out) :: alloc_status     ! nonzero if there isn't enough memory
    real(wp), allocatable :: more(:, :)

    allocate (more(size(array, 1), max(least, 2 * size(array, 2))), stat=alloc_status)
    if (alloc_status /= 0) return
    more(:, :size(array, 2)) = array
    call move_alloc(more, array)
  end subroutine add_columns

  pure function cross(u, v)
    real(wp), intent(in) :: u(3), v(3)
    real(wp) :: cross(3)

    cross = [u(2) * v(3) - u(3) * v(2), u(3) * v(1) - u(1) * v(3), u(1) * v(2) - u(2) * v(1)]
  end function cross

end module vectors_m
