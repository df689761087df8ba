! Functions along the solution, in C or Python: those of events, and those at output times.
module events_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_procpointer, c_intptr_t, c_null_funptr, &
                                         c_null_ptr, c_ptr
  use callback_m, only: callback_t
  use inputs_m, only: data_at, evaluate_rhs, member_data_t, rhs_t
  use kinds, only: wp
  use shared_numbers, only: event_operation, event_record_t, jump_operation, raised
  implicit none
  private
  public :: events_t, observer_t

  type :: events_t
    integer :: count = 0, width = 0          ! width: numbers of a point that they depend on
    type(event_record_t), pointer, contiguous :: table(:) => null()    ! (count)
    logical :: vectorized = .false.          ! whether they take several lanes, see requests_m
    type(callback_t) :: callback
    type(member_data_t) :: data              ! where a function has no data of its own
  contains
    procedure :: value => event_value, jump => event_jump
  end type events_t

  type :: observer_t
    integer :: count = 0                     ! numbers at a time
    type(rhs_t) :: rhs                       ! calls the function in Python
    type(events_t) :: functions              ! functions in C
  contains
    procedure :: observe
  end type observer_t

  abstract interface
    function event_i(t, y, user_data) bind(c) result(g)
      import :: c_double, c_ptr
      real(c_double), value, intent(in) :: t
      real(c_double), intent(in) :: y(*)
      type(c_ptr), value, intent(in) :: user_data
      real(c_double) :: g
    end function event_i
  end interface

contains

  ! Evaluates the function of an event. Values of one with a period are next to zero.
  subroutine event_value(self, member, event, t, y, g, failed)
    class(events_t), intent(in) :: self
    integer, intent(in) :: member, event               ! from 1
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(out) :: g
    logical, intent(out) :: failed                     ! whether the function failed
    procedure(event_i), pointer :: g_of
    integer(c_intptr_t) :: data
    real(wp) :: answer(1)

    associate (row => self%table(event))
      if (row%function /= 0) then
        call c_f_procpointer(transfer(row%function, c_null_funptr), g_of)
        data = data_at(self%data, t, member)
        if (row%data /= 0) data = row%data
        if (row%data == -1) data = 0         ! a null pointer
        g = g_of(t, y, transfer(data, c_null_ptr))
        if (row%period > 0) g = g - row%period * anint(g / row%period)
      else
        call self%callback%apply(event_operation, [t, real(member - 1, wp), real(event - 1, wp)], &
                                 y, answer)
        g = answer(1)
      end if
    end associate
    failed = .not. abs(g) <= huge(g)
  end subroutine event_value

  ! Evaluates the point after an event from the one before, in Python.
  subroutine event_jump(self, member, event, t, y, after, failed)
    class(events_t), intent(in) :: self
    integer, intent(in) :: member, event
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) before
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size)
    logical, intent(out) :: failed

    call self%callback%apply(jump_operation, [t, real(member - 1, wp), real(event - 1, wp)], y, &
                             after)
    failed = .not. all(abs(after) <= huge(after))
  end subroutine event_jump

  ! Evaluates what is observed at a point, in C or in Python.
  subroutine observe(self, member, t, y, values, status)
    class(observer_t), intent(inout) :: self
    integer, intent(in) :: member                      ! from 1
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: values(:)     ! (count)
    integer, intent(inout) :: status                   ! raised if one fails
    integer :: code, i
    logical :: failed

    if (self%functions%count == 0) then
      self%rhs%member = member
      call evaluate_rhs(self%rhs, size(y), self%count, t, y, values, code)
      if (code /= 0) status = raised
    end if
    do i = 1, self%functions%count
      call self%functions%value(member, i, t, y, values(i), failed)
      if (failed) status = raised
    end do
  end subroutine observe

end module events_m
