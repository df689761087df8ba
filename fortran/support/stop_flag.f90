! The flag by which another thread stops a call. Long loops read it.
module stop_flag_m
  implicit none
  private
  public :: stop_requested

contains

  ! Whether another thread has set the flag since the call began; false without a flag
  logical function stop_requested(stop_flag)
    ! volatile, which excludes intent(in): every call reads the memory afresh
    integer, intent(inout), volatile, optional :: stop_flag

    stop_requested = .false.
    if (present(stop_flag)) stop_requested = stop_flag /= 0
  end function stop_requested

end module stop_flag_m
