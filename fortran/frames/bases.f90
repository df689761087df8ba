! Bases of the Lie algebras of SO(n), SU(n) and U(n): matrices of coefficients, and coefficients of
! matrices. They are those of cg/frames/so.py, su.py and u.py.
module bases_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_loc
  use kinds, only: wp
  use shared_numbers, only: so_block, u_block
  implicit none
  private
  public :: algebra_coefficients, algebra_matrix, as_complex, skew_coefficients, skew_matrix

contains

  ! The complex matrix that is held in real numbers
  function as_complex(n, numbers) result(view)
    integer, intent(in) :: n
    real(wp), contiguous, target, intent(in) :: numbers(:)
    complex(wp), pointer, contiguous :: view(:, :)

    call c_f_pointer(c_loc(numbers), view, [n, n])
  end function as_complex

  ! The skew matrix with coefficients v of cg/frames/so.py
  pure subroutine skew_matrix(n, v, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    real(wp), intent(out) :: x(n, n)
    integer :: i, j, k

    k = size(v)
    do i = 1, n
      x(i, i) = 0.0_wp
      do j = i + 1, n
        x(j, i) = merge(v(k), -v(k), modulo(i + j, 2) == 1)
        x(i, j) = -x(j, i)
        k = k - 1
      end do
    end do
  end subroutine skew_matrix

  ! The coefficients of a skew matrix
  pure subroutine skew_coefficients(n, x, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    integer :: i, j, k

    k = size(v)
    do i = 1, n
      do j = i + 1, n
        v(k) = merge(x(j, i), -x(j, i), modulo(i + j, 2) == 1)
        k = k - 1
      end do
    end do
  end subroutine skew_coefficients

  ! The element of the Lie algebra of SU(n) or U(n) with coefficients v
  pure subroutine algebra_matrix(kind, n, v, x)
    integer, intent(in) :: kind, n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    complex(wp), intent(out) :: x(n, n)
    real(wp) :: d
    integer :: i, j, k

    x = cmplx(0.0_wp, 0.0_wp, wp)
    k = 1
    do j = 2, n
      do i = 1, j - 1
        x(i, j) = cmplx(-v(k + 1) / 2, -v(k) / 2, wp)
        x(j, i) = cmplx(v(k + 1) / 2, -v(k) / 2, wp)
        k = k + 2
      end do
      d = diagonal(j) * v(k) / 2
      do i = 1, j - 1
        x(i, i) = x(i, i) - cmplx(0.0_wp, d, wp)
      end do
      x(j, j) = x(j, j) + cmplx(0.0_wp, real(j - 1, wp) * d, wp)
      k = k + 1
    end do
    if (kind == u_block) then
      d = sqrt(2 / real(n, wp)) * v(k) / 2
      do i = 1, n
        x(i, i) = x(i, i) - cmplx(0.0_wp, d, wp)
      end do
    end if
  end subroutine algebra_matrix

  ! The coefficients of the orthogonal projection of a matrix onto the algebra
  pure subroutine algebra_coefficients(kind, n, x, v)
    integer, intent(in) :: kind, n
    complex(wp), intent(in) :: x(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    real(wp) :: total
    integer :: i, j, k

    if (kind == so_block) then
      call skew_coefficients(n, (real(x, wp) - transpose(real(x, wp))) / 2, v)
      return
    end if
    k = 1
    total = 0.0_wp
    do j = 2, n
      total = total + aimag(x(j - 1, j - 1))
      do i = 1, j - 1
        v(k) = -aimag(x(i, j) + x(j, i))
        v(k + 1) = real(x(j, i) - x(i, j), wp)
        k = k + 2
      end do
      v(k) = -diagonal(j) * (total - real(j - 1, wp) * aimag(x(j, j)))
      k = k + 1
    end do
    if (kind == u_block) v(k) = -sqrt(2 / real(n, wp)) * (total + aimag(x(n, n)))
  end subroutine algebra_coefficients

  ! The normalisation of the diagonal basis matrix j
  pure real(wp) function diagonal(j)
    integer, intent(in) :: j

    diagonal = sqrt(2 / (real(j - 1, wp) * real(j, wp)))
  end function diagonal

end module bases_m
