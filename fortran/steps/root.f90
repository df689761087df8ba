! The function of an event along the interpolant of a step, and its zero between two points where it
! has opposite signs, by Brent's method: steps of interpolation where they converge, bisection where
! they don't (R. P. Brent, "Algorithms for Minimization without Derivatives", 1973, chapter 4).
module root_m
  use kinds, only: wp
  use requests_m, only: evaluate_events, recalls
  use shared_numbers, only: finished
  use trajectory_m, only: trajectory_t
  use within_step_m, only: point_at, time_at
  implicit none
  private
  public :: event_function_t, find_root, values_at

  type :: event_function_t
    type(trajectory_t), pointer :: trajectory => null()
    integer :: event = 0
    real(wp), allocatable :: y(:)            ! (point_size)
    logical :: detects = .false.             ! whether any number serves as the zero of an interval
    logical :: stopped = .false.             ! whether there was no value
  contains
    procedure :: value
  end type event_function_t

  real(wp), parameter :: tolerance = 4 * epsilon(1.0_wp)
  ! Bisection takes 53; near zeros of high multiplicity each may follow some useless interpolations.
  integer, parameter :: max_iterations = 3600

contains

  ! Evaluates the function of an event, or those of all for event 0, at a fraction of the step.
  subroutine values_at(x, event, theta, y, values)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), intent(in) :: theta
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size) for the point there
    real(wp), intent(inout) :: values(:)               ! (1) or (events)

    if (recalls(x, event, time_at(x, theta), values)) return
    call point_at(x, theta, y)
    call evaluate_events(x, event, time_at(x, theta), y, values)
  end subroutine values_at

  ! Evaluates the function at a fraction of the step.
  subroutine value(self, theta, found)
    class(event_function_t), intent(inout) :: self
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: found
    real(wp) :: values(1)

    values = 0.0_wp
    call values_at(self%trajectory, self%event, theta, self%y, values)
    found = values(1)
    self%stopped = self%trajectory%status /= finished
  end subroutine value

  ! Finds a zero of g between low and high.
  subroutine find_root(g, low, high, at_low, at_high, zero)
    type(event_function_t), intent(inout) :: g
    real(wp), intent(in) :: low, high              ! the ends
    real(wp), intent(in) :: at_low, at_high        ! values there, of opposite signs
    real(wp), intent(out) :: zero
    ! the best estimate, the one before, and one on the other side of the zero
    real(wp) :: a, b, c, fa, fb, fc
    real(wp) :: middle, enough, step, last_step, p, q, r, s
    logical :: converges
    integer :: i

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
      converges = .false.
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
        converges = 2 * p < min(3 * middle * q - abs(enough * q), abs(last_step * q))
      end if
      last_step = merge(step, middle, converges)
      step = middle
      if (converges) step = p / q
      a = b
      fa = fb
      b = b + merge(step, sign(enough, middle), abs(step) > enough)
      call g%value(b, fb)
      if (g%stopped) exit
    end do
    zero = b
  end subroutine find_root

end module root_m
