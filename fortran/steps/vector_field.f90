! Right-hand sides that are functions in C:
!   int rhs(double t, const double *y, double *f, void *user_data)
! They give the coefficients f of the field sum_i f_i(t, y) E_i(y) at one point.
module vector_field_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_funptr, c_int, c_intptr_t, &
                                         c_null_ptr, c_ptr
  use inputs_m, only: inputs_t
  use kinds, only: wp
  use vectors_m, only: nan
  implicit none
  private
  public :: call_python_field, call_python_member, evaluate, field_at, rhs_i, vector_field_t

  abstract interface
    function rhs_i(t, y, f, user_data) bind(c) result(code)
      import :: c_double, c_int, c_ptr
      real(c_double), value, intent(in) :: t
      real(c_double), intent(in) :: y(*)
      real(c_double), intent(inout) :: f(*)
      type(c_ptr), value, intent(in) :: user_data
      integer(c_int) :: code
    end function rhs_i
  end interface

  ! in python_field.c: functions of Python, whose data are the user data or a member's
  procedure(rhs_i), bind(c) :: call_python_field, call_python_member

  type :: vector_field_t
    procedure(rhs_i), pointer, nopass :: rhs => null()
    integer :: member = 1                    ! that the point belongs to
    integer(c_intptr_t) :: data_address = 0  ! 0 for none
    integer(c_intptr_t) :: data_stride = 0   ! bytes from one member's data to the next
    type(inputs_t) :: inputs                 ! written into the data
  end type vector_field_t

contains

  ! The function at an address
  function field_at(address) result(rhs)
    integer(c_intptr_t), intent(in) :: address
    procedure(rhs_i), pointer :: rhs
    type(c_funptr) :: pointer

    pointer = transfer(address, pointer)
    call c_f_procpointer(pointer, rhs)
  end function field_at

  ! Evaluates the function. Coefficients that it doesn't write are NaN. Shapes are explicit, since
  ! array descriptors take as long as a short loop.
  subroutine evaluate(self, n, m, t, y, f, flag)
    type(vector_field_t), intent(in) :: self
    integer, intent(in) :: n, m                    ! point_size, dimension
    real(wp), intent(in) :: t, y(n)
    real(wp), intent(out) :: f(m)
    integer, intent(out) :: flag                   ! nonzero stops the integration
    integer(c_intptr_t) :: data

    f = nan
    data = self%data_address + int(self%member - 1, c_intptr_t) * self%data_stride
    if (associated(self%inputs%table)) call self%inputs%write(t, self%member, data)
    flag = self%rhs(t, y, f, transfer(data, c_null_ptr))
  end subroutine evaluate

end module vector_field_m
