! A zero of a function between two points where it has opposite signs, by Brent's method: steps of
! interpolation where they converge, bisection where they don't (R. P. Brent,
! "Algorithms for Minimization without Derivatives", 1973, chapter 4).
module root_m
  use kinds, only: wp
  implicit none
  private
  public :: function_t, find_root

  type, abstract :: function_t
  contains
    procedure(value_i), deferred :: value
  end type function_t

  abstract interface

    subroutine value_i(self, x, y, stop)
      import :: function_t, wp
      class(function_t), intent(inout) :: self
      real(wp), intent(in) :: x
      real(wp), intent(out) :: y
      logical, intent(out) :: stop           ! there is no value
    end subroutine value_i

  end interface

  real(wp), parameter :: tolerance = 4 * epsilon(1.0_wp)
  ! Bisection takes 53; near zeros of high multiplicity each may follow some useless interpolations.
  integer, parameter :: max_iterations = 3600

contains

  ! Finds a zero of g between low and high.
  subroutine find_root(g, low, high, at_low, at_high, x, stopped)
    class(function_t), intent(inout) :: g
    real(wp), intent(in) :: low, high              ! the ends
    real(wp), intent(in) :: at_low, at_high        ! values there, of opposite signs
    real(wp), intent(out) :: x
    logical, intent(out) :: stopped                ! by the function
    ! the best estimate, the one before, and one on the other side of the zero
    real(wp) :: a, b, c, fa, fb, fc
    real(wp) :: middle, enough, step, last_step, p, q, r, s
    integer :: i

    stopped = .false.
    a = low
    fa = at_low
    b = high
    fb = at_high
    c = a
    fc = fa
    step = b - a
    last_step = step
    do i = 1, max_iterations
      if (fb * sign(1.0_wp, fc) > 0) then
        c = a
        fc = fa
        step = b - a
        last_step = step
      end if
      if (abs(fc) < abs(fb)) then
        a = b
        fa = fb
        b = c
        fb = fc
        c = a
        fc = fa
      end if
      enough = tolerance * (abs(b) + 1) / 2
      middle = (c - b) / 2
      if (abs(middle) <= enough .or. .not. abs(fb) > 0) exit
      if (abs(last_step) >= enough .and. abs(fa) > abs(fb)) then
        s = fb / fa
        if (abs(a - c) > 0) then               ! inverse quadratic interpolation
          q = fa / fc
          r = fb / fc
          p = s * (2 * middle * q * (q - r) - (b - a) * (r - 1))
          q = (q - 1) * (r - 1) * (s - 1)
        else                                   ! the secant
          p = 2 * middle * s
          q = 1 - s
        end if
        if (p > 0) q = -q
        p = abs(p)
        if (2 * p < min(3 * middle * q - abs(enough * q), abs(last_step * q))) then
          last_step = step
          step = p / q
        else
          step = middle
          last_step = middle
        end if
      else
        step = middle
        last_step = middle
      end if
      a = b
      fa = fb
      if (abs(step) > enough) then
        b = b + step
      else
        b = b + sign(enough, middle)
      end if
      call g%value(b, fb, stopped)
      if (stopped) exit
    end do
    x = b
  end subroutine find_root

end module root_m
