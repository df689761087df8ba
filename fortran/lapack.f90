! The BLAS and LAPACK routines of the minimum-norm solver, by their addresses.
! SciPy provides the library, so that nothing has to be linked and wheels stay small.
module lapack_m
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_double, c_intptr_t, &
                                         c_f_procpointer, c_null_funptr
  implicit none
  private
  public :: set_lapack, gram_matrix, cholesky, cholesky_of_gram, solve_cholesky

  abstract interface
    subroutine syrk_i(uplo, trans, n, k, alpha, a, lda, beta, c, ldc) bind(c)
      import :: c_char, c_int, c_double
      character(kind=c_char), intent(in) :: uplo, trans
      integer(c_int), intent(in) :: n, k, lda, ldc
      real(c_double), intent(in) :: alpha, beta
      real(c_double), intent(in) :: a(lda, *)      ! (lda, k)
      real(c_double), intent(inout) :: c(ldc, *)   ! (ldc, n)
    end subroutine syrk_i

    subroutine potrf_i(uplo, n, a, lda, info) bind(c)
      import :: c_char, c_int, c_double
      character(kind=c_char), intent(in) :: uplo
      integer(c_int), intent(in) :: n, lda
      real(c_double), intent(inout) :: a(lda, *)   ! (lda, n)
      integer(c_int), intent(out) :: info
    end subroutine potrf_i

    subroutine potrs_i(uplo, n, nrhs, a, lda, b, ldb, info) bind(c)
      import :: c_char, c_int, c_double
      character(kind=c_char), intent(in) :: uplo
      integer(c_int), intent(in) :: n, nrhs, lda, ldb
      real(c_double), intent(in) :: a(lda, *)      ! (lda, n)
      real(c_double), intent(inout) :: b(ldb, *)   ! (ldb, nrhs)
      integer(c_int), intent(out) :: info
    end subroutine potrs_i

    subroutine geqrf_i(m, n, a, lda, tau, work, lwork, info) bind(c)
      import :: c_int, c_double
      integer(c_int), intent(in) :: m, n, lda, lwork
      real(c_double), intent(inout) :: a(lda, *)   ! (lda, n)
      real(c_double), intent(out) :: tau(*)        ! (min(m, n))
      real(c_double), intent(out) :: work(*)       ! (lwork)
      integer(c_int), intent(out) :: info
    end subroutine geqrf_i
  end interface

  procedure(syrk_i), pointer, save :: dsyrk => null()
  procedure(potrf_i), pointer, save :: dpotrf => null()
  procedure(potrs_i), pointer, save :: dpotrs => null()
  procedure(geqrf_i), pointer, save :: dgeqrf => null()

contains

  ! Sets the addresses of the routines.
  subroutine set_lapack(addresses)
    integer(c_intptr_t), intent(in) :: addresses(4)  ! dsyrk, dpotrf, dpotrs, dgeqrf

    call c_f_procpointer(transfer(addresses(1), c_null_funptr), dsyrk)
    call c_f_procpointer(transfer(addresses(2), c_null_funptr), dpotrf)
    call c_f_procpointer(transfer(addresses(3), c_null_funptr), dpotrs)
    call c_f_procpointer(transfer(addresses(4), c_null_funptr), dgeqrf)
  end subroutine set_lapack

  ! The lower triangle of a a^T.
  subroutine gram_matrix(a, gram)
    real(c_double), intent(in), contiguous :: a(:, :)         ! (m, n)
    real(c_double), intent(inout), contiguous :: gram(:, :)   ! (m, m)

    call dsyrk('L', 'N', size(a, 1), size(a, 2), 1.0_c_double, a, size(a, 1), 0.0_c_double, &
               gram, size(gram, 1))
  end subroutine gram_matrix

  ! The Cholesky factor of a symmetric matrix
  subroutine cholesky(a, info)
    real(c_double), intent(inout), contiguous :: a(:, :)  ! (m, m): lower triangle in, factor out
    integer, intent(out) :: info                          ! not 0: not positive definite

    call dpotrf('L', size(a, 1), a, size(a, 1), info)
  end subroutine cholesky

  ! The Cholesky factor of a a^T + damping I by QR, without forming that matrix, in which the
  ! squares of small singular values would be lost in rounding
  subroutine cholesky_of_gram(a, damping, factor)
    real(c_double), intent(in), contiguous :: a(:, :)         ! (m, n)
    real(c_double), intent(in) :: damping                     ! > 0
    real(c_double), intent(inout), contiguous :: factor(:, :) ! (m, m) lower triangle
    integer, parameter :: block = 32
    real(c_double), allocatable :: tall(:, :), tau(:), work(:)
    integer :: m, n, i, info

    m = size(a, 1)
    n = size(a, 2)
    allocate (tall(n + m, m), tau(m), work(block*m))
    tall(:n, :) = transpose(a)
    tall(n + 1:, :) = 0.0_c_double
    do i = 1, m
      tall(n + i, i) = sqrt(damping)
    end do
    call dgeqrf(n + m, m, tall, n + m, tau, work, size(work), info)
    do i = 1, m
      factor(i:, i) = tall(i, i:m)
    end do
  end subroutine cholesky_of_gram

  ! Solves a linear system by its Cholesky factor.
  subroutine solve_cholesky(factor, b)
    real(c_double), intent(in), contiguous :: factor(:, :)  ! (m, m)
    real(c_double), intent(inout), contiguous :: b(:)       ! (m)
    integer :: info

    call dpotrs('L', size(factor, 1), 1, factor, size(factor, 1), b, size(b), info)
  end subroutine solve_cholesky
end module lapack_m
