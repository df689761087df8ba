! Flows on the groups SU(n) and U(n), y -> exp(X) y or y exp(X) with the skew-Hermitian matrix X of
! the coefficients, and differences of points on them and on SO(n). Points are matrices row by row,
! which here are their transposes, real for SO(n).
!
! The exponential is the power series of X / 2^s, squared s times, which takes products alone; a
! step of Newton and Schulz, y (3 - y^* y) / 2, removes rounding off the group (N. J. Higham,
! "Functions of Matrices", SIAM, 2008, sections 8.3 and 10.3).
module unitary_m
  use kinds, only: wp
  use blocks_m, only: algebra_coefficients, algebra_matrix, as_complex
  use vectors_m, only: nan, zgemm
  use orthogonal_m, only: largest_own
  use shared_numbers, only: so_block, su_block
  implicit none
  private
  public :: move_unitary, multiply, restore_unitary, unitary_difference

  ! largest norms of matrices whose exponential series is summed: in matrices, and in numbers
  real(wp), parameter :: longest = 0.5_wp, longest_of_three = 2.0_wp
  integer, parameter :: max_iterations = 30
  complex(wp), parameter :: zero = cmplx(0.0_wp, kind=wp), half = cmplx(0.5_wp, kind=wp), &
                            one = cmplx(1.0_wp, kind=wp)

contains

  ! Moves a point by flows one after the other, from the left or the right.
  subroutine move_unitary(kind, n, left, f, y)
    integer, intent(in) :: kind, n
    logical, intent(in) :: left
    real(wp), intent(in) :: f(:, :)              ! (dimension, flows) coefficients of the flows
    real(wp), contiguous, target, intent(inout) :: y(:)    ! (point_size)
    complex(wp), pointer, contiguous :: point(:, :)
    complex(wp), dimension(n, n) :: x, e, moved
    integer :: j

    point => as_complex(n, y)
    do j = 1, size(f, 2)
      call algebra_matrix(kind, n, f(:, j), x)
      call exponential(n, transpose(x), e)
      if (left) then
        call multiply(n, point, e, moved)
      else
        call multiply(n, e, point, moved)
      end if
      point = moved
    end do
  end subroutine move_unitary

  ! The exponential of a skew-Hermitian matrix by scaling and squaring of the series. If there are
  ! many squarings, rounding off the group is removed after each.
  subroutine exponential(n, x, e)
    integer, intent(in) :: n
    complex(wp), intent(in) :: x(n, n)
    complex(wp), intent(out) :: e(n, n)
    complex(wp) :: scaled(n, n)
    real(wp) :: length, max_length
    integer :: k, squarings

    length = frobenius(x)
    if (n == 3) length = sqrt(2 / 3.0_wp) * length   ! without the trace no eigenvalue is larger
    max_length = merge(longest_of_three, longest, n == 3)
    squarings = 0
    if (.not. length <= huge(length)) length = 0.0_wp     ! the result is not finite either
    if (length > max_length) squarings = exponent(length / max_length)
    scaled = cmplx(scale(1.0_wp, -squarings), kind=wp) * x
    if (n == 3) then
      call series_of_three(scaled, scale(length, -squarings), e)
    else
      call series(n, scaled, scale(length, -squarings), e)
    end if
    do k = 1, squarings
      scaled = e
      call multiply(n, scaled, scaled, e)
      if (squarings > 4) call orthogonalise(n, e)
    end do
  end subroutine exponential

  ! The series of a small matrix by Horner's scheme
  subroutine series(n, x, length, e)
    integer, intent(in) :: n
    complex(wp), intent(in) :: x(n, n)
    real(wp), intent(in) :: length           ! its norm
    complex(wp), intent(out) :: e(n, n)
    complex(wp) :: next(n, n)
    real(wp) :: bound
    integer :: i, k, terms

    terms = 1
    bound = length
    do while (bound > epsilon(bound) / 8)
      terms = terms + 1
      bound = bound * length / real(terms, wp)
    end do
    e = cmplx(1 / real(terms, wp), kind=wp) * x
    do k = terms - 1, 0, -1
      do i = 1, n
        e(i, i) = e(i, i) + one
      end do
      if (k == 0) exit
      call multiply(n, x, e, next)
      e = cmplx(1 / real(k, wp), kind=wp) * next
    end do
  end subroutine series

  ! The series of a matrix of three rows. Without its trace it is i Q with Q^3 = c Q + d, so that
  ! all powers of Q are p Q^2 + q Q + r; the series is summed in the numbers p, q, r.
  pure subroutine series_of_three(x, length, e)
    complex(wp), intent(in) :: x(3, 3)
    real(wp), intent(in) :: length           ! no eigenvalue without the trace is larger
    complex(wp), intent(out) :: e(3, 3)
    complex(wp), dimension(3, 3) :: q1, q2
    real(wp) :: trace, c, d, p, q, r, next, bound, factor, even(3), odd(3)
    integer :: i, k

    trace = (aimag(x(1, 1)) + aimag(x(2, 2)) + aimag(x(3, 3))) / 3
    q1 = cmplx(aimag(x), -real(x, wp), wp)
    do i = 1, 3
      q1(i, i) = q1(i, i) - cmplx(trace, kind=wp)
    end do
    call multiply_3x3(q1, q1, q2)
    c = (real(q2(1, 1), wp) + real(q2(2, 2), wp) + real(q2(3, 3), wp)) / 2
    d = sum(real(q1, wp) * real(q2, wp) + aimag(q1) * aimag(q2)) / 3
    even = [0.0_wp, 0.0_wp, 1.0_wp]                  ! p, q, r
    odd = 0.0_wp
    p = 0.0_wp
    q = 0.0_wp
    r = 1.0_wp
    factor = 1.0_wp
    bound = 1.0_wp
    k = 0
    do while (bound > epsilon(bound) / 8)
      k = k + 1
      next = r + c * p
      r = d * p
      p = q
      q = next
      factor = factor / real(k, wp)
      bound = bound * length / real(k, wp)
      if (modulo(k, 2) == 0) then
        factor = -factor                             ! powers of i
        even = even + factor * [p, q, r]
      else
        odd = odd + factor * [p, q, r]
      end if
    end do
    e = cmplx(even(1), odd(1), wp) * q2 + cmplx(even(2), odd(2), wp) * q1
    do i = 1, 3
      e(i, i) = e(i, i) + cmplx(even(3), odd(3), wp)
    end do
    if (abs(trace) > 0) e = cmplx(cos(trace), sin(trace), wp) * e
  end subroutine series_of_three

  ! One Newton-Schulz step, and for SU(n) one to determinant 1, whose phase has no digits after flows
  ! by large angles
  subroutine restore_unitary(kind, n, y)
    integer, intent(in) :: kind, n
    real(wp), contiguous, target, intent(inout) :: y(:)    ! (point_size)
    complex(wp), pointer, contiguous :: point(:, :)
    complex(wp) :: det
    real(wp) :: angle

    point => as_complex(n, y)
    call orthogonalise(n, point)
    if (kind == su_block) then
      det = determinant(n, point)
      angle = -atan2(aimag(det), real(det, wp)) / real(n, wp)
      point = point * cmplx(cos(angle), sin(angle), wp)
    end if
  end subroutine restore_unitary

  ! One Newton-Schulz step
  subroutine orthogonalise(n, y)
    integer, intent(in) :: n
    complex(wp), intent(inout) :: y(n, n)
    complex(wp), dimension(n, n) :: adjoint, square, product

    adjoint = conjg(transpose(y))
    call multiply(n, adjoint, y, square)
    call multiply(n, y, square, product)
    y = cmplx(1.5_wp, kind=wp) * y - half * product
  end subroutine orthogonalise

  ! The determinant by Gaussian elimination
  pure complex(wp) function determinant(n, matrix)
    integer, intent(in) :: n
    complex(wp), intent(in) :: matrix(n, n)
    complex(wp) :: a(n, n)
    integer :: i, j, pivot

    a = matrix
    determinant = one
    do i = 1, n
      pivot = i - 1 + maxloc(abs(a(i:, i)), dim=1)
      if (.not. abs(a(pivot, i)) > 0) then
        determinant = zero
        return
      end if
      if (pivot /= i) then
        a([i, pivot], :) = a([pivot, i], :)
        determinant = -determinant
      end if
      determinant = determinant * a(i, i)
      do j = i + 1, n
        a(j, i:) = a(j, i:) - (a(j, i) / a(i, i)) * a(i, i:)
      end do
    end do
  end function determinant

  ! The coefficients of the flow from x to y, NaN if they are half a turn or more apart. The
  ! iteration X -> X + skew part of exp(-X) W, with the quotient W, changes each angle by the sine
  ! of its error.
  subroutine unitary_difference(kind, n, left, x, y, v)
    integer, intent(in) :: kind, n
    logical, intent(in) :: left
    real(wp), contiguous, target, intent(in) :: x(:), y(:)     ! (point_size)
    real(wp), intent(out) :: v(:)                ! (dimension)
    complex(wp), dimension(n, n) :: start, end, quotient, total, rest, step, e
    real(wp) :: length
    integer :: i, k

    if (kind == so_block) then
      start = cmplx(transpose(reshape(x, [n, n])), kind=wp)
      end = cmplx(reshape(y, [n, n]), kind=wp)
    else
      start = conjg(transpose(as_complex(n, x)))
      end = (as_complex(n, y))
    end if
    if (left) then
      call multiply(n, start, end, quotient)
    else
      call multiply(n, end, start, quotient)
    end if
    total = zero
    rest = quotient
    v = nan
    do k = 1, max_iterations
      step = half * (rest - conjg(transpose(rest)))
      total = total + step
      length = frobenius(step)
      if (.not. length <= huge(length)) return
      if (length <= sqrt(epsilon(length))) exit      ! the next one would be less than rounding
      call exponential(n, -total, e)
      call multiply(n, e, quotient, rest)
    end do
    if (k > max_iterations) return
    do i = 1, n
      rest(i, i) = rest(i, i) - one          ! its eigenvalues: 0, or -2 where half a turn is
    end do
    if (.not. sum(real(rest, wp)**2 + aimag(rest)**2) < 1.0_wp) return
    if (kind == su_block) then
      if (abs(sum([(aimag(total(i, i)), i=1, n)])) > 1) return
    end if
    call algebra_coefficients(kind, n, transpose(total), v)
  end subroutine unitary_difference

  ! The Frobenius norm
  pure real(wp) function frobenius(x)
    complex(wp), intent(in) :: x(:, :)

    frobenius = sqrt(sum(real(x, wp)**2 + aimag(x)**2))
  end function frobenius

  ! The product of matrices whose size the compiler knows
  pure subroutine multiply_3x3(a, b, c)
    complex(wp), intent(in) :: a(3, 3), b(3, 3)
    complex(wp), intent(out) :: c(3, 3)
    integer :: i, j

    do j = 1, 3
      do i = 1, 3
        c(i, j) = a(i, 1) * b(1, j) + a(i, 2) * b(2, j) + a(i, 3) * b(3, j)
      end do
    end do
  end subroutine multiply_3x3

  ! The product of matrices; for small ones a call of matmul takes longer.
  subroutine multiply(n, a, b, c)
    integer, intent(in) :: n
    complex(wp), intent(in) :: a(n, n), b(n, n)
    complex(wp), intent(out) :: c(n, n)
    integer :: i, j, k

    if (n == 3) then
      call multiply_3x3(a, b, c)
      return
    else if (n > largest_own) then
      call zgemm('N', 'N', n, n, n, (1.0_wp, 0.0_wp), a, n, b, n, zero, c, n)
      return
    end if
    do j = 1, n
      c(:, j) = zero
      do k = 1, n
        do i = 1, n
          c(i, j) = c(i, j) + a(i, k) * b(k, j)
        end do
      end do
    end do
  end subroutine multiply

end module unitary_m
