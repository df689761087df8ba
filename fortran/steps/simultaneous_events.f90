! The events of a step in the order of their times. Those at the same time happen together.
module simultaneous_events_m
  use controller_m, only: smallest_size
  use kinds, only: wp
  use output_m, only: store_event, output_t
  use trajectory_m, only: trajectory_t
  use within_step_m, only: point_at, time_at
  use iso_fortran_env, only: int64
  implicit none
  private
  public :: record_zeros

  ! Fractions of a step between zeros of events that happen together: by the accuracy of zeros, and
  ! where rounding of the function decides its sign
  real(wp), parameter :: together = 32 * epsilon(1.0_wp), near = sqrt(epsilon(1.0_wp))

contains

  ! Records zeros in the order of their times, up to the first one that ends the step.
  subroutine record_zeros(x, output, until, ended, after, full, stopped)
    type(trajectory_t), intent(inout) :: x    ! its zeros move to 2
    type(output_t), intent(inout) :: output
    real(wp), intent(out) :: until                     ! fraction of the step that is kept
    logical, intent(out) :: ended                      ! whether an event ends the step there
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size) the point after all jumps
    logical, intent(out) :: full                       ! whether there is no room for an event
    logical, intent(out) :: stopped
    logical :: happen(size(x%events%zeros))
    real(wp) :: y(size(after))
    integer :: k

    until = 1.0_wp
    ended = .false.
    stopped = .false.
    associate (state => x%events, events => x%problem%events, zeros => x%events%zeros)
      do while (any(zeros%at < 2))
        k = minloc(zeros%at, 1)
        happen = zeros%at <= zeros(k)%at + together
        ended = any(happen .and. (events%jumps(zeros%event) &
                                  .or. state%count(zeros%event) + 1 >= events%most(zeros%event)))
        call point_at(x, zeros(k)%at, y)
        happen = .false.
        happen(k) = .true.
        if (ended) then
          until = zeros(k)%at
          call find_together(x, until, y, happen, stopped)
          if (stopped) return
        end if
        full = output%events + count(happen, kind=int64) > output%event_capacity
        if (full) return
        call record_together(x, zeros(k)%at, y, happen, output, after, stopped)
        if (ended) state%came_from(pack(zeros%event, happen)) = pack(zeros%from, happen)
        if (stopped .or. ended) return
        zeros(k)%at = 2.0_wp
      end do
    end associate
    full = .false.
  end subroutine record_zeros

  ! Finds the zeros that belong to the same time, one of each event: those that are as near as zeros
  ! are accurate, or where rounding has changed the sign already.
  subroutine find_together(x, until, y, happen, stopped)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: until                      ! fraction of the step
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) there
    logical, intent(inout) :: happen(:)                ! (zeros)
    logical, intent(out) :: stopped
    real(wp) :: value
    integer :: k

    stopped = .false.
    associate (zeros => x%events%zeros, t => time_at(x, until))
      do k = 1, size(happen)
        if (zeros(k)%at > until + near .or. any(happen .and. zeros%event == zeros(k)%event)) cycle
        happen(k) = zeros(k)%at <= until + together &
                    .or. abs(time_at(x, zeros(k)%at) - t) <= smallest_size(t)
        if (happen(k)) cycle
        call x%problem%events%value(x%member, zeros(k)%event, t, y, value, stopped)
        if (stopped) return
        happen(k) = value * real(zeros(k)%from, wp) <= 0
      end do
    end associate
  end subroutine find_together

  ! Records events that happen together. Those without a jump come first, at the point before all
  ! jumps; then each jump starts from the point that the one before has left.
  subroutine record_together(x, theta, y, happen, output, after, stopped)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: theta                      ! fraction of the step
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) there
    logical, intent(in) :: happen(:)                   ! (zeros)
    type(output_t), intent(inout) :: output
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size)
    logical, intent(out) :: stopped
    logical :: jumps(size(happen))
    real(wp) :: before(size(y))
    integer :: i, k

    stopped = .false.
    after = y
    associate (events => x%problem%events, zeros => x%events%zeros, t => time_at(x, theta))
      do k = 1, size(happen)
        associate (of => zeros(k)%event)
          if (happen(k)) x%events%count(of) = x%events%count(of) + 1
          jumps(k) = happen(k) .and. events%jumps(of) .and. (x%last%kept &
                     .or. x%events%count(of) < events%most(of))
          if (.not. happen(k)) cycle
          x%events%time(of) = t
          if (.not. jumps(k)) call store_event(output, x%member, of, t, y, y)
        end associate
      end do
      do k = 1, size(happen)
        if (.not. jumps(k)) cycle
        before = after
        call events%jump(x%member, zeros(k)%event, t, before, after, stopped)
        if (stopped) then
          where ([(any(happen .and. zeros%event == i, 1), i=1, events%count)]) &
            x%events%count = x%events%count - 1
          return
        end if
        call store_event(output, x%member, zeros(k)%event, t, before, after)
      end do
    end associate
  end subroutine record_together

end module simultaneous_events_m
