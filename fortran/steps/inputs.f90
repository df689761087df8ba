! Inputs of compiled functions: values at a time of piecewise polynomials, which are written behind
! the parameters of a member.
module inputs_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_int64_t, c_intptr_t, c_null_ptr
  use kinds, only: wp
  implicit none
  private
  public :: inputs_t

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

end module inputs_m
