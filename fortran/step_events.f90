! Events within a step
module step_events_m
  use kinds, only: wp
  use output_m, only: keep_event, output_t
  use root_m, only: find_root, function_t
  use trajectory_m, only: problem_t, trajectory_t
  use within_step_m, only: point_at
  implicit none
  private
  public :: crosses, keep_events, locate_events

  ! An event along the interpolant of the step
  type, extends(function_t) :: event_function_t
    type(problem_t), pointer :: problem => null()
    type(trajectory_t), pointer :: trajectory => null()
    integer :: event = 0
    real(wp), allocatable :: y(:)
  contains
    procedure :: value => event_along_step
  end type event_function_t

contains

  ! A zero at the beginning of a step was found at the end of the last one, or is the initial point,
  ! which nothing has led to.
  pure logical function crosses(problem, trajectory, event)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory
    integer, intent(in) :: event

    associate (before => trajectory%value(event), after => trajectory%value_after(event), &
               direction => problem%events%direction(event))
      crosses = (before < 0 .and. after >= 0 .and. direction >= 0) &
                .or. (before > 0 .and. after <= 0 .and. direction <= 0)
    end associate
  end function crosses

  ! Where in the step each event happens, 2 if it doesn't
  subroutine locate_events(problem, trajectory, theta, stopped)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    real(wp), allocatable, intent(out) :: theta(:)     ! (events)
    logical, intent(out) :: stopped
    type(event_function_t) :: g
    integer :: i

    allocate (theta(size(trajectory%value)), source=2.0_wp)
    stopped = .false.
    g%problem => problem
    g%trajectory => trajectory
    allocate (g%y(problem%frame%point_size))
    g%event = trajectory%jumped
    if (g%event > 0) call locate_again(problem, trajectory, g, theta(g%event), stopped)
    if (stopped) return
    do i = 1, size(theta)
      if (.not. crosses(problem, trajectory, i)) cycle
      theta(i) = 1.0_wp
      if (.not. abs(trajectory%value_after(i)) > 0) cycle
      g%event = i
      call find_root(g, 0.0_wp, 1.0_wp, trajectory%value(i), trajectory%value_after(i), theta(i), &
                     stopped)
      if (stopped) return
    end do
  end subroutine locate_events

  ! After a jump the event's function is zero, or rounding, at the start of the step. It may leave and
  ! come back within the step, as a ball that hardly bounces does: then it has the other sign, by more
  ! than rounding, at some place before the end.
  subroutine locate_again(problem, trajectory, g, theta, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    type(event_function_t), intent(inout) :: g
    real(wp), intent(inout) :: theta                   ! place of the event, 2 if there is none
    logical, intent(out) :: stopped
    integer, parameter :: halvings = 60
    real(wp) :: x, value, rounding
    integer :: k

    stopped = .false.
    rounding = 8 * max(abs(trajectory%jumped_from), &
                       epsilon(1.0_wp) * maxval(abs(trajectory%y(:, 0))))
    associate (after => trajectory%value_after(g%event), &
               direction => problem%events%direction(g%event))
      if (.not. abs(after) > 0 .or. real(direction, wp) * after < 0) return
      do k = 1, halvings
        x = 0.5_wp**k
        call g%value(x, value, stopped)
        if (stopped) return
        if (value * sign(1.0_wp, after) < -rounding) then
          call find_root(g, x, 1.0_wp, value, after, theta, stopped)
          return
        end if
      end do
    end associate
  end subroutine locate_again

  subroutine event_along_step(self, x, y, stop)
    class(event_function_t), intent(inout) :: self
    real(wp), intent(in) :: x                          ! fraction of the step
    real(wp), intent(out) :: y
    logical, intent(out) :: stop

    associate (trajectory => self%trajectory)
      call point_at(self%problem, trajectory, x, self%y)
      call self%problem%events%value(trajectory%member, self%event, &
                                     trajectory%t + x * (trajectory%end - trajectory%t), self%y, y, &
                                     stop)
    end associate
  end subroutine event_along_step

  ! Keeps events in the order of their times, up to the first one that ends the step.
  subroutine keep_events(problem, trajectory, theta, output, until, event, after, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(inout) :: theta(:)                ! (events) is used up
    type(output_t), intent(inout) :: output
    real(wp), intent(out) :: until                     ! fraction of the step that counts
    integer, intent(out) :: event                      ! that ends it, 0 for none
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size) the point after its jump
    logical, intent(out) :: stopped
    real(wp) :: t, y(size(after))
    integer :: i

    until = 1.0_wp
    event = 0
    stopped = .false.
    associate (x => trajectory, events => problem%events)
      do while (minval(theta) < 2)
        i = minloc(theta, 1)
        t = x%end
        if (theta(i) < 1) t = x%t + theta(i) * (x%end - x%t)
        call point_at(problem, trajectory, theta(i), y)
        x%count(i) = x%count(i) + 1
        after = y
        if (x%count(i) < events%most(i) .and. events%jumps(i)) then
          call events%jump(x%member, i, t, y, after, stopped)
          if (stopped) return
        end if
        call keep_event(output, x%member, i, t, y, after)
        if (x%count(i) >= events%most(i) .or. events%jumps(i)) then
          until = theta(i)
          event = i
          return
        end if
        theta(i) = 2.0_wp
      end do
    end associate
  end subroutine keep_events

end module step_events_m
