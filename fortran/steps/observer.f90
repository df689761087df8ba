! Functions of the solution that are evaluated at output times: one in Python, or some in C, one
! number each.
module observer_m
  use events_m, only: events_t
  use kinds, only: wp
  use vector_field_m, only: evaluate, vector_field_t
  implicit none
  private
  public :: observer_t

  type :: observer_t
    integer :: count = 0                     ! numbers at a time
    type(vector_field_t) :: field            ! calls the function in Python
    type(events_t) :: functions              ! those in C
  contains
    procedure :: observe
  end type observer_t

contains

  ! Evaluates the functions at a point.
  subroutine observe(self, member, t, y, values, failed)
    class(observer_t), intent(inout) :: self
    integer, intent(in) :: member            ! from 1
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: values(:)     ! (count)
    logical, intent(out) :: failed
    integer :: flag, i

    failed = .false.
    if (self%functions%count == 0) then
      self%field%member = member
      call evaluate(self%field, size(y), self%count, t, y, values, flag)
      failed = flag /= 0
    end if
    do i = 1, self%functions%count
      call self%functions%value(member, i, t, y, values(i), failed)
      if (failed) return
    end do
  end subroutine observe

end module observer_m
