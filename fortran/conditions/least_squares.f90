! The interface of least-squares problems: m residuals of n unknowns.
module least_squares_m
  use kinds, only: wp
  implicit none
  private
  public :: least_squares_t

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
end module least_squares_m
