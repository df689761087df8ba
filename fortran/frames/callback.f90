! Operations of shared_numbers on arrays, by a function of Python that python_rhs.c calls.
module callback_m
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_null_ptr, c_ptr
  use kinds, only: wp
  use vectors_m, only: nan
  implicit none
  private
  public :: callback_t

  type :: callback_t
    type(c_ptr) :: context = c_null_ptr      ! a function of Python
  contains
    procedure :: apply
  end type callback_t

  interface
    function call_python(context, operation, na, a, nb, b, nc, c) bind(c) result(code)
      import :: c_double, c_int, c_ptr
      type(c_ptr), value, intent(in) :: context
      integer(c_int), value, intent(in) :: operation, na, nb, nc
      real(c_double), intent(in) :: a(*), b(*)
      real(c_double), intent(inout) :: c(*)
      integer(c_int) :: code
    end function call_python
  end interface

contains

  ! Applies an operation in Python. After an exception, raised on return, the result is NaN.
  subroutine apply(self, operation, a, b, c, failed)
    class(callback_t), intent(in) :: self
    integer, intent(in) :: operation
    real(wp), contiguous, intent(in) :: a(:), b(:)
    real(wp), contiguous, intent(inout) :: c(:)
    logical, optional, intent(out) :: failed           ! whether it raised an exception
    integer :: code

    code = call_python(self%context, operation, size(a), a, size(b), b, size(c), c)
    if (code /= 0) c = nan
    if (present(failed)) failed = code /= 0
  end subroutine apply

end module callback_m
