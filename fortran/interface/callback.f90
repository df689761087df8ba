! Functions of Python and events in C for the loop over steps.
! python_field.c calls Python.
module callback_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_funptr, c_int, c_intptr_t, &
                                         c_null_ptr, c_ptr
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use frames_m, only: callback_t
  use inputs_m, only: inputs_t
  use kinds, only: wp
  use shared_numbers, only: event_operation, jump_operation
  use trajectory_m, only: events_t
  implicit none
  private
  public :: python_t, external_events_t

  ! Operations of shared_numbers on arrays
  type, extends(callback_t) :: python_t
    type(c_ptr) :: context = c_null_ptr      ! a function of Python
  contains
    procedure :: apply
  end type python_t

  ! Functions in C where there is an address, in Python elsewhere
  type, extends(events_t) :: external_events_t
    type(python_t) :: python
    integer(c_intptr_t), allocatable :: address(:), data(:)    ! (count)
    integer(c_intptr_t) :: member_data = 0   ! where a function has no data of its own
    integer(c_intptr_t) :: stride = 0        ! bytes from one member's data to the next
    type(inputs_t) :: inputs
  contains
    procedure :: value => event_value
    procedure :: jump => event_jump
  end type external_events_t

  abstract interface

    function event_i(t, y, user_data) bind(c) result(g)
      import :: c_double, c_ptr
      real(c_double), value, intent(in) :: t
      real(c_double), intent(in) :: y(*)
      type(c_ptr), value, intent(in) :: user_data
      real(c_double) :: g
    end function event_i

  end interface

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

  ! Applies an operation in Python. If it raises an exception, the result is NaN, and the exception
  ! remains set until the call from Python returns.
  subroutine apply(self, operation, a, b, c)
    class(python_t), intent(in) :: self
    integer, intent(in) :: operation
    real(wp), contiguous, intent(in) :: a(:), b(:)
    real(wp), contiguous, intent(inout) :: c(:)

    if (call_python(self%context, operation, size(a), a, size(b), b, size(c), c) == 0) return
    c = ieee_value(c, ieee_quiet_nan)
  end subroutine apply

  ! Evaluates the function of an event.
  subroutine event_value(self, member, event, t, y, g, flag)
    class(external_events_t), intent(in) :: self
    integer, intent(in) :: member, event
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    real(wp), intent(out) :: g
    logical, intent(out) :: flag
    procedure(event_i), pointer :: function
    type(c_funptr) :: pointer
    type(c_ptr) :: user_data
    integer(c_intptr_t) :: data, member_data
    real(wp) :: answer(1)

    flag = .false.
    if (self%address(event) /= 0) then
      pointer = transfer(self%address(event), pointer)
      call c_f_procpointer(pointer, function)
      data = self%data(event)
      member_data = self%member_data + int(member - 1, c_intptr_t) * self%stride
      if (data == 0) data = member_data
      user_data = transfer(data, user_data)
      if (associated(self%inputs%table)) call self%inputs%write(t, member, member_data)
      g = function(t, y, user_data)
      flag = .not. abs(g) <= huge(g)
      return
    end if
    call self%python%apply(event_operation, [t, real(member - 1, wp), real(event - 1, wp)], y, &
                           answer)
    g = answer(1)
    flag = .not. abs(g) <= huge(g)
  end subroutine event_value

  ! Evaluates the point after a jump.
  subroutine event_jump(self, member, event, t, y, after, flag)
    class(external_events_t), intent(in) :: self
    integer, intent(in) :: member, event
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)
    real(wp), contiguous, intent(out) :: after(:)
    logical, intent(out) :: flag

    call self%python%apply(jump_operation, [t, real(member - 1, wp), real(event - 1, wp)], y, after)
    flag = .not. all(abs(after) <= huge(after))
  end subroutine event_jump

end module callback_m
