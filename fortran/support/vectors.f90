! Vectors of real numbers
module vectors_m
  use kinds, only: wp
  implicit none
  private
  public :: copy, finite

contains

  ! Tells whether all numbers are finite. With ieee_is_finite every procedure that uses its module
  ! would save and restore the floating-point state.
  pure logical function finite(x)
    real(wp), contiguous, intent(in) :: x(:)

    finite = all(abs(x) <= huge(x))
  end function finite

  ! Copies a vector. In a procedure of its own the compiler knows that two columns of an array don't
  ! overlap.
  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)

    to = from
  end subroutine copy

end module vectors_m
