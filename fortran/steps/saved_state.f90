! The state of a trajectory between steps, as bytes.
module saved_state_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_loc, c_ptr
  use, intrinsic :: iso_fortran_env, only: int8
  use kinds, only: wp
  use shared_numbers, only: terminal_event
  use trajectory_m, only: continue_trajectory, trajectory_t
  implicit none
  private
  public :: exchange_state

  integer, parameter :: bytes_of_real = storage_size(1.0_wp) / 8

contains

  ! Copies what a trajectory needs between steps to continue bit for bit, or restores it.
  subroutine exchange_state(x, restores, bytes, used)
    type(trajectory_t), target, intent(inout) :: x
    logical, intent(in) :: restores
    integer(int8), intent(inout) :: bytes(:) ! as many as are used, or none to count them
    integer, intent(out) :: used
    integer :: status

    used = 0
    call move(c_loc(x%state_t), storage_size(x%state_t) / 8)
    call move(c_loc(x%newton%newton_state_t), storage_size(x%newton%newton_state_t) / 8)
    call move(c_loc(x%events), storage_size(x%events) / 8 * size(x%events))
    call move(c_loc(x%y), bytes_of_real * size(x%y, 1))
    call move(c_loc(x%slope), bytes_of_real * size(x%slope))
    call move(c_loc(x%f), bytes_of_real * size(x%f))
    if (allocated(x%last_y)) then
      call move(c_loc(x%last_y), bytes_of_real * size(x%last_y))
      call move(c_loc(x%last_slope), bytes_of_real * size(x%last_slope))
    end if
    if (allocated(x%f_before)) call move(c_loc(x%f_before), bytes_of_real * size(x%f_before))
    if (allocated(x%joints%impulse)) &
      call move(c_loc(x%joints%impulse), bytes_of_real * size(x%joints%impulse))
    if (allocated(x%newton%last)) then
      call move(c_loc(x%newton%last), bytes_of_real * size(x%newton%last))
      call move(c_loc(x%newton%jacobian), bytes_of_real * size(x%newton%jacobian))
    end if
    if (allocated(x%solver%lu)) then
      call move(c_loc(x%solver%factored_h), bytes_of_real * size(x%solver%factored_h))
      call move(c_loc(x%solver%lu), bytes_of_real * size(x%solver%lu))
      call move(c_loc(x%solver%pivot), storage_size(x%solver%pivot) / 8 * size(x%solver%pivot))
    end if
    if (.not. restores) return
    x%weighted_by = 0.0_wp
    x%last%cut = .false.                     ! its interpolant isn't saved
    status = x%status
    call continue_trajectory(x)
    if (status == terminal_event) x%status = status

  contains

    ! Copies some bytes, or restores them.
    subroutine move(address, count)
      type(c_ptr), intent(in) :: address
      integer, intent(in) :: count
      integer(int8), pointer, contiguous :: part(:)

      call c_f_pointer(address, part, [count])
      used = used + count
      if (used > size(bytes)) return
      if (restores) part = bytes(used - count + 1:used)
      if (.not. restores) bytes(used - count + 1:used) = part
    end subroutine move
  end subroutine exchange_state

end module saved_state_m
