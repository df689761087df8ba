! Grids of equal steps from one time to another.
! The last step may be shorter.
module time_grid_m
  use iso_fortran_env, only: int64
  use kinds, only: wp
  implicit none
  private
  public :: grid_t, make_grid

  type :: grid_t
    real(wp) :: start = 0.0_wp, step = 0.0_wp          ! step: negative to go backward
    real(wp) :: last = 0.0_wp, stop = 0.0_wp ! last: the last step
    integer(int64) :: steps = 0
  end type grid_t

contains

  ! Makes the grid. If h divides the span up to the rounding of its ends and of h, all steps are
  ! equal; otherwise the last one is the rest of the span. Each end carries half a unit of its
  ! rounding, the span from which an end was computed another, and each step half a unit of h.
  pure subroutine make_grid(start, stop, h, grid)
    real(wp), intent(in) :: start, stop, h               ! h: positive
    type(grid_t), intent(out) :: grid
    real(wp) :: span, error, slack, ratio, count, rest

    grid%start = start
    grid%stop = stop
    grid%step = sign(h, stop - start)
    grid%last = grid%step
    span = abs(stop - start)
    if (.not. span > 0) return
    error = rounded_off(start, stop)
    ratio = span / h
    slack = max(unit(max(abs(start), abs(stop))), unit(span)) + ratio * unit(h) / 2
    if (.not. ratio > 1) then
      grid%steps = 1
      if (h - span > slack) grid%last = stop - start
      return
    end if
    count = anint(ratio)
    rest = minus_product(span, count, h) + error
    if (.not. abs(rest) <= slack) count = aint(ratio) + merge(1.0_wp, 0.0_wp, aint(ratio) < ratio)
    count = max(count, 1.0_wp)
    grid%steps = int(count, int64)
    rest = minus_product(span, count - 1, h) + error
    if (abs(rest - h) > slack) grid%last = sign(rest, stop - start)
  end subroutine make_grid

  ! The rounding error of the span
  pure real(wp) function rounded_off(start, stop)
    real(wp), intent(in) :: start, stop
    real(wp) :: difference, part

    difference = stop - start
    part = difference - stop
    rounded_off = sign(1.0_wp, difference) * ((stop - (difference - part)) - (start + part))
  end function rounded_off

  ! x - a b, rounded about once: both factors are split into halves whose products are exact
  pure real(wp) function minus_product(x, a, b)
    real(wp), intent(in) :: x, a, b
    real(wp) :: p, ah, al, bh, bl

    p = a * b
    call split(a, ah, al)
    call split(b, bh, bl)
    minus_product = (x - p) + (((p - ah * bh) - ah * bl - al * bh) - al * bl)
  end function minus_product

  ! Splits a number into two halves of its digits (Dekker).
  pure subroutine split(x, high, low)
    real(wp), intent(in) :: x
    real(wp), intent(out) :: high, low
    real(wp), parameter :: factor = 2.0_wp**((digits(1.0_wp) + 1) / 2) + 1

    high = factor * x
    high = high - (high - x)
    low = x - high
  end subroutine split

  ! The distance to the next number
  pure real(wp) function unit(x)
    real(wp), intent(in) :: x

    unit = nearest(x, 1.0_wp) - x
  end function unit

end module time_grid_m
