! Right-hand sides that are affine in the point and in time.
! The coefficients are f = constant + linear y + t slope.
module affine_field_m
  use kinds, only: wp
  use vector_field_m, only: vector_field_t
  implicit none
  private
  public :: affine_field_t

  type, extends(vector_field_t) :: affine_field_t
    real(wp), allocatable :: constant(:)     ! (dimension)
    real(wp), allocatable :: linear(:, :)    ! (dimension, point_size)
    real(wp), allocatable :: slope(:)        ! (dimension)
  contains
    procedure :: coefficients
  end type affine_field_t

contains

  ! Evaluates f.
  subroutine coefficients(self, n, m, t, y, f, flag)
    class(affine_field_t), intent(inout) :: self
    integer, intent(in) :: n, m
    real(wp), intent(in) :: t
    real(wp), intent(in) :: y(n)
    real(wp), intent(out) :: f(m)
    integer, intent(out) :: flag

    flag = 0
    f = self%constant + t * self%slope + matmul(self%linear, y)
  end subroutine coefficients

end module affine_field_m
