! A vector field that is a function in C, in double precision:
!   int rhs(double t, const double *y, double *f, void *user_data)
module external_field
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_funptr, c_int, c_intptr_t, &
                                         c_null_ptr, c_ptr
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use kinds_r64, only: wp
  use stepper_r64, only: vector_field_t
  implicit none
  private
  public :: external_field_t, make_external_field, rhs_i

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

  type, extends(vector_field_t) :: external_field_t
    procedure(rhs_i), pointer, nopass :: rhs => null()
    type(c_ptr) :: user_data = c_null_ptr
    real(wp) :: nan = 0.0_wp
  contains
    procedure :: coefficients
  end type external_field_t

contains

  subroutine make_external_field(function_address, data_address, field)
    integer(c_intptr_t), intent(in) :: function_address
    integer(c_intptr_t), intent(in) :: data_address      ! 0 for none
    type(external_field_t), intent(out) :: field
    type(c_funptr) :: rhs

    rhs = transfer(function_address, rhs)
    call c_f_procpointer(rhs, field%rhs)
    field%user_data = transfer(data_address, field%user_data)
    field%nan = ieee_value(field%nan, ieee_quiet_nan)
  end subroutine make_external_field

  ! What the function leaves out stays NaN, which the stepper reports.
  subroutine coefficients(self, n, m, t, y, f, flag)
    class(external_field_t), intent(inout) :: self
    integer, intent(in) :: n, m
    real(wp), intent(in) :: t
    real(wp), intent(in) :: y(n)
    real(wp), intent(out) :: f(m)
    integer, intent(out) :: flag

    f = self%nan
    flag = self%rhs(t, y, f, self%user_data)
  end subroutine coefficients

end module external_field
