! Right-hand sides that are functions in C, in double precision:
!   int rhs(double t, const double *y, double *f, void *user_data)
module external_field_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_funptr, c_int, c_intptr_t, &
                                         c_ptr
  implicit none
  private
  public :: field_at, rhs_i

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

contains

  ! The function at an address
  function field_at(address) result(rhs)
    integer(c_intptr_t), intent(in) :: address
    procedure(rhs_i), pointer :: rhs
    type(c_funptr) :: pointer

    pointer = transfer(address, pointer)
    call c_f_procpointer(pointer, rhs)
  end function field_at

end module external_field_m
