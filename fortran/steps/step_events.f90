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
  implicit none
  private
  public :: crosses, ends_step, find_zeros, store_zeros

  real(wp), parameter :: tolerance = 4 * epsilon(1.0_wp)
  ! Bisection takes 53 iterations, far more towards zero; interpolations are at most as many.
  integer, parameter :: max_root_iterations = 3600

  ! Parts of a step. Frames known to rotate turn by at most `part_angle` in one. Adaptive steps that
  ! need more than `max_adaptive_parts`, or common ones without an end that rotate by more than a
  ! turn, are tried again with a smaller size; equal ones fail above `max_fixed_parts`.
  integer, parameter :: min_parts = 4, max_adaptive_parts = 10000, max_fixed_parts = 10**8
  real(wp), parameter :: part_angle = 2 * acos(-1.0_wp) / parts_of_turn
  ! Frames in Python give only a bound of the angle; larger ones count as two turns.
  real(wp), parameter :: two_turns = 4 * acos(-1.0_wp)

  ! Events are simultaneous if their zeros differ by at most the first of these fractions of a step,
  ! the accuracy of zeros; or by the second, where rounding has changed the sign before the zero.
  real(wp), parameter :: same_time_tolerance = 32 * epsilon(1.0_wp)
  real(wp), parameter :: decided_by_rounding = sqrt(epsilon(1.0_wp))

  ! The value of an event's function at a fraction of the step
  type :: sample_t
    real(wp) :: theta = 0.0_wp, value = 0.0_wp
    real(wp) :: rounding = 0.0_wp            ! rounding of the value, where it is needed
  end type sample_t

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
      min_part = tolerance * (abs(zero) + 1) / abs(b%theta - a%theta) / 2
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

  ! Whether a function changes sign in an interval. A zero at the start doesn't count: it belongs to
  ! the interval before, or is the initial point. A change by more than half a period is a wrap.
  pure elemental logical function crosses(before, after, row)
    real(wp), intent(in) :: before, after
    type(event_record_t), intent(in) :: row  ! the event's; the period is 0 without one

    crosses = (before < 0 .and. after >= 0 .and. row%direction >= 0) &
              .or. (before > 0 .and. after <= 0 .and. row%direction <= 0)
    if (row%period > 0) crosses = crosses .and. abs(after - before) < row%period / 2
  end function crosses

  ! Whether an event ends the step, by a jump or since it is the last one
  pure elemental logical function ends_step(event, row)
    type(event_state_t), intent(in) :: event
    type(event_record_t), intent(in) :: row  ! the event's

    ends_step = row%jumps /= 0 .or. event%count + 1 >= row%limit
  end function ends_step

  ! Finds the zeros of all events in a step, unless it is too long or a function fails. While values
  ! are requested, nothing changes. Before the interpolant is complete, times aren't computed.
  subroutine find_zeros(x)
    type(trajectory_t), intent(inout) :: x   ! x%zeros are set
    type(event_state_t), allocatable :: events(:)

    if (x%problem%events%vectorized) events = x%events
    call try_to_find_zeros(x)
    if (x%status == needs_events .and. allocated(events)) then
      x%events(:) = events
      if (allocated(x%zeros)) deallocate (x%zeros)
    end if
  end subroutine find_zeros

  ! Finds the zeros of all events in a step, as far as values are known. Those at the ends of parts
  ! are requested together, then for each event those that its zeros need.
  subroutine try_to_find_zeros(x)
    type(trajectory_t), intent(inout) :: x
    logical :: waits
    real(wp) :: middle(size(x%events))                 ! values in the middle
    real(wp), allocatable :: theta(:), values(:, :)    ! (0:parts), (0:parts, events)
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
    x%zeros = [zero_t ::]
    if (n == min_parts) then
      call evaluate_events(x, 0, 0.5_wp, middle)
      if (x%status /= no_stop) return
      if (all(keeps_sign(x%events, middle))) return
    end if
    allocate (theta(0:n), values(0:n, size(x%events)), stat=alloc_status)
    if (alloc_status /= 0) then
      call fail(x, out_of_memory, x%t)
      return
    end if
    call evaluate_parts(x, middle, theta, values)
    if (x%status /= no_stop) return
    waits = .false.
    do i = 1, size(values, 2)
      if (x%events(i)%sign_before /= 0) call find_after_event(x, i, theta, values(:, i))
      if (x%status == no_stop) call find_zeros_of_event(x, i, theta, values(:, i))
      if (x%status == needs_events) then     ! the other events request their values, too
        waits = .true.
        x%status = no_stop
      else if (x%status /= no_stop) then
        return
      end if
    end do
    if (waits) x%status = needs_events
  end subroutine try_to_find_zeros

  ! Evaluates the functions of all events at the ends of parts: every second one, then the others.
  subroutine evaluate_parts(x, middle, theta, values)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: middle(:)                  ! (events) values in the middle, if known
    real(wp), intent(out) :: theta(0:)                 ! (0:parts)
    real(wp), intent(inout) :: values(0:, :)           ! (0:parts, events)
    integer :: begin, k, n

    n = ubound(theta, 1)
    theta = [(real(k, wp) / real(n, wp), k=0, n)]
    values(0, :) = x%events%at_start
    values(n, :) = x%events%at_end
    if (n == min_parts) values(2, :) = middle
    do begin = merge(1, 2, n == min_parts), 1, -1      ! with four parts the even ones are known
      do k = begin, n - 1, 2
        call evaluate_events(x, 0, theta(k), values(k, :))
        if (all(x%status /= [no_stop, needs_events])) return
      end do
      if (x%status == needs_events) return
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
  subroutine find_zeros_of_event(x, event, theta, values)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), contiguous, intent(in) :: theta(0:), values(0:)    ! (0:parts)
    type(sample_t) :: extremum
    integer :: k, pair                                 ! pair: the last part with a pair of zeros
    logical :: exists

    pair = 0
    do k = 1, ubound(theta, 1)
      call add_zero(x, event, sample_t(theta(k - 1), values(k - 1)), sample_t(theta(k), values(k)))
      if (x%status /= no_stop .or. k == ubound(theta, 1)) return
      call find_turning_point(x, event, theta(k - 1:k + 1), values(k - 1:k + 1), extremum, exists)
      if (x%status /= no_stop) return
      if (.not. exists .or. (extremum%theta < theta(k) .and. pair == k)) cycle
      pair = merge(k, k + 1, extremum%theta < theta(k))
      call add_zero(x, event, sample_t(theta(pair - 1), values(pair - 1)), extremum)
      if (x%status == no_stop) &
        call add_zero(x, event, extremum, sample_t(theta(pair), values(pair)))
      if (x%status /= no_stop) return
    end do
  end subroutine find_zeros_of_event

  ! Finds a point between three of the same sign where the function is zero or has the other sign,
  ! by parabolas whose minima are half as far from zero each time. Parabolas through far values miss
  ! narrow dips: where no later three values see it, a minimum near to zero is tried too or, beyond
  ! an end near to zero, the middle of the part before it. In detection along the cubic, which isn't
  ! accurate, coming near to zero is enough.
  subroutine find_turning_point(x, event, ends, values, extremum, exists)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), intent(in) :: ends(3), values(3)
    type(sample_t), intent(out) :: extremum
    logical, intent(out) :: exists
    integer, parameter :: max_iterations = 8
    real(wp), parameter :: margin = 0.05_wp            ! relative to differences of values
    real(wp) :: theta(3), v(3), near_zero, minimum     ! minimum: the parabola's
    integer :: edge, i
    logical :: bends, detects, lies_within

    detects = .not. x%interpolant%complete
    theta = ends
    v = abs(values)
    exists = .false.
    if (.not. minval(values * sign(1.0_wp, values(1))) > 0) return
    do i = 1, max_iterations
      call minimise_parabola(theta, v, extremum%theta, minimum, bends)
      if (.not. bends) return
      associate (vertex => extremum%theta)
        near_zero = margin * (maxval(v) - minval(v))
        lies_within = vertex > theta(1) .and. vertex < theta(3)
        if (.not. (lies_within .and. (detects .or. minimum <= minval(v) / 2))) then
          if (vertex > ends(2) .and. ends(3) < 1) return       ! the next three values are nearer
          edge = merge(3, 1, vertex > theta(2))
          if (.not. lies_within .or. minimum > near_zero) then
            if (v(edge) > near_zero &
                .or. abs(vertex - theta(edge)) > abs(theta(2) - theta(edge)) / 4) return
            vertex = (theta(2) + theta(edge)) / 2
          end if
        end if
        ! in detection the sign alone counts: any value of the other sign, without a call
        exists = detects .and. min(minimum, minval(v)) < near_zero
        extremum%value = -values(1)
        if (exists .or. detects .and. minimum > minval(v) / 2) return
        call evaluate_sample(x, event, extremum)
        if (x%status /= no_stop) return
        exists = extremum%value * sign(1.0_wp, values(1)) <= 0
        if (exists) return
        call narrow(theta, v, vertex, abs(extremum%value))
      end associate
    end do
  end subroutine find_turning_point

  ! Finds the minimum of the parabola through three points.
  pure subroutine minimise_parabola(theta, v, vertex, minimum, bends)
    real(wp), intent(in) :: theta(3), v(3)
    real(wp), intent(out) :: vertex, minimum           ! where the minimum is, and the value there
    logical, intent(out) :: bends                      ! whether there is one
    real(wp) :: first, second                          ! divided differences

    first = (v(2) - v(1)) / (theta(2) - theta(1))
    second = ((v(3) - v(2)) / (theta(3) - theta(2)) - first) / (theta(3) - theta(1))
    bends = second > 0
    vertex = 0.0_wp
    minimum = 0.0_wp
    if (.not. bends) return
    vertex = (theta(1) + theta(2) - first / second) / 2
    minimum = v(1) + (vertex - theta(1)) * (first + second * (vertex - theta(2)))
  end subroutine minimise_parabola

  ! Puts a point between three and leaves out the end that is farther from the smaller inner value.
  pure subroutine narrow(theta, v, new_theta, value)
    real(wp), intent(inout) :: theta(3), v(3)
    real(wp), intent(in) :: new_theta, value
    type(sample_t) :: inner(2)

    inner = [sample_t(theta(2), v(2)), sample_t(new_theta, value)]
    if (new_theta < theta(2)) inner = inner(2:1:-1)
    if (inner(1)%value < inner(2)%value) then
      theta(2:) = inner%theta
      v(2:) = inner%value
    else
      theta(:2) = inner%theta
      v(:2) = inner%value
    end if
  end subroutine narrow

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
  ! rounding: g leaves on the side that it came from, as where a ball bounces, and may return to
  ! zero within the first part of the step; or g passes to the other side; or a jump has left g at
  ! rest, as where a ball stays on the floor, through which the solution would fall. Where g is on
  ! the other side at the end of the first part or of the step, it is evaluated at points that halve
  ! the distance to the start. The values nearest to the start that are larger than rounding show
  ! the power of time by which g grows: 1 where it passes, 2 at rest. A step that is too small for
  ! this leaves the decision to the next one.
  subroutine find_after_event(x, event, theta, values)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: event
    real(wp), contiguous, intent(in) :: theta(0:)
    real(wp), contiguous, intent(inout) :: values(0:)  ! the first ones, if rounding, become zero
    integer, parameter :: halvings = 60
    ! Up to the first power the search ends early; from the second on the solution is at rest.
    real(wp), parameter :: max_passing = 1.05_wp, min_resting = 1.5_wp
    type(sample_t), allocatable :: samples(:)          ! at points ever nearer to the start
    type(sample_t) :: point
    real(wp) :: elapsed, power
    integer :: first, k, last                ! first to last: ends of parts on the other side

    associate (state => x%events(event), n => ubound(theta, 1), &
               side => real(x%events(event)%sign_before, wp))
      do k = 1, n
        if (abs(values(k)) > rounding_at(x, event, theta(k), values(n))) exit
        values(k) = 0.0_wp
      end do
      state%at_end = values(n)
      first = merge(1, n, values(1) * side < 0)
      if (.not. values(first) * side < 0) then
        if (values(n) /= 0) state%sign_before = 0
        return
      end if
      last = first - 1 + findloc([values(first + 1:) * side < 0, .false.], .false., 1)
      samples = [(sample_t(theta(k), values(k), rounding_at(x, event, theta(k), values(n))), &
               k=last, first, -1)]
      elapsed = abs((x%t - state%time) / x%h)
      do k = 1, halvings
        point%theta = theta(first) * 0.5_wp**k
        ! times much shorter than the time since the event tell no more about its power
        if (point%theta < elapsed / 16 .or. power_of_growth(elapsed, samples, 3) < max_passing) exit
        call evaluate_sample(x, event, point)
        if (x%status /= no_stop) return
        point%rounding = rounding_at(x, event, point%theta, values(n))
        if (abs(point%value) <= point%rounding) exit
        if (point%value * side > 0) then
          if (first == 1) call add_zero(x, event, point, sample_t(theta(1), values(1)))
          state%sign_before = 0
          return
        end if
        samples = [samples, point]
      end do
      power = power_of_growth(elapsed, samples, 1)
      if (power < 0) return
      if (power < min_resting .or. x%problem%events%table(event)%jumps == 0) then
        state%sign_before = 0
        return
      end if
    end associate
    call fail(x, resting_contact, x%t, event)
  end subroutine find_after_event

  ! The largest of some powers of time by which a function grows, each from a sample and one so much
  ! later that rounding hardly matters; of too few samples huge, or negative if one power is needed
  pure real(wp) function power_of_growth(elapsed, samples, powers)
    real(wp), intent(in) :: elapsed          ! since the event at the start of the step, in steps
    type(sample_t), intent(in) :: samples(:)           ! later ones first
    integer, intent(in) :: powers                      ! their number
    real(wp) :: times(size(samples)), ratio
    integer :: j, k

    times = elapsed + samples%theta
    power_of_growth = -1.0_wp
    do k = size(times), size(times) - powers + 1, -1
      ! later by this ratio, rounding changes the power by 4 at most, and usually by much less
      ratio = exp(samples(k)%rounding / abs(4 * samples(k)%value))
      j = findloc(times(:k - 1) > ratio * times(k), .true., 1, back=.true.)
      if (j == 0) then
        power_of_growth = merge(power_of_growth, huge(power_of_growth), powers == 1)
        return
      end if
      power_of_growth = max(power_of_growth, log(samples(j)%value / samples(k)%value) &
                                             / log(times(j) / times(k)))
    end do
  end function power_of_growth

  ! The rounding of a function at a fraction of the step, relative to the point and to the function
  pure real(wp) function rounding_at(x, event, theta, at_end)
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
    integer :: k

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
          x%events(pack(zeros%event, .not. zeros%stored))%residual = 0.0_wp
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
