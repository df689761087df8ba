! The heavy top in body coordinates: B' = B hat(w), m' = m x w + MgL (B^T e3) x e3, I w = m.
! A point is B row by row, then m: the frame is SO(3) times R^3.
module heavy_top_m
  use kinds, only: wp
  use vector_field_m, only: vector_field_t
  implicit none
  private
  public :: heavy_top_t

  type, extends(vector_field_t) :: heavy_top_t
    real(wp) :: inertia(3) = 1.0_wp
    real(wp) :: mgl = 0.0_wp    ! mass times gravity times length
  contains
    procedure :: coefficients
  end type heavy_top_t

contains

  ! Evaluates w and m'.
  subroutine coefficients(self, n, m, t, y, f, flag)
    class(heavy_top_t), intent(inout) :: self
    integer, intent(in) :: n, m                    ! 12, 6
    real(wp), intent(in) :: t
    real(wp), intent(in) :: y(n)
    real(wp), intent(out) :: f(m)
    integer, intent(out) :: flag

    flag = 0
    associate (unused => t, up => y(7:9), p => y(10:12), w => f(1:3))
      w = p / self%inertia
      f(4) = p(2) * w(3) - p(3) * w(2) + self%mgl * up(2)
      f(5) = p(3) * w(1) - p(1) * w(3) - self%mgl * up(1)
      f(6) = p(1) * w(2) - p(2) * w(1)
    end associate
  end subroutine coefficients

end module heavy_top_m
