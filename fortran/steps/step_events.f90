! Events within a step. An event is a zero of a function g(t, y) along the solution. The signs of g
! are compared at the ends of parts of the step, and where a parabola through three of these values
! comes near to zero, since g may change sign twice within a part. A step has at least four parts,
! and more if it rotates by more than 120 degrees. Of four parts only the middle of the step is
! evaluated if values at the middle and the ends differ by less than their distance from zero.
!
! Detection comes first, along the cubic through the ends of the step: it tells whether there may be
! a zero, for which the accurate interpolant is then completed, and zeros are found along that one.
!
! A zero between two points where g has opposite signs is found by inverse quadratic interpolation
! where that is sure to converge, else by bisection: T. R. Chandrupatla, "A new hybrid quadratic/
! bisection algorithm", Adv. Eng. Software 28 (1997). Zeros at the same time happen together.
module step_events_m
  use controller_m, only: resolution
  use frames_m, only: turning
  use free_motion_m, only: add_free_motion
  use kinds, only: wp
  use output_m, only: output_t, store_event
  use requests_m, only: evaluate_events, reject_accepted_step
  use shared_numbers, only: callback_block, event_record_t, needs_events, no_stop, out_of_memory, &
                            parts_of_turn, raised, resting_contact, splitting_kind, &
                            step_too_long, step_too_long_for_events
  use trajectory_m, only: event_state_t, fail, point_at, time_at, trajectory_t, zero_t
  use zero_finding_m, only: choose_trial, crosses, narrow, power_of_growth, sample_t
  implicit none
  private
  public :: ends_step, find_zeros, max_adaptive_angle, store_zeros

  real(wp), parameter :: root_tolerance = 4 * epsilon(1.0_wp)          ! of a fraction of the step
  ! Bisection takes 53 iterations, far more towards zero; interpolations are at most as many.
  integer, parameter :: max_root_iterations = 3600

  ! Parts of a step. Frames known to rotate turn by at most `part_angle` in one. Adaptive steps that
  ! need more than `max_adaptive_parts`, or common ones without an end that rotate by more than a
  ! turn, are tried again with a smaller size; equal ones fail above `max_fixed_parts`.
  integer, parameter :: min_parts = 4, max_adaptive_parts = 10000, max_fixed_parts = 10**8
  real(wp), parameter :: part_angle = 2 * acos(-1.0_wp) / parts_of_turn
  real(wp), parameter :: max_adaptive_angle = max_adaptive_parts * part_angle
  ! Frames in Python give only a bound of the angle; larger ones count as two turns.
  real(wp), parameter :: two_turns = 4 * acos(-1.0_wp)

  ! Events are simultaneous if their zeros differ by at most the first of these fractions of a step,
  ! the accuracy of zeros; or by the second, where rounding has changed the sign before the zero.
  real(wp), parameter :: same_time_tolerance = 32 * epsilon(1.0_wp)
  real(wp), parameter :: decided_by_rounding = sqrt(epsilon(1.0_wp))

contains

  ! Evaluates the function of an event at a sample's fraction of the step; see evaluate_events.
  subroutine evaluate_sample(x, event, sample)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), intent(inout) :: sample
    real(wp) :: values(1)

    values = sample%value
    call evaluate_events(x, event, sample%theta, values)
    sample%value = values(1)
  end subroutine evaluate_sample

  ! Finds a zero of an event between two points, as far as there are values.
  subroutine find_zero(x, event, low, high, zero)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), intent(in) :: low, high            ! with values of opposite signs
    real(wp), intent(out) :: zero                      ! fraction of the step
    ! the last point, one on the other side of the zero, the one that was replaced, and the next one
    type(sample_t) :: a, b, c, new
    real(wp) :: part, min_part, xi, phi                ! part: of the way from a to b; see the paper
    integer :: i

    a = high
    b = low
    zero = high%theta
    part = 0.5_wp
    do i = 1, max_root_iterations
      new%theta = a%theta + part * (b%theta - a%theta)
      call evaluate_sample(x, event, new)
      if (x%status /= no_stop) exit
      c = b
      if (new%value * sign(1.0_wp, a%value) > 0) then
        c = a
      else
        b = a
      end if
      a = new
      zero = merge(a%theta, b%theta, abs(a%value) < abs(b%value))
      min_part = root_tolerance * (abs(zero) + 1) / abs(b%theta - a%theta) / 2
      if (min_part > 0.5_wp .or. a%value == 0) exit
      ! the inverse parabola through a, b and c is used where it increases between a and b
      xi = (a%theta - b%theta) / (c%theta - b%theta)
      phi = (a%value - b%value) / (c%value - b%value)
      part = 0.5_wp
      if (phi**2 < xi .and. (1 - phi)**2 < 1 - xi) &
        part = a%value / (b%value - a%value) * c%value / (b%value - c%value) &
               + (c%theta - a%theta) / (b%theta - a%theta) * a%value / (c%value - a%value) &
                 * b%value / (c%value - b%value)
      part = min(1 - min_part, max(min_part, part))
    end do
  end subroutine find_zero

  ! Whether an event ends the step, by a jump or since it is the last one
  pure elemental logical function ends_step(event, row)
    type(event_state_t), intent(in) :: event
    type(event_record_t), intent(in) :: row  ! the event's

    ends_step = row%jumps /= 0 .or. event%count + 1 >= row%limit
  end function ends_step

  ! Finds the zeros of all events in a step, unless it is too long or a function fails. Values at
  ! the ends of parts are requested together, then for each event those that its zeros need. In the
  ! meantime nothing changes. Before the interpolant is complete, times aren't computed.
  subroutine find_zeros(x)
    type(trajectory_t), intent(inout) :: x   ! x%zeros are set
    logical :: may_cross, waits
    type(sample_t), allocatable :: samples(:, :)       ! (0:parts, events) at the ends of parts
    type(event_state_t) :: events(size(x%events))      ! before
    integer :: i, alloc_status, max_parts, n

    n = count_parts(x)
    max_parts = merge(max_adaptive_parts, max_fixed_parts, x%problem%adaptive)
    if (x%problem%adaptive .and. x%problem%record%common &
        .and. abs(x%problem%stops(x%segment)) > huge(1.0_wp)) max_parts = parts_of_turn
    if (n > max_parts) then
      if (x%problem%adaptive) call reject_accepted_step(x, step_too_long, x%t)
      if (.not. x%problem%adaptive) call fail(x, step_too_long_for_events, x%t)
      return
    end if
    allocate (samples(0:n, size(x%events)), stat=alloc_status)
    if (alloc_status /= 0) then
      call fail(x, out_of_memory, x%t)
      return
    end if
    call evaluate_parts(x, samples, may_cross)
    if (x%status /= no_stop) return
    x%zeros = [zero_t ::]
    if (.not. may_cross) return
    events = x%events
    waits = .false.
    do i = 1, size(samples, 2)
      if (x%events(i)%sign_before /= 0) call find_after_event(x, i, samples(:, i))
      if (x%status == no_stop) call find_zeros_of_event(x, i, samples(:, i))
      if (x%status == needs_events) then     ! the other events request their values, too
        waits = .true.
        x%status = no_stop
      else if (x%status /= no_stop) then
        exit
      end if
    end do
    if (.not. waits .and. x%status == no_stop) return
    if (x%status == no_stop) x%status = needs_events
    x%events = events                        ! the step may be tried again
    deallocate (x%zeros)
  end subroutine find_zeros

  ! Evaluates the functions of all events at the ends of parts: every second one, then the others.
  subroutine evaluate_parts(x, samples, may_cross)
    type(trajectory_t), intent(inout) :: x
    type(sample_t), intent(inout) :: samples(0:, :)    ! (0:parts, events)
    logical, intent(out) :: may_cross        ! whether the middle is near enough to a zero
    integer :: begin, k, n

    n = ubound(samples, 1)
    do k = 0, n
      samples(k, :)%theta = real(k, wp) / real(n, wp)
    end do
    samples(0, :)%value = x%events%at_start
    samples(n, :)%value = x%events%at_end
    do begin = 2, 1, -1
      do k = begin, n - 1, 2
        call evaluate_events(x, 0, samples(k, 1)%theta, samples(k, :)%value)
        if (all(x%status /= [no_stop, needs_events])) return
      end do
      may_cross = n > min_parts .or. .not. all(keeps_sign(x%events, samples(2, :)%value))
      if (x%status == needs_events .or. .not. may_cross) return
    end do
  end subroutine evaluate_parts

  ! Whether three values of a function differ by less than their distance from zero
  pure elemental logical function keeps_sign(event, middle)
    type(event_state_t), intent(in) :: event
    real(wp), intent(in) :: middle
    real(wp) :: high, low

    low = min(event%at_start, middle, event%at_end)
    high = max(event%at_start, middle, event%at_end)
    keeps_sign = event%sign_before == 0 .and. max(low, -high) > high - low
  end function keeps_sign

  ! The number of parts of the step, by the angle that it turns
  integer function count_parts(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: angle
    integer :: column

    angle = 0.0_wp
    do column = 0, x%result, x%result        ! both ends of the step
      x%v(:, 1) = merge(x%slope, x%end_slope, column == 0)
      ! coefficients of splitting methods are forces alone
      if (x%method%kind == splitting_kind) call add_free_motion(x%frame, x%y(:, column), x%v)
      x%v(:, 1) = x%h * x%v(:, 1)
      angle = max(angle, turning(x%frame, x%v(:, 1), fields=.false.))
    end do
    if (any(x%frame%blocks%kind == callback_block)) angle = min(angle, two_turns)
    count_parts = max(min_parts, ceiling(min(angle / part_angle, real(max_fixed_parts + 1, wp))))
  end function count_parts

  ! Finds the zeros of one event, given its values at the ends of parts.
  subroutine find_zeros_of_event(x, event, samples)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), contiguous, intent(in) :: samples(0:)        ! (0:parts)
    type(sample_t) :: extremum
    integer :: k, pair                                 ! pair: the last part with a pair of zeros
    logical :: exists

    pair = 0
    do k = 1, ubound(samples, 1)
      call add_zero(x, event, samples(k - 1), samples(k))
      if (x%status /= no_stop .or. k == ubound(samples, 1)) return
      call find_turning_point(x, event, samples(k - 1:k + 1), extremum, exists)
      if (x%status /= no_stop) return
      if (.not. exists .or. (extremum%theta < samples(k)%theta .and. pair == k)) cycle
      pair = merge(k, k + 1, extremum%theta < samples(k)%theta)
      call add_zero(x, event, samples(pair - 1), extremum)
      if (x%status == no_stop) call add_zero(x, event, extremum, samples(pair))
      if (x%status /= no_stop) return
    end do
  end subroutine find_zeros_of_event

  ! Finds a point between three of the same sign where the function is zero or has the other sign,
  ! by minima that are half as far from zero each time. In detection along the cubic, which isn't
  ! accurate, coming near to zero is enough.
  subroutine find_turning_point(x, event, samples, extremum, exists)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), intent(in) :: samples(3)
    type(sample_t), intent(out) :: extremum
    logical, intent(out) :: exists
    integer, parameter :: max_iterations = 8
    real(wp), parameter :: margin = 0.05_wp            ! relative to differences of values
    type(sample_t) :: three(3)                         ! with moduli of values
    real(wp) :: limit, near_zero, side
    logical :: detects
    integer :: i

    detects = .not. x%interpolant%complete
    side = sign(1.0_wp, samples(1)%value)
    limit = merge(samples(2)%theta, huge(limit), samples(3)%theta < 1)
    three = samples
    three%value = abs(samples%value)
    exists = .false.
    if (.not. minval(samples%value * side) > 0) return
    do i = 1, max_iterations
      near_zero = margin * (maxval(three%value) - minval(three%value))
      call choose_trial(three, near_zero, limit, detects, extremum, exists)
      if (.not. exists) return
      exists = detects .and. min(extremum%value, minval(three%value)) < near_zero
      if (exists) extremum%value = -samples(1)%value   ! any value of the other sign, without a call
      if (exists .or. detects .and. extremum%value > minval(three%value) / 2) return
      call evaluate_sample(x, event, extremum)
      if (x%status /= no_stop) return
      exists = extremum%value * side <= 0
      if (exists) return
      call narrow(three, sample_t(extremum%theta, abs(extremum%value)))
    end do
  end subroutine find_turning_point

  ! Adds the zero of an event between two points if there is one; in detection, any number there.
  subroutine add_zero(x, event, low, high)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), intent(in) :: low, high
    real(wp) :: zero

    if (.not. crosses(low%value, high%value, x%problem%events%table(event))) return
    zero = high%theta
    if (high%value /= 0 .and. x%interpolant%complete) call find_zero(x, event, low, high, zero)
    x%zeros = [x%zeros, zero_t(max(zero, tiny(zero)), event, merge(-1, 1, low%value < 0))]
  end subroutine add_zero

  ! Decides what follows after an event, whose function g is zero at the start of the step up to
  ! rounding. Either g leaves on the side that it came from, as where a ball bounces, and may return
  ! to zero within the first part of the step; or it passes to the other side; or a jump has left it
  ! at rest, as where a ball stays on the floor, through which the solution would fall. Where g is
  ! on the other side at the end of the first part or of the step, the power of time by which it
  ! grows tells: 1 where it passes, 2 at rest. A step that is too small for this leaves the decision
  ! to the next one.
  subroutine find_after_event(x, event, samples)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    type(sample_t), contiguous, intent(inout) :: samples(0:)     ! first ones, if rounding, become 0
    real(wp), parameter :: min_resting = 1.5_wp        ! power from which the solution is at rest
    type(sample_t), allocatable :: nearer(:)           ! samples ever nearer to the start
    real(wp) :: elapsed, power
    integer :: first, k, last                ! first to last: ends of parts on the other side

    associate (state => x%events(event), n => ubound(samples, 1), &
               side => real(x%events(event)%sign_before, wp))
      do k = 1, n
        if (abs(samples(k)%value) > rounding_at(x, event, samples(k)%theta, samples(n)%value)) exit
        samples(k)%value = 0.0_wp
      end do
      state%at_end = samples(n)%value
      first = merge(1, n, samples(1)%value * side < 0)
      if (.not. samples(first)%value * side < 0) then
        if (samples(n)%value /= 0) state%sign_before = 0
        return
      end if
      last = first - 1 + findloc([samples(first + 1:)%value * side < 0, .false.], .false., 1)
      nearer = samples(last:first:-1)
      nearer%rounding = rounding_at(x, event, nearer%theta, samples(n)%value)
      elapsed = abs((x%t - state%time) / x%h)
      call approach_event(x, event, elapsed, nearer)
      if (x%status /= no_stop) return
      if (nearer(size(nearer))%value * side > 0) then
        if (first == 1) call add_zero(x, event, nearer(size(nearer)), samples(1))
      else
        power = power_of_growth(elapsed, nearer, 1)
        if (power < 0) return
        if (power >= min_resting .and. x%problem%events%table(event)%jumps /= 0) then
          call fail(x, resting_contact, x%t, event)
          return
        end if
      end if
      state%sign_before = 0
    end associate
  end subroutine find_after_event

  ! Adds samples at points that halve the distance to the event at the start of the step, until the
  ! function is rounding or on the side that it came from.
  subroutine approach_event(x, event, elapsed, samples)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), intent(in) :: elapsed                    ! since the event, in steps
    type(sample_t), allocatable, intent(inout) :: samples(:)     ! later ones first
    integer, parameter :: halvings = 60
    real(wp), parameter :: max_passing = 1.05_wp       ! power of growth up to which it passes
    type(sample_t) :: point
    real(wp) :: first
    integer :: k

    first = samples(size(samples))%theta
    do k = 1, halvings
      point%theta = first * 0.5_wp**k
      ! times much shorter than the time since the event tell no more about its power
      if (point%theta < elapsed / 16 .or. power_of_growth(elapsed, samples, 3) < max_passing) exit
      call evaluate_sample(x, event, point)
      if (x%status /= no_stop) return
      point%rounding = rounding_at(x, event, point%theta, x%events(event)%at_end)
      if (abs(point%value) <= point%rounding) exit
      samples = [samples, point]
      if (point%value * real(x%events(event)%sign_before, wp) > 0) exit
    end do
  end subroutine approach_event

  ! The rounding of a function at a fraction of the step, relative to the point and to the function
  pure elemental real(wp) function rounding_at(x, event, theta, at_end)
    type(trajectory_t), intent(in) :: x
    integer, intent(in) :: event
    real(wp), intent(in) :: theta, at_end    ! fraction, and the function at the end
    real(wp) :: sizes(3)

    associate (n => x%problem%events%width)
      sizes = [maxval(abs(x%y(:n, 0))), theta * maxval(abs(x%y(:n, x%result))), theta * abs(at_end)]
      rounding_at = max(8 * abs(x%events(event)%residual), 32 * epsilon(1.0_wp) * maxval(sizes))
    end associate
  end function rounding_at

  ! Stores zeros in the order of their times, up to the first one that ends the step.
  subroutine store_zeros(x, output, theta_end, ended, after)
    type(trajectory_t), intent(inout) :: x
    type(output_t), intent(inout) :: output
    real(wp), intent(out) :: theta_end                 ! where the step ends, as a fraction of it
    logical, intent(out) :: ended                      ! whether an event ends the step there
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size) the point after all jumps
    logical :: together(size(x%zeros))
    real(wp) :: y(size(after))
    integer :: i, k

    theta_end = 1.0_wp
    ended = .false.
    associate (state => x%events, events => x%problem%events, zeros => x%zeros)
      do while (.not. all(zeros%stored))
        k = minloc(zeros%theta, 1, .not. zeros%stored)
        ended = any(.not. zeros%stored .and. zeros%theta <= zeros(k)%theta + same_time_tolerance &
                    .and. ends_step(state(zeros%event), events%table(zeros%event)))
        call point_at(x, zeros(k)%theta, y)
        together = .false.
        together(k) = .true.
        if (ended) then
          theta_end = zeros(k)%theta
          do i = 1, size(zeros)
            if (.not. zeros(i)%stored) state(zeros(i)%event)%residual = 0.0_wp
          end do
          call find_together(x, theta_end, together)
          if (x%status /= no_stop) return
        end if
        call store_together(x, zeros(k)%theta, y, together, output, after)
        if (ended) state(pack(zeros%event, together))%sign_before = &
          pack(zeros%sign_before, together)
        if (x%status /= no_stop .or. ended) return
        zeros(k)%stored = .true.
      end do
    end associate
  end subroutine store_zeros

  ! Finds the zeros at the same time, one of each event: those that are as near as zeros are
  ! accurate, or where rounding has changed the sign already.
  subroutine find_together(x, theta, together)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: theta                      ! fraction of the step, of the first zero
    logical, intent(inout) :: together(:)              ! (zeros)
    type(sample_t) :: sample
    integer :: k

    associate (zeros => x%zeros, t => time_at(x, theta))
      do k = 1, size(together)
        if (zeros(k)%stored .or. zeros(k)%theta > theta + decided_by_rounding) cycle
        if (any(together .and. zeros%event == zeros(k)%event)) cycle
        together(k) = zeros(k)%theta <= theta + same_time_tolerance
        if (together(k)) cycle
        sample%theta = theta
        call evaluate_sample(x, zeros(k)%event, sample)
        if (x%status /= no_stop) return
        together(k) = sample%value * real(zeros(k)%sign_before, wp) <= 0 &
                    .or. abs(time_at(x, zeros(k)%theta) - t) <= resolution(t)
        ! the zero, which is yet to come, isn't another event
        if (together(k)) x%events(zeros(k)%event)%residual = sample%value
      end do
    end associate
  end subroutine find_together

  ! Stores simultaneous events. Those without a jump come first, at the point before all
  ! jumps; then each jump starts from the point that the one before has left.
  subroutine store_together(x, theta, y, together, output, after)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: theta                      ! fraction of the step
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) the point there
    logical, intent(in) :: together(:)                 ! (zeros)
    type(output_t), intent(inout) :: output
    real(wp), contiguous, intent(out) :: after(:)      ! (point_size)
    logical :: jumps(size(together)), failed
    real(wp) :: before(size(y))
    integer :: k

    after = y
    associate (events => x%problem%events, zeros => x%zeros, t => time_at(x, theta), &
               those => pack(x%zeros%event, together)) ! one of each event
      x%events(those)%time = t
      jumps = together .and. events%table(zeros%event)%jumps /= 0 .and. (x%problem%record%goes_on &
              .or. x%events(zeros%event)%count + 1 < events%table(zeros%event)%limit)
      do k = 1, size(together)
        if (together(k) .and. .not. jumps(k)) &
          call store_event(output, x%member, zeros(k)%event, t, y, y)
      end do
      do k = 1, size(together)
        if (.not. jumps(k)) cycle
        before = after
        call events%jump(x%member, zeros(k)%event, t, before, after, failed)
        if (failed) then
          call fail(x, raised, x%t_end)
          return
        end if
        call store_event(output, x%member, zeros(k)%event, t, before, after)
      end do
      x%events(those)%count = x%events(those)%count + 1
    end associate
  end subroutine store_together

end module step_events_m
