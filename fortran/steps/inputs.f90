! Inputs of compiled functions: values at a time of piecewise polynomials, which are written behind
! the parameters of a member.
module inputs_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_int64_t, c_intptr_t, c_null_ptr
  use kinds, only: wp
  implicit none
  private
  public :: inputs_t, last_before, longest_step

  type :: inputs_t
    ! of each curve: powers, pieces, width, first place in the data of a member, addresses of the
    ! starts of the pieces and of the coefficients (width, pieces, powers), and the bytes from the
    ! coefficients of one member to those of the next
    integer(c_int64_t), pointer, contiguous :: table(:, :) => null()   ! (7, curves)
  contains
    procedure :: write => write_inputs
  end type inputs_t

contains

  ! Writes the values at a time into the data of a member.
  subroutine write_inputs(self, t, member, data)
    class(inputs_t), intent(in) :: self
    real(wp), intent(in) :: t
    integer, intent(in) :: member
    integer(c_intptr_t), intent(in) :: data  ! their address
    real(wp), pointer, contiguous :: starts(:), coefficients(:, :, :), values(:)
    real(wp) :: s
    integer(c_intptr_t) :: before
    integer :: i, k, piece

    before = int(member - 1, c_intptr_t)
    do i = 1, size(self%table, 2)
      associate (row => int(self%table(:4, i)), address => self%table(5:6, i))
        call c_f_pointer(transfer(address(1), c_null_ptr), starts, [row(2)])
        call c_f_pointer(transfer(address(2) + before * self%table(7, i), c_null_ptr), &
                         coefficients, [row(3), row(2), row(1)])
        call c_f_pointer(transfer(data + 8 * int(row(4), c_intptr_t), c_null_ptr), values, [row(3)])
        piece = last_before(starts, t)
        s = t - starts(piece)
        values = coefficients(:, piece, row(1))
        do k = row(1) - 1, 1, -1
          values = coefficients(:, piece, k) + s * values
        end do
      end associate
    end do
  end subroutine write_inputs

  ! The last of increasing times that isn't after t, the first one if all are
  pure integer function last_before(times, t) result(low)
    real(wp), intent(in) :: times(:), t
    integer :: high, middle

    low = 1
    high = size(times) + 1
    do while (high - low > 1)
      middle = (low + high) / 2
      if (times(middle) <= t) then
        low = middle
      else
        high = middle
      end if
    end do
  end function last_before

  ! The longest step from a time, of two signs of direction, that doesn't reach into times where
  ! steps must be shorter than it. It may end where these begin.
  pure real(wp) function longest_step(limits, t, direction)
    real(wp), intent(in) :: limits(:, :)     ! (2, n) times, and how long steps may be from each on
    real(wp), intent(in) :: t, direction
    real(wp) :: ahead                        ! to the end of the times of the same limit
    integer :: i, next

    longest_step = huge(longest_step)
    if (size(limits, 2) == 0) return
    i = last_before(limits(1, :), t)
    if (direction < 0 .and. i > 1 .and. .not. limits(1, i) < t) i = i - 1
    longest_step = limits(2, i)
    do
      next = i + merge(1, -1, direction > 0)
      if (next < 1 .or. next > size(limits, 2)) return
      ahead = abs(limits(1, max(i, next)) - t)
      if (ahead >= longest_step) return
      longest_step = min(longest_step, max(limits(2, next), ahead))
      i = next
    end do
  end function longest_step

end module inputs_m
