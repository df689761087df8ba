! Vectors of real numbers
module vectors_m
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  implicit none
  private
  public :: combine, copy, cross, finite

  ! ieee_value would save and restore the floating-point state, as ieee_is_finite would
  real(wp), parameter, public :: nan = transfer(int(z'7FF8000000000000', int64), 1.0_wp)

contains

  ! Tells whether all numbers are finite; where their sum is, all are.
  pure logical function finite(n, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)

    finite = abs(sum(x)) <= huge(x)
    if (.not. finite) finite = all(abs(x) <= huge(x))
  end function finite

  ! A weighted sum of vectors, without those of weight zero. Shapes are explicit, since array
  ! descriptors take as long as the sum. The compiler knows the most frequent size.
  pure subroutine combine(m, n, weight, k, sum)
    integer, intent(in) :: m, n
    real(wp), intent(in) :: weight(n), k(m, n)
    real(wp), intent(out) :: sum(m)
    real(wp) :: six(6)
    integer :: j

    if (m == 6) then
      six = 0.0_wp
      do j = 1, n
        if (abs(weight(j)) > 0) six = six + weight(j) * k(1:6, j)
      end do
      sum(1:6) = six
      return
    end if
    sum = 0.0_wp
    do j = 1, n
      if (abs(weight(j)) > 0) sum = sum + weight(j) * k(:, j)
    end do
  end subroutine combine

  ! Copies a vector. In a procedure of its own the compiler knows that two columns of an array don't
  ! overlap.
  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)

    to = from
  end subroutine copy

  ! The cross product
  pure function cross(u, v)
    real(wp), intent(in) :: u(3), v(3)
    real(wp) :: cross(3)

    cross = [u(2) * v(3) - u(3) * v(2), u(3) * v(1) - u(1) * v(3), u(1) * v(2) - u(2) * v(1)]
  end function cross

end module vectors_m
