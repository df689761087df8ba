! Signs, minima and growth of a function of the fraction of a step, found from samples of it
module zero_finding_m
  use kinds, only: wp
  use shared_numbers, only: event_record_t
  implicit none
  private
  public :: choose_trial, crosses, minimise_parabola, narrow, power_of_growth, sample_t

  ! The value of a function at a fraction of the step
  type :: sample_t
    real(wp) :: theta = 0.0_wp, value = 0.0_wp
    real(wp) :: rounding = 0.0_wp            ! rounding of the value, where it is needed
  end type sample_t

contains

  ! Whether a function changes sign in an interval. A zero at the start doesn't count: it belongs to
  ! the interval before, or is the initial point. A change by more than half a period is a wrap.
  pure elemental logical function crosses(before, after, row)
    real(wp), intent(in) :: before, after
    type(event_record_t), intent(in) :: row  ! the event's; the period is 0 without one

    crosses = (before < 0 .and. after >= 0 .and. row%direction >= 0) &
              .or. (before > 0 .and. after <= 0 .and. row%direction <= 0)
    if (row%period > 0) crosses = crosses .and. abs(after - before) < row%period / 2
  end function crosses

  ! Chooses where a dip of a positive function is sought next: at the minimum of the parabola
  ! through three samples, if it is half as far from zero as they are. Parabolas through far values
  ! miss narrow dips: where no later samples see it, a minimum near to zero is tried too. Beyond an
  ! end near to zero it is the middle of the part before the end.
  pure subroutine choose_trial(three, near_zero, limit, detects, trial, exists)
    type(sample_t), intent(in) :: three(3)
    real(wp), intent(in) :: near_zero        ! values below it are
    real(wp), intent(in) :: limit            ! later samples see dips from this fraction on
    logical, intent(in) :: detects           ! whether any minimum between the samples is enough
    type(sample_t), intent(out) :: trial     ! the value is the minimum of the parabola
    logical, intent(out) :: exists           ! whether there is a fraction to try
    logical :: lies_within
    integer :: edge

    call minimise_parabola(three, trial, exists)
    if (.not. exists) return
    lies_within = trial%theta > three(1)%theta .and. trial%theta < three(3)%theta
    if (lies_within .and. (detects .or. trial%value <= minval(three%value) / 2)) return
    exists = .not. trial%theta > limit
    if (.not. exists .or. (lies_within .and. .not. trial%value > near_zero)) return
    edge = merge(3, 1, trial%theta > three(2)%theta)
    exists = three(edge)%value <= near_zero .and. &
      abs(trial%theta - three(edge)%theta) <= abs(three(2)%theta - three(edge)%theta) / 4
    trial%theta = (three(2)%theta + three(edge)%theta) / 2
  end subroutine choose_trial

  ! Finds the minimum of the parabola through three samples, if there is one.
  pure subroutine minimise_parabola(three, minimum, exists)
    type(sample_t), intent(in) :: three(3)
    type(sample_t), intent(out) :: minimum
    logical, intent(out) :: exists
    real(wp) :: first, second                          ! divided differences

    associate (theta => three%theta, v => three%value)
      first = (v(2) - v(1)) / (theta(2) - theta(1))
      second = ((v(3) - v(2)) / (theta(3) - theta(2)) - first) / (theta(3) - theta(1))
      exists = second > 0
      if (.not. exists) return
      minimum%theta = (theta(1) + theta(2) - first / second) / 2
      minimum%value = v(1) + (minimum%theta - theta(1)) &
                             * (first + second * (minimum%theta - theta(2)))
    end associate
  end subroutine minimise_parabola

  ! Puts a sample between three, and leaves out the end farther from the smaller inner value.
  pure subroutine narrow(three, new)
    type(sample_t), intent(inout) :: three(3)
    type(sample_t), intent(in) :: new
    type(sample_t) :: inner(2)

    inner = [three(2), new]
    if (new%theta < three(2)%theta) inner = inner(2:1:-1)
    if (inner(1)%value < inner(2)%value) then
      three(2:) = inner
    else
      three(:2) = inner
    end if
  end subroutine narrow

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

end module zero_finding_m
