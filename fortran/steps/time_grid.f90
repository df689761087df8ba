! Grids of equal steps from one time to another.
! The last step may be shorter.
module time_grid_m
  use, intrinsic :: iso_c_binding, only: c_double
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

  interface
    ! x y + z, rounded once
    pure real(c_double) function fma(x, y, z) bind(c)
      import :: c_double
      real(c_double), value, intent(in) :: x, y, z
    end function fma
  end interface

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
    rest = fma(-count, h, span) + error
    if (.not. abs(rest) <= slack) count = aint(ratio) + merge(1.0_wp, 0.0_wp, aint(ratio) < ratio)
    count = max(count, 1.0_wp)
    grid%steps = int(count, int64)
    rest = fma(1 - count, h, span) + error
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

  ! The distance to the next number
  pure real(wp) function unit(x)
    real(wp), intent(in) :: x

    unit = nearest(x, 1.0_wp) - x
  end function unit

end module time_grid_m
