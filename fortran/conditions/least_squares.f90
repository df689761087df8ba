! The interface of least-squares problems: m residuals of n unknowns, and for some their Jacobian.
! Another thread can stop a solve by a flag.
module least_squares_m
  use kinds, only: wp
  use stop_flag_m, only: stop_requested
  implicit none
  private
  public :: least_squares_t, differentiable_t, residual_calls, jacobian_calls

  ! Values of `flag` on entry: what the evaluation is for.
  integer, parameter :: residual_calls = 1
  integer, parameter :: jacobian_calls = 2

  type, abstract :: least_squares_t
    integer, pointer :: stop_flag => null()  ! another thread ends the solve by setting it
  contains
    procedure(residual_i), deferred :: residual
    procedure, non_overridable :: stopped
  end type least_squares_t

  type, abstract, extends(least_squares_t) :: differentiable_t
  contains
    procedure(jacobian_i), deferred :: jacobian
  end type differentiable_t

  abstract interface

    ! f(x). A negative `flag` on return stops the solver, whose `info` it becomes.
    subroutine residual_i(self, x, f, flag)
      import :: least_squares_t, wp
      class(least_squares_t), intent(inout) :: self
      real(wp), intent(in) :: x(:)       ! (n)
      real(wp), intent(out) :: f(:)      ! (m)
      integer, intent(inout) :: flag
    end subroutine residual_i

    ! The derivatives of f at x. A negative `flag` stops the solver here too.
    subroutine jacobian_i(self, x, jac, flag)
      import :: differentiable_t, wp
      class(differentiable_t), intent(inout) :: self
      real(wp), intent(in) :: x(:)       ! (n)
      real(wp), intent(out) :: jac(:,:)  ! (m, n)
      integer, intent(inout) :: flag
    end subroutine jacobian_i

  end interface

contains

  logical function stopped(self)
    class(least_squares_t), intent(in) :: self

    stopped = .false.
    if (associated(self%stop_flag)) stopped = stop_requested(self%stop_flag)
  end function stopped

end module least_squares_m
