! The interface of right-hand sides.
! A right-hand side gives the coefficients f of the field sum_i f_i(t, y) E_i(y) at one point.
module vector_field_m
  use kinds, only: wp
  implicit none
  private
  public :: vector_field_t

  type, abstract :: vector_field_t
    integer :: member = 1                    ! that the point belongs to
  contains
    procedure(coefficients_i), deferred :: coefficients
  end type vector_field_t

  abstract interface

    ! Evaluates the coefficients. Shapes are explicit, since array descriptors take as long as a
    ! short loop.
    subroutine coefficients_i(self, n, m, t, y, f, flag)
      import :: vector_field_t, wp
      class(vector_field_t), intent(inout) :: self
      integer, intent(in) :: n, m                    ! point_size, dimension
      real(wp), intent(in) :: t
      real(wp), intent(in) :: y(n)
      real(wp), intent(out) :: f(m)
      integer, intent(out) :: flag                   ! nonzero stops the integration
    end subroutine coefficients_i

  end interface

end module vector_field_m
