! Matrices y of k orthonormal columns, with the fields y' = v - y v^T y for matrices v of the same
! shape. Points and coefficients are stored row by row, so that they are transposed here.
! cg/frames/stiefel.py has the formulas.
module stiefel_m
  use kinds, only: wp
  use lapack_m, only: dgemm
  use vectors_m, only: nan
  implicit none
  private
  public :: move_stiefel, restore_stiefel, stiefel_coefficients, stiefel_tangent

  real(wp), parameter :: max_length = 1e4_wp

contains

  ! Moves y along one flow, in parts of length at most 1: to x z^-1 with z = 1 + m d + s a,
  ! x = y + v (s + d a), where a = v^T y, and s and d are series in m = v^T v. It is NaN if
  ! coefficients are too large.
  subroutine move_stiefel(k, n, v, y)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: v(k, n)
    real(wp), intent(inout) :: y(k, n)
    real(wp), dimension(k, k) :: m, s, d, c, a, z, w
    real(wp) :: x(k, n), length, part
    integer :: i, j, parts

    length = norm2(v)
    if (.not. length <= max_length) then
      y = nan
      return
    end if
    parts = max(1, ceiling(length))
    part = 1 / real(parts, wp)
    call product_of('N', 'T', part**2, v, v, 0.0_wp, m)
    call sum_series(k, (part * length)**2, m, s, d)
    call product_of('N', 'N', 1.0_wp, m, d, 0.0_wp, c)
    do i = 1, k
      c(i, i) = 1 + c(i, i)
    end do
    do j = 1, parts
      call product_of('N', 'T', part, v, y, 0.0_wp, a)
      z = transpose(c)
      call product_of('T', 'N', 1.0_wp, a, s, 1.0_wp, z)
      w = s
      call product_of('N', 'N', 1.0_wp, d, a, 1.0_wp, w)
      x = y
      call product_of('T', 'N', part, w, v, 1.0_wp, x)
      call invert(k, z, w)
      call product_of('N', 'N', 1.0_wp, w, x, 0.0_wp, y)
    end do
  end subroutine move_stiefel

  ! The inverse of a regular matrix, by elimination. LAPACK's would use several threads for few
  ! columns.
  pure subroutine invert(k, a, inverse)
    integer, intent(in) :: k
    real(wp), intent(inout) :: a(k, k)
    real(wp), intent(out) :: inverse(k, k)
    real(wp) :: factor
    integer :: i, j, pivot

    inverse = 0.0_wp
    do i = 1, k
      inverse(i, i) = 1.0_wp
    end do
    do i = 1, k
      pivot = i - 1 + maxloc(abs(a(i:, i)), dim=1)
      a([i, pivot], :) = a([pivot, i], :)
      inverse([i, pivot], :) = inverse([pivot, i], :)
      do j = 1, k
        if (j == i) cycle
        factor = a(j, i) / a(i, i)
        a(j, i:) = a(j, i:) - factor * a(i, i:)
        inverse(j, :) = inverse(j, :) - factor * inverse(i, :)
      end do
    end do
    do i = 1, k
      inverse(i, :) = inverse(i, :) / a(i, i)
    end do
  end subroutine invert

  ! The sums of m^j / (2 j + 1)! and m^j / (2 j + 2)!
  subroutine sum_series(k, bound, m, s, d)
    integer, intent(in) :: k
    real(wp), intent(in) :: bound                  ! of the norm of m, at most 1
    real(wp), intent(in) :: m(k, k)
    real(wp), intent(out) :: s(k, k), d(k, k)
    real(wp) :: power(k, k), next(k, k), size_of_term
    integer :: i, j

    power = 0.0_wp
    do i = 1, k
      power(i, i) = 1.0_wp
    end do
    s = power
    d = power / 2
    size_of_term = 1.0_wp
    j = 0
    do while (size_of_term > epsilon(size_of_term) / 8)
      j = j + 1
      associate (factor => 1 / real(2 * j * (2 * j + 1), wp))
        call product_of('N', 'N', factor, m, power, 0.0_wp, next)
        size_of_term = size_of_term * bound * factor
      end associate
      power = next
      s = s + power
      d = d + power / real(2 * j + 2, wp)
    end do
  end subroutine sum_series

  ! One Newton-Schulz step
  subroutine restore_stiefel(k, n, y)
    integer, intent(in) :: k, n
    real(wp), intent(inout) :: y(k, n)
    real(wp) :: gram(k, k), start(k, n)

    start = y
    call product_of('N', 'T', 1.0_wp, start, start, 0.0_wp, gram)
    call product_of('N', 'N', -0.5_wp, gram, start, 1.5_wp, y)
  end subroutine restore_stiefel

  ! v - y v^T y
  subroutine stiefel_tangent(k, n, v, y, tangent)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: v(k, n), y(k, n)
    real(wp), intent(out) :: tangent(k, n)
    real(wp) :: a(k, k)

    call product_of('N', 'T', 1.0_wp, v, y, 0.0_wp, a)
    tangent = v
    call product_of('T', 'N', -1.0_wp, a, y, 1.0_wp, tangent)
  end subroutine stiefel_tangent

  ! The coefficients x - y (y^T x) / 2 of a derivative x, and the square of the length of the rest
  subroutine stiefel_coefficients(k, n, y, x, v, dropped)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: y(k, n), x(k, n)
    real(wp), intent(out) :: v(k, n), dropped
    real(wp) :: a(k, k), tangent(k, n)

    call product_of('N', 'T', 1.0_wp, x, y, 0.0_wp, a)
    v = x
    call product_of('N', 'N', -0.5_wp, a, y, 1.0_wp, v)
    call stiefel_tangent(k, n, v, y, tangent)
    dropped = sum((x - tangent)**2)
  end subroutine stiefel_coefficients

  ! c = alpha a b + beta c, with a transposed a or b where its letter is T
  subroutine product_of(of_a, of_b, alpha, a, b, beta, c)
    character, intent(in) :: of_a, of_b
    real(wp), intent(in) :: alpha, beta
    real(wp), contiguous, intent(in) :: a(:, :), b(:, :)
    real(wp), contiguous, intent(inout) :: c(:, :)

    call dgemm(of_a, of_b, size(c, 1), size(c, 2), size(a, merge(1, 2, of_a == 'T')), alpha, &
               a, size(a, 1), b, size(b, 1), beta, c, size(c, 1))
  end subroutine product_of

end module stiefel_m
