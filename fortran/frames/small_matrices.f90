! Skew matrices whose powers are sums of few others, by their characteristic polynomials: real ones
! of up to five rows, and complex ones of three. Their exponential series is summed in coefficients,
!
!   exp(X) = c_0 + c_1 X + X^2 (c_2 + c_3 X + c_4 X^2).
module small_matrices_m
  use kinds, only: wp
  implicit none
  private
  public :: exponential_of_two, reduced_series, remove_phase

  integer, parameter, public :: shortest = 3   ! rows up to which c_3 and c_4 are zero

  interface reduced_series
    module procedure reduced_real, reduced_complex
  end interface reduced_series

  interface exponential_of_two
    module procedure rotation_of_two, unitary_of_two
  end interface exponential_of_two

contains

  ! The exponential of a real matrix of two rows
  pure subroutine rotation_of_two(x, e)
    real(wp), intent(in) :: x(2, 2)
    real(wp), intent(out) :: e(2, 2)

    e(:, 1) = [cos(x(1, 2)), -sin(x(1, 2))]
    e(:, 2) = [-e(2, 1), e(1, 1)]
  end subroutine rotation_of_two

  ! The exponential of a complex matrix of two rows. Without its trace its square is -angle^2.
  pure subroutine unitary_of_two(x, e)
    complex(wp), intent(in) :: x(2, 2)
    complex(wp), intent(out) :: e(2, 2)
    real(wp) :: trace, third, angle, sinc

    trace = (aimag(x(1, 1)) + aimag(x(2, 2))) / 2
    third = (aimag(x(1, 1)) - aimag(x(2, 2))) / 2
    angle = hypot(third, abs(x(1, 2)))
    sinc = 1.0_wp
    if (angle > 0) sinc = sin(angle) / angle
    e(1, 1) = cmplx(cos(angle), sinc * third, wp)
    e(2, 1) = cmplx(sinc, kind=wp) * x(2, 1)
    e(:, 2) = [cmplx(sinc, kind=wp) * x(1, 2), conjg(e(1, 1))]
    e = cmplx(cos(trace), sin(trace), wp) * e
  end subroutine unitary_of_two

  ! The series of a matrix with at most two angles, for which X^5 = -a X^3 - b X. All odd powers are
  ! p X^3 + q X, where the next odd power has q - a p and -b p.
  pure subroutine reduced_real(n, x, square, length, c)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n), square(n, n)
    real(wp), intent(in) :: length           ! the largest angle, or more
    real(wp), intent(out) :: c(0:4)
    real(wp) :: a, b, p, q, next, factor, bound, odd(2), even(2)
    integer :: j

    a = sum(x**2) / 2
    b = 0.0_wp                               ! with one angle
    if (n > 3) b = a**2 / 2 - sum(square**2) / 4
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
    c = [1.0_wp, odd(2), even(2), odd(1), even(1)]
    if (n == 3) c = [1.0_wp, odd(2) - a * odd(1), even(2) - a * even(1), 0.0_wp, 0.0_wp]
  end subroutine reduced_real

  ! The series of a matrix of three rows. Without its trace it is i Q with Q^3 = c Q + d, so that
  ! all powers of Q are p Q^2 + q Q + r.
  pure subroutine reduced_complex(n, x, square, length, coefficients)
    integer, intent(in) :: n                 ! 3
    complex(wp), intent(in) :: x(n, n), square(n, n)
    real(wp), intent(in) :: length           ! no eigenvalue without the trace is larger
    complex(wp), intent(out) :: coefficients(0:4)
    complex(wp) :: q1(n, n), q2(n, n), phase, total(3)
    real(wp) :: trace, c, d, p, q, r, next, bound, factor, even(3), odd(3)
    integer :: i, k

    trace = sum([(aimag(x(i, i)), i=1, n)]) / 3
    q1 = cmplx(aimag(x), -real(x, wp), wp)
    do i = 1, n
      q1(i, i) = q1(i, i) - cmplx(trace, kind=wp)
    end do
    q2 = -square - cmplx(2 * trace, kind=wp) * q1
    do i = 1, n
      q2(i, i) = q2(i, i) - cmplx(trace**2, kind=wp)
    end do
    c = sum([(real(q2(i, i), wp), i=1, n)]) / 2
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
    ! in powers of x = i (Q + trace)
    phase = cmplx(cos(trace), sin(trace), wp)
    total = cmplx(even, odd, wp) * phase
    coefficients = cmplx(0.0_wp, kind=wp)
    coefficients(2) = -total(1)
    coefficients(1) = (total(2) - cmplx(2 * trace, kind=wp) * total(1)) * cmplx(0.0_wp, -1.0_wp, wp)
    coefficients(0) = total(3) - cmplx(trace, kind=wp) &
                      * (total(2) - cmplx(trace, kind=wp) * total(1))
  end subroutine reduced_complex

  ! Changes a unitary matrix to determinant 1, whose phase has no digits after flows by large
  ! angles.
  pure subroutine remove_phase(n, y)
    integer, intent(in) :: n
    complex(wp), intent(inout) :: y(n, n)
    complex(wp) :: a(n, n), determinant
    real(wp) :: angle
    integer :: i, j, pivot

    a = y
    determinant = cmplx(1.0_wp, kind=wp)
    do i = 1, n                                      ! Gaussian elimination
      pivot = i - 1 + maxloc(abs(a(i:, i)), dim=1)
      if (pivot /= i) then
        a([i, pivot], :) = a([pivot, i], :)
        determinant = -determinant
      end if
      determinant = determinant * a(i, i)
      if (.not. abs(a(i, i)) > 0) exit
      do j = i + 1, n
        a(j, i:) = a(j, i:) - (a(j, i) / a(i, i)) * a(i, i:)
      end do
    end do
    angle = -atan2(aimag(determinant), real(determinant, wp)) / real(n, wp)
    y = y * cmplx(cos(angle), sin(angle), wp)
  end subroutine remove_phase

end module small_matrices_m
