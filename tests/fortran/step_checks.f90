! Checks pure procedures of the loop over steps under run-time checks and floating-point traps: the
! step size control, limits of steps, and the numerics of event location. Expected values follow
! from the definitions, with numbers whose powers are exact. All numbers are real(8).
program step_checks
  use kinds, only: wp
  use controller_m, only: accepted_size, first_guess, first_size, predicted_size, rejected_size, &
                          resolution, resumed_size, suspected_error, tried_size
  use inputs_m, only: max_step_at
  use zero_finding_m, only: choose_trial, minimise_parabola, narrow, power_of_growth, sample_t
  implicit none
  real(wp), parameter :: quarter = 0.25d0, e = 0.0625d0, none = huge(none)

  call check_controller()
  call check_limits()
  call check_minima()
  call check_growth()
  print '(a)', 'step_checks: passed'

contains

  subroutine check(values, expected, what)
    real(wp), intent(in) :: values(:), expected(:)
    character(*), intent(in) :: what

    if (all(abs(values - expected) <= 8 * epsilon(values) * abs(expected))) return
    print '(a, *(es25.16))', what, values, expected
    error stop 1
  end subroutine check

  ! The factor is 0.9 (e^-0.7 e_last^0.4)^exponent, and 0.9 e^-exponent after rejections.
  subroutine check_controller()
    real(wp) :: last(4), next(4)

    call check([rejected_size(2d0, 16d0, quarter), rejected_size(2d0, 1d8, quarter), &
                rejected_size(2d0, none, quarter)], [0.9d0, 0.4d0, 0.5d0], &
               'rejected: by 16^(1/4), by 5 at most, by 4 without an estimate')
    last = [quarter, quarter, quarter, 1d-4]
    call accepted_size(2d0, e, 0.5d0, .false., last(1), next(1))
    call accepted_size(2d0, e, 0.5d0, .true., last(2), next(2))
    call accepted_size(2d0, 0d0, 0.5d0, .false., last(3), next(3))
    call accepted_size(2d0, 1d0, 1d0, .false., last(4), next(4))
    call check([next, last], [3.6d0, 2d0, 10d0, 0.4d0, e, e, 1d-4, 1d0], 'accepted: by ' // &
               '(2^2.8 2^-0.8)^0.5, after a rejection, by 5 at most, by 1/5 at least; errors kept')
    call check([resumed_size(10d0, 1d0, 1d-5, quarter), resumed_size(10d0, 1d0, e, quarter), &
                resumed_size(1.5d0, 1d0, e, quarter)], [10d0, 1.8d0, 1.5d0], &
               'shortened: as before, as its error allows, as before')
    call check([suspected_error(0.5d0, 1d0, 1d0, 4), suspected_error(0.5d0, 1d0, 1d0, 5), &
                suspected_error(0.5d0, 200 * epsilon(e), 1d0, 5), &
                suspected_error(none, 1d0, 1d0, 5)], [0.5d0, 10d0, 0.5d0, none], &
               'suspicion: too little, enough, of a tiny step, of the largest error')
    call check([predicted_size(2d0, e, quarter, 1, .false., 0d0, e), &
                predicted_size(2d0, e, quarter, 7, .false., 0d0, e), &
                predicted_size(2d0, e, quarter, 1, .false., 4d0, e**2), &
                predicted_size(2d0, e, quarter, 1, .true., 4d0, e), &
                predicted_size(2d0, 16d0, quarter, 1, .true., 0d0, e), &
                predicted_size(2d0, 0d0, quarter, 1, .false., 0d0, e), &
                predicted_size(2d0, none, quarter, 1, .false., 0d0, e)], &
               [3.6d0, 18d0 / 7, 0.9d0, 2d0, 0.9d0, 20d0, 1d0], &
               'predicted: by 2, 2 * 15 / 21, 2 * 2 / 4 / 2, kept, rejected, at most, unknown')
    call check([tried_size(1d0, 2d0, 9d0, 5d0, .false.), tried_size(8d0, 2d0, 9d0, 5d0, .false.), &
                tried_size(1d0, 2d0, 9d0, 5d0, .true.), tried_size(1d0, 2d0, 0.5d0, 5d0, .true.)], &
               [2d0, 5d0, -1d0, 1d0], 'tried: least, largest, too small, near the end')
    ! |y'| r^p h^(p + 1) = 0.01 with the rate r = max(|y''| / |y'|, |y'| / |y|), for p = 1
    call check([first_size(0d0, 4d0, 16d0, 0.5d0), first_size(0.5d0, 4d0, 16d0, 0.5d0), &
                first_size(0d0, 0d0, 4d0, 0.5d0), first_size(1d0, 0d0, 0d0, 0.5d0), &
                first_guess(2d0, 4d0, 10d0), first_guess(1d-6, 4d0, 10d0)], &
               [0.025d0, sqrt(0.01d0 / 32), 0.05d0, none, 0.005d0, 1d-5], &
               'first sizes: 16, 32, 4, 0 h^2 = 0.01, a part of |y| / |slope|, of the span')
  end subroutine check_controller

  subroutine check_limits()
    real(wp), parameter :: limits(2, 3) = reshape([0d0, 0.1d0, 1d0, 1d0, 2d0, 0.2d0], [2, 3])

    call check([max_step_at(limits, 1d0, 1d0), max_step_at(limits, 1.5d0, 1d0), &
                max_step_at(limits, 1.875d0, 1d0), max_step_at(limits, 1.0625d0, -1d0), &
                max_step_at(limits, 2d0, -1d0), max_step_at(limits(:, :0), 1d0, 1d0)], &
               [1d0, 0.5d0, 0.2d0, 0.1d0, 1d0, none], &
               'limits: from 1, up to 2, beyond 2, before 1, before 2, none')
    call check([resolution(-1d0)], [10 * epsilon(e)], 'ten spacings of numbers')
  end subroutine check_limits

  ! Parabolas with a minimum at 0.3 and elsewhere
  subroutine check_minima()
    type(sample_t) :: low(3), high(3), minimum, trial(5)
    logical :: exists(5), by_one

    call minimise_parabola(parabola(0.3d0, 2d0), minimum, by_one)
    low = parabola(0.3d0, 0d0)
    high = parabola(0.7d0, 0d0)
    call narrow(low, sample_t(0.375d0, 0.075d0**2))
    call narrow(high, sample_t(0.625d0, 0.075d0**2))
    call check([minimum%theta, minimum%value, low%theta, high%theta], &
               [0.3d0, 2d0, 0d0, 0.375d0, 0.5d0, 0.5d0, 0.625d0, 1d0], &
               'the minimum, from 0 to 0.5, from 0.5 to 1')
    call choose_trial(parabola(0.3d0, 0.01d0), 1d-3, none, .false., trial(1), exists(1))
    call choose_trial(parabola(0.3d0, 1d0), 1d-3, none, .false., trial(2), exists(2))
    call choose_trial(parabola(0.3d0, 1d0), 1d-3, none, .true., trial(3), exists(3))
    call choose_trial(parabola(-0.05d0, 0d0), 0.05d0, none, .true., trial(4), exists(4))
    call choose_trial(parabola(1.05d0, 0d0), 0.05d0, 0.5d0, .true., trial(5), exists(5))
    call check(merge(trial%theta, none, exists), [0.3d0, none, 0.3d0, 0.25d0, none], &
               'trials: half as far, hardly nearer, in detection, beside an end, later samples')
  end subroutine check_minima

  pure function parabola(vertex, minimum) result(three)
    real(wp), intent(in) :: vertex, minimum
    type(sample_t) :: three(3)
    integer :: k

    three = [(sample_t(real(k, wp) / 2, minimum + (real(k, wp) / 2 - vertex)**2), k=0, 2)]
  end function parabola

  ! Samples at theta = 1, 1/2, 1/4, 1/8
  subroutine check_growth()
    type(sample_t) :: smooth(4), rough(4), rounded(4)
    integer :: k

    smooth = [(sample_t(0.5d0**k, (1 + 0.5d0**k)**1.5d0), k=0, 3)]
    rough = [(sample_t(0.5d0**k, 0.5d0**merge(3, 2 * k, k == 2)), k=0, 3)]
    rounded = rough
    rounded(4)%rounding = 4 * rounded(4)%value * log(3d0)
    call check([power_of_growth(1d0, smooth, 3), power_of_growth(1d0, smooth(:3), 3), &
                power_of_growth(1d0, smooth(:1), 1), power_of_growth(0d0, rough, 1), &
                power_of_growth(0d0, rough, 3), power_of_growth(0d0, rounded, 1)], &
               [1.5d0, none, -1d0, 3d0, 3d0, 2d0], &
               'powers: since the event, too few, unknown, one, the largest, beyond rounding')
  end subroutine check_growth
end program step_checks
