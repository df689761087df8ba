! Sizes of steps by controller_m, compared with its formulas in numbers that are exact or worked out
! by hand. With the exponent 1/2 and powers of two all of them are easy.
program step_checks
  use kinds, only: wp
  use controller_m, only: accepted_size, first_guess, first_size, predicted_size, rejected_size, &
                          resolution, resumed_size, suspected_error, tried_size
  implicit none
  real(wp), parameter :: half = 0.5_wp
  logical :: passed = .true.

  call check('a rejected step', rejected_size(2.0_wp, 4.0_wp, half), 0.9_wp)
  call check('its least factor', rejected_size(2.0_wp, 1e8_wp, half), 0.4_wp)
  call check('a step without an estimate', rejected_size(2.0_wp, huge(half), half), 0.5_wp)
  call check('a shortened step with a small error', resumed_size(3.0_wp, 0.1_wp, 1e-5_wp, half), &
             3.0_wp)
  call check('with a larger one', resumed_size(3.0_wp, 1.0_wp, 0.25_wp, half), 1.8_wp)

  ! 0.9 e^-0.35 e_last^0.2 with e = e_last = 2^-20 is 0.9 * 2^3
  call check_accepted('an accepted step', 2.0_wp**(-20), 2.0_wp**(-20), .false., 5.0_wp, 1e-4_wp)
  call check_accepted('equal errors', 2.0_wp**(-10), 2.0_wp**(-10), .false., 0.9_wp * 2**1.5_wp, &
                      2.0_wp**(-10))
  call check_accepted('after a small error', 1.0_wp, 2.0_wp**(-10), .false., 0.225_wp, 1.0_wp)
  call check_accepted('after a rejection', 2.0_wp**(-10), 1.0_wp, .true., 1.0_wp, 2.0_wp**(-10))
  call check_accepted('without an error', 0.0_wp, 1.0_wp, .false., 5.0_wp, 1e-4_wp)

  ! 0.9 * 15 / (14 + n) e^-1/2, times h / h_last (e_last / e)^1/2 if that is less than one
  call check('the first step by Newton''s method', &
             predicted_size(2.0_wp, 0.25_wp, half, 1, .false., 0.0_wp, 1.0_wp), 3.6_wp)
  call check('with the step before', &
             predicted_size(2.0_wp, 0.25_wp, half, 1, .false., 4.0_wp, 0.25_wp), 1.8_wp)
  call check('a step that keeps its factors', &
             predicted_size(2.0_wp, 0.64_wp, half, 1, .true., 0.0_wp, 1.0_wp), 2.0_wp)
  call check('one that can''t', &
             predicted_size(2.0_wp, 0.64_wp, half, 1, .false., 0.0_wp, 1.0_wp), 2.25_wp)
  call check('a step that failed', &
             predicted_size(2.0_wp, huge(half), half, 7, .true., 0.0_wp, 1.0_wp), 1.0_wp)

  call check('a step below the least', &
             tried_size(1e-3_wp, 1e-2_wp, 1.0_wp, 5.0_wp, .false.), 1e-2_wp)
  call check('after a rejection', tried_size(1e-3_wp, 1e-2_wp, 1.0_wp, 5.0_wp, .true.), -1.0_wp)
  call check('a longest step', tried_size(2.0_wp, 1e-2_wp, 1.0_wp, 0.5_wp, .false.), 0.5_wp)

  call check('a first guess', first_guess(8.0_wp, 2.0_wp, 100.0_wp), 0.04_wp)
  call check('at the origin', first_guess(0.0_wp, 2.0_wp, 100.0_wp), 1e-4_wp)
  ! r = 4, (0.01 r / |y'|)^1/2 / r
  call check('a first size', first_size(1.0_wp, 4.0_wp, 8.0_wp, half), 0.025_wp)
  call check('without a slope', first_size(1.0_wp, 0.0_wp, 4.0_wp, half), 0.05_wp)
  call check('at rest', first_size(1.0_wp, 0.0_wp, 0.0_wp, half), huge(half))

  call check('the resolution of time', resolution(-1.0_wp), 10 * epsilon(half))
  call check('an error without suspicion', suspected_error(0.5_wp, 1.0_wp, 1.0_wp, 4), 0.5_wp)
  call check('an error with it', suspected_error(0.5_wp, 1.0_wp, 1.0_wp, 5), 10.0_wp)
  call check('a step that can''t be shorter', &
             suspected_error(0.5_wp, epsilon(half), 1.0_wp, 5), 0.5_wp)
  if (.not. passed) error stop 1
  print '(a)', 'step_checks: passed'

contains

  subroutine check(what, value, expected)
    character(*), intent(in) :: what
    real(wp), intent(in) :: value, expected

    if (abs(value - expected) <= 8 * epsilon(value) * abs(expected)) return
    passed = .false.
    print '(a, 2(1x, g0))', what, value, expected
  end subroutine check

  subroutine check_accepted(what, error, last_error, after_rejection, factor, kept)
    character(*), intent(in) :: what
    real(wp), intent(in) :: error, last_error, factor, kept
    logical, intent(in) :: after_rejection
    real(wp) :: last, next

    last = last_error
    call accepted_size(2.0_wp, error, half, after_rejection, last, next)
    call check(what, next, 2 * factor)
    call check(what, last, kept)
  end subroutine check_accepted

end program step_checks
