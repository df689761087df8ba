! Events within a step.
! An event is a zero of a function along the interpolant, which Brent's method finds.
module step_events_m
  use kinds, only: wp
  use output_m, only: store_event, output_t
  use root_m, only: find_root, function_t
  use trajectory_m, only: problem_t, trajectory_t
  use within_step_m, only: point_at
  implicit none
  private
  public :: crosses, record_events, locate_events

  ! The function of an event along the interpolant
  type, extends(function_t) :: event_function_t
    type(problem_t), pointer :: problem => null()
    type(trajectory_t), pointer :: trajectory => null()
    integer :: event = 0
    real(wp), allocatable :: y(:)
  contains
    procedure :: value => event_along_step
  end type event_function_t

contains

  ! Whether an event's function changes sign in a step. A zero at the start doesn't count: it was
  ! found at the end of the step before, or it is the initial point.
  pure logical function crosses(problem, trajectory, event)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory
    integer, intent(in) :: event

    associate (before => trajectory%event_before(event), after => trajectory%event_after(event), &
               direction => problem%events%direction(event))
      crosses = (before < 0 .and. after >= 0 .and. direction >= 0) &
                .or. (before > 0 .and. after <= 0 .and. direction <= 0)
    end associate
  end function crosses

  ! Locates the first zero of each event as a fraction of the step, 2 if there is none.
  subroutine locate_events(problem, trajectory, theta, stopped)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), target, intent(inout) :: trajectory
    real(wp), allocatable, intent(out) :: theta(:)     ! (events)
    logical, intent(out) :: stopped
    type(event_function_t) :: g
    integer :: i

    allocate (theta(size(trajectory%event_before)), source=2.0_wp)
    stopped = .false.
    g%problem => problem
    g%trajectory => trajectory
    allocate (g%y(problem%frame%point_size))
    g%event = trajectory%jump_event
    if (g%event > 0) call locate_after_jump(problem, trajectory, g, theta(g%event), stopped)
    if (stopped) return
    do i = 1, size(theta)
      if (.not. crosses(problem, trajectory, i)) cycle
      theta(i) = 1.0_wp
      if (.not. abs(trajectory%event_after(i)) > 0) cycle
      g%event = i
      call find_root(g, 0.0_wp, 1.0_wp, trajectory%event_before(i), trajectory%event_after(i), &
                     theta(i), stopped)
      if (stopped) return
    end do
  end subroutine locate_events

  ! Locates an event in a step that starts from its own jump, where its function is zero up to
  ! rounding. If the function returns to zero within the step, as for a ball that hardly bounces, it
  ! has the other sign somewhere before the end; the step is searched by halving.
  subroutine locate_after_jump(problem, trajectory, g, theta, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    type(event_function_t), intent(inout) :: g
    real(wp), intent(inout) :: theta                   ! fraction of the step, 2 if there is none
    logical, intent(out) :: stopped
    integer, parameter :: halvings = 60
    real(wp) :: x, value, rounding
    integer :: k

    stopped = .false.
    rounding = 8 * max(abs(trajectory%value_after_jump), &
                       epsilon(1.0_wp) * maxval(abs(trajectory%y(:, 0))))
    associate (after => trajectory%event_after(g%event), &
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
  end subroutine locate_after_jump

  ! Evaluates the function of an event at a fraction of the step.
  subroutine event_along_step(self, x, y, stop)
    class(event_function_t), intent(inout) :: self
    real(wp), intent(in) :: x                          ! fraction of the step
    real(wp), intent(out) :: y
    logical, intent(out) :: stop

    associate (trajectory => self%trajectory)
      call point_at(self%problem, trajectory, x, self%y)
      call self%problem%events%value(trajectory%member, self%event, &
                                     trajectory%t + x * (trajectory%t_end - trajectory%t), &
                                       self%y, y, stop)
    end associate
  end subroutine event_along_step

  ! Records events in the order of their times, up to the first one that ends the step.
  subroutine record_events(problem, trajectory, theta, output, until, event, after, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(inout) :: theta(:)                ! (events) overwritten
    type(output_t), intent(inout) :: output
    real(wp), intent(out) :: until                     ! fraction of the step that is kept
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
        t = x%t_end
        if (theta(i) < 1) t = x%t + theta(i) * (x%t_end - x%t)
        call point_at(problem, trajectory, theta(i), y)
        x%event_count(i) = x%event_count(i) + 1
        after = y
        if (x%event_count(i) < events%most(i) .and. events%jumps(i)) then
          call events%jump(x%member, i, t, y, after, stopped)
          if (stopped) return
        end if
        call store_event(output, x%member, i, t, y, after)
        if (x%event_count(i) >= events%most(i) .or. events%jumps(i)) then
          until = theta(i)
          event = i
          return
        end if
        theta(i) = 2.0_wp
      end do
    end associate
  end subroutine record_events

end module step_events_m
