! The interface of least-squares problems: m residuals of n unknowns. Another thread may end a solve
! by a flag, which long loops read.
module least_squares_m
  use kinds, only: wp
  implicit none
  private
  public :: least_squares_t, stop_requested

  type, abstract :: least_squares_t
    integer, pointer :: stop_flag => null()  ! another thread ends the solve by setting it
  contains
    procedure(residual_i), deferred :: residual
  end type least_squares_t

  abstract interface
    ! f(x). A negative `flag` on return stops the solver, whose `info` it becomes.
    subroutine residual_i(self, x, f, flag)
      import :: least_squares_t, wp
      class(least_squares_t), intent(inout) :: self
      real(wp), intent(in) :: x(:)       ! (n)
      real(wp), intent(out) :: f(:)      ! (m)
      integer, intent(inout) :: flag
    end subroutine residual_i
  end interface

contains

  ! Whether another thread has set the flag since the call began; false without a flag
  logical function stop_requested(stop_flag)
    ! volatile, which excludes intent(in): every call reads the memory afresh
    integer, intent(inout), volatile, optional :: stop_flag

    stop_requested = .false.
    if (present(stop_flag)) stop_requested = stop_flag /= 0
  end function stop_requested

end module least_squares_m
