! The events of a step in the order of their times. Those at the same time happen together.
module simultaneous_events_m
  use controller_m, only: smallest_size
  use kinds, only: wp
  use output_m, only: store_event, output_t
  use requests_m, only: evaluate_events
  use trajectory_m, only: fail, forget_values, trajectory_t
  use within_step_m, only: point_at, time_at
  use iso_fortran_env, only: int64
  use shared_numbers, only: buffer_full, finished, raised
  implicit none
  private
  public :: store_zeros

  ! Fractions of a step between zeros of events that happen together: by the accuracy of zeros, and
  ! where rounding of the function decides its sign
  real(wp), parameter :: together = 32 * epsilon(1.0_wp), near = sqrt(epsilon(1.0_wp))

contains

  ! Stores zeros in the order of their times, up to the first one that ends the step. The status
  ! tells whether a function has failed, or there is no room for an event.
  subroutine store_zeros(x, output, until, ended, after)
    type(trajectory_t), intent(inout) :: x    ! its zeros move to 2
    type(output_t), intent(inout) :: output
    real(wp), intent(out) :: until                     ! fraction of the step that is kept
    logical, intent(out) :: ended                      ! whether an event ends the step there
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size) the point after all jumps
    logical :: happen(size(x%events%zeros))
    real(wp) :: y(size(after))
    integer :: k

    until = 1.0_wp
    ended = .false.
    associate (state => x%events, events => x%problem%events, zeros => x%events%zeros)
      do while (any(zeros%at < 2))
        k = minloc(zeros%at, 1)
        happen = zeros%at <= zeros(k)%at + together
        ended = any(happen .and. (events%jumps(zeros%event) &
                                  .or. state%count(zeros%event) + 1 >= events%limit(zeros%event)))
        call point_at(x, zeros(k)%at, y)
        happen = .false.
        happen(k) = .true.
        if (ended) then
          until = zeros(k)%at
          x%events%value_after(pack(zeros%event, zeros%at < 2)) = 0.0_wp
          call find_together(x, until, y, happen)
          if (x%status /= finished) return
        end if
        if (output%record%events + count(happen, kind=int64) > output%record%event_capacity) &
          x%status = buffer_full
        if (x%status /= finished) return
        call store_together(x, zeros(k)%at, y, happen, output, after)
        if (ended) state%came_from(pack(zeros%event, happen)) = pack(zeros%from, happen)
        if (x%status /= finished .or. ended) return
        zeros(k)%at = 2.0_wp
      end do
    end associate
  end subroutine store_zeros

  ! Finds the zeros that belong to the same time, one of each event: those that are as near as zeros
  ! are accurate, or where rounding has changed the sign already.
  subroutine find_together(x, until, y, happen)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: until                      ! fraction of the step
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) there
    logical, intent(inout) :: happen(:)                ! (zeros)
    real(wp) :: value(1)
    integer :: k

    associate (zeros => x%events%zeros, t => time_at(x, until))
      do k = 1, size(happen)
        if (zeros(k)%at > until + near .or. any(happen .and. zeros%event == zeros(k)%event)) cycle
        happen(k) = zeros(k)%at <= until + together
        if (happen(k)) cycle
        call evaluate_events(x, zeros(k)%event, t, y, value)
        if (x%status /= finished) return
        happen(k) = value(1) * real(zeros(k)%from, wp) <= 0 &
                    .or. abs(time_at(x, zeros(k)%at) - t) <= smallest_size(t)
        ! its zero is yet to come, and isn't another event
        if (happen(k)) x%events%value_after(zeros(k)%event) = value(1)
      end do
    end associate
    call forget_values(x)
  end subroutine find_together

  ! Stores events that happen together. Those without a jump come first, at the point before all
  ! jumps; then each jump starts from the point that the one before has left.
  subroutine store_together(x, theta, y, happen, output, after)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: theta                      ! fraction of the step
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) there
    logical, intent(in) :: happen(:)                   ! (zeros)
    type(output_t), intent(inout) :: output
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size)
    logical :: jumps(size(happen)), failed
    real(wp) :: before(size(y))
    integer :: i, k

    after = y
    associate (events => x%problem%events, zeros => x%events%zeros, t => time_at(x, theta))
      do k = 1, size(happen)
        associate (of => zeros(k)%event)
          if (happen(k)) x%events%count(of) = x%events%count(of) + 1
          jumps(k) = happen(k) .and. events%jumps(of) .and. (x%problem%goes_on &
                     .or. x%events%count(of) < events%limit(of))
          if (.not. happen(k)) cycle
          x%events%time(of) = t
          if (.not. jumps(k)) call store_event(output, x%member, of, t, y, y)
        end associate
      end do
      do k = 1, size(happen)
        if (.not. jumps(k)) cycle
        before = after
        call events%jump(x%member, zeros(k)%event, t, before, after, failed)
        if (failed) then
          call fail(x, raised, x%t_end)
          where ([(any(happen .and. zeros%event == i, 1), i=1, events%count)]) &
            x%events%count = x%events%count - 1
          return
        end if
        call store_event(output, x%member, zeros(k)%event, t, before, after)
      end do
    end associate
  end subroutine store_together

end module simultaneous_events_m
