! The right-hand side of a differential equation: the coefficients f of the field sum_i f_i(t, y) E_i(y)
module vector_field_m
  use kinds, only: wp
  implicit none
  private
  public :: vector_field_t

  type, abstract :: vector_field_t
    integer :: member = 1                    ! whose coefficients are wanted
  contains
    procedure(coefficients_i), deferred :: coefficients
  end type vector_field_t

  abstract interface

    ! Shapes are explicit, since to describe an array takes as long as to go through one of so few
    ! numbers.
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
