! Flows, brackets and orthogonalisation for rotations of any size, in real numbers. Points are
! matrices row by row, which here are their transposes.
!
! The exponential of a skew matrix X is the power series of X / 2^s, squared s times: up to five
! rows in numbers, since X^5 = -a X^3 - b X there; beyond in powers of X^2 by the scheme of Paterson
! and Stockmeyer. Both take products alone, which small matrices do in less time than a
! factorisation. A step of Newton and Schulz, y (3 - y^T y) / 2, removes rounding off the group.
module orthogonal_m
  use kinds, only: wp
  use blocks_m, only: skew_matrix
  use vectors_m, only: dgemm
  implicit none
  private
  public :: move_orthogonal, multiply, multiply_symmetric, to_orthogonal

  ! Largest norms of matrices whose exponential series is summed: in numbers, with powers reduced by
  ! the characteristic polynomial, and in matrices
  real(wp), parameter :: longest_reduced = 2.0_wp, longest = 0.85_wp
  integer, parameter :: largest_reduced = 5        ! rows of matrices with at most two angles
  integer, parameter, public :: largest_own = 12   ! rows of matrices that are multiplied here

contains

  ! Moves a point by flows one after the other, from the left or the right.
  subroutine move_orthogonal(n, left, f, y)
    integer, intent(in) :: n
    logical, intent(in) :: left
    real(wp), intent(in) :: f(:, :)              ! (dimension, flows) coefficients of the flows
    real(wp), intent(inout) :: y(n, n)
    real(wp) :: x(n, n), e(n, n), moved(n, n)
    integer :: j

    do j = 1, size(f, 2)
      call skew_matrix(n, -f(:, j), x)
      call exponential(n, x, e)
      if (left) then
        call multiply(n, y, e, moved)
      else
        call multiply(n, e, y, moved)
      end if
      y = moved
    end do
  end subroutine move_orthogonal

  ! The exponential by scaling and squaring of the series. If there are many squarings, rounding off
  ! the group is removed after each.
  subroutine exponential(n, x, e)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n)
    real(wp), intent(out) :: e(n, n)
    real(wp) :: scaled(n, n), length, max_length
    integer :: k, squarings

    if (n == 2) then                       ! one angle
      e(1, 1) = cos(x(1, 2))
      e(1, 2) = sin(x(1, 2))
      e(2, 1) = -e(1, 2)
      e(2, 2) = e(1, 1)
      return
    end if
    ! bounds of the largest angle, of which each counts twice
    length = sqrt(sum(x**2) / 2)
    if (n > largest_own) length = min(length, maxval(sum(abs(x), dim=1)))
    max_length = merge(longest_reduced, longest, n <= largest_reduced)
    squarings = 0
    if (.not. length <= huge(length)) length = 0.0_wp     ! the result is NaN
    if (length > max_length) squarings = exponent(length / max_length)
    scaled = scale(1.0_wp, -squarings) * x
    if (n <= largest_reduced) then
      call reduced_series(n, scaled, scale(length, -squarings), e)
    else
      call series(n, scaled, scale(length, -squarings), e)
    end if
    do k = 1, squarings
      scaled = e
      call multiply(n, scaled, scaled, e)
      if (squarings > 4) call to_orthogonal(n, e)
    end do
  end subroutine exponential

  ! The series of a matrix with at most two angles, for which X^5 = -a X^3 - b X. All odd powers are
  ! p X^3 + q X, where the next odd power has q - a p and -b p.
  subroutine reduced_series(n, x, length, e)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n), length
    real(wp), intent(out) :: e(n, n)
    real(wp), dimension(n, n) :: square, cube
    real(wp) :: a, b, p, q, next, factor, bound, odd(2), even(2)
    integer :: i, j

    call multiply(n, x, x, square)
    call multiply(n, x, square, cube)
    call multiply(n, square, square, e)
    a = 0.0_wp
    b = 0.0_wp
    do i = 1, n
      a = a - square(i, i) / 2
      b = b - e(i, i) / 4
    end do
    b = b + a**2 / 2
    p = 0.0_wp
    q = 1.0_wp
    odd = 0.0_wp
    even = 0.0_wp
    factor = 1.0_wp
    bound = 1.0_wp
    j = 1
    do
      factor = factor / real(j, wp)
      odd = odd + factor * [p, q]
      factor = factor / real(j + 1, wp)
      even = even + factor * [p, q]
      bound = bound * length**2 / (real(j, wp) * real(j + 1, wp))
      if (.not. bound > epsilon(bound) / 8) exit
      next = q - a * p
      q = -b * p
      p = next
      j = j + 2
    end do
    e = even(1) * e + even(2) * square + odd(1) * cube + odd(2) * x
    do i = 1, n
      e(i, i) = 1 + e(i, i)
    end do
  end subroutine reduced_series

  ! The series by the scheme of M. S. Paterson and L. J. Stockmeyer (SIAM J. Comput. 2 (1973)), in
  ! powers of the square: 1 + x^2 / 2! + ... and x (1 + x^2 / 3! + ...).
  subroutine series(n, x, length, e)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n), length
    real(wp), intent(out) :: e(n, n)
    integer, parameter :: max_terms = 40
    real(wp) :: power(n, n, 4), even(n, n), odd(n, n), product(n, n), &
      factor(0:2 * max_terms + 1), bound
    integer :: k, terms, width, block

    factor(0) = 1.0_wp
    factor(1) = 1.0_wp
    bound = length / 2                   ! relative to x
    terms = 0                            ! powers of the square
    do while (bound > epsilon(bound) / 8 .and. terms < max_terms)
      terms = terms + 1
      factor(2 * terms) = factor(2 * terms - 1) / real(2 * terms, wp)
      factor(2 * terms + 1) = factor(2 * terms) / real(2 * terms + 1, wp)
      bound = bound * length**2 / (real(2 * terms + 1, wp) * real(2 * terms + 2, wp))
    end do
    width = min(max(2, (terms + 1) / 2), 4)
    call multiply(n, x, x, power(:, :, 1))
    do k = 2, width
      call multiply(n, power(:, :, 1), power(:, :, k - 1), power(:, :, k))
    end do
    block = max(terms - 1, 0) / width
    even = 0.0_wp
    odd = 0.0_wp
    call add(block, terms - block * width, even, odd)
    do block = block - 1, 0, -1
      call multiply(n, even, power(:, :, width), product)
      even = product
      call multiply(n, odd, power(:, :, width), product)
      odd = product
      call add(block, width - 1, even, odd)
    end do
    call multiply(n, x, odd, e)
    e = e + even

  contains

    ! Adds the terms of one block of powers.
    pure subroutine add(block, last, even, odd)
      integer, intent(in) :: block, last
      real(wp), intent(inout) :: even(n, n), odd(n, n)
      integer :: j, i

      i = 2 * block * width
      do j = 1, last
        even = even + factor(i + 2 * j) * power(:, :, j)
        odd = odd + factor(i + 2 * j + 1) * power(:, :, j)
      end do
      do j = 1, n
        even(j, j) = even(j, j) + factor(i)
        odd(j, j) = odd(j, j) + factor(i + 1)
      end do
    end subroutine add

  end subroutine series

  ! One Newton-Schulz step
  subroutine to_orthogonal(n, y)
    integer, intent(in) :: n
    real(wp), intent(inout) :: y(n, n)
    real(wp) :: square(n, n), product(n, n)

    call multiply_symmetric(n, y, y, square)
    call multiply(n, y, square, product)
    y = 1.5_wp * y - 0.5_wp * product
  end subroutine to_orthogonal

  ! The product a^T b, which is symmetric, for many rows up to rounding
  subroutine multiply_symmetric(n, a, b, c)
    integer, intent(in) :: n
    real(wp), intent(in) :: a(n, n), b(n, n)
    real(wp), intent(out) :: c(n, n)
    integer :: i, j

    if (n > largest_own) then
      call dgemm('T', 'N', n, n, n, 1.0_wp, a, n, b, n, 0.0_wp, c, n)
      return
    end if
    do j = 1, n
      do i = 1, j
        c(i, j) = dot_product(a(:, i), b(:, j))
        c(j, i) = c(i, j)
      end do
    end do
  end subroutine multiply_symmetric

  ! The product of matrices whose size the compiler knows takes a third of the time.
  pure subroutine multiply_4x4(a, b, c)
    real(wp), intent(in) :: a(4, 4), b(4, 4)
    real(wp), intent(out) :: c(4, 4)
    integer :: j

    do j = 1, 4
      c(:, j) = a(:, 1) * b(1, j) + a(:, 2) * b(2, j) + a(:, 3) * b(3, j) + a(:, 4) * b(4, j)
    end do
  end subroutine multiply_4x4

  ! The product of matrices; for small ones a call of matmul takes longer.
  subroutine multiply(n, a, b, c)
    integer, intent(in) :: n
    real(wp), intent(in) :: a(n, n), b(n, n)
    real(wp), intent(out) :: c(n, n)
    integer :: j, k

    if (n == 4) then
      call multiply_4x4(a, b, c)
      return
    else if (n > largest_own) then
      call dgemm('N', 'N', n, n, n, 1.0_wp, a, n, b, n, 0.0_wp, c, n)
      return
    end if
    do j = 1, n
      c(:, j) = a(:, 1) * b(1, j)
      do k = 2, n
        c(:, j) = c(:, j) + a(:, k) * b(k, j)
      end do
    end do
  end subroutine multiply

end module orthogonal_m
