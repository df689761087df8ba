! Step size control. With errors e, e_last of steps h, h_last, in tolerances, the next size is
!
!   0.9 h (e^-0.7 e_last^0.4)^exponent                                            (PI controller),
!   0.9 h (2 m + 1) / (2 m + n) e^-exponent min(1, h / h_last (e_last / e)^exponent)   (predictive),
!
! the predictive controller of Gustafsson after n of at most m Newton iterations of a collocation
! method, where few rejections matter more than smooth sizes: Hairer, Wanner, "Solving Ordinary
! Differential Equations II", 1996, sections IV.2 and IV.8. For the first size see volume I, II.4.
module controller_m
  use kinds, only: wp
  use shared_numbers, only: before_last_power, blind_fraction, failure_factor, first_error, &
                            guess_fraction, jump_factor, last_power, max_factor, min_factor, &
                            min_last_error, min_step, min_suspicion, negligible, safety
  implicit none
  private
  public :: rejected_size, resumed_size, accepted_size, first_guess, first_size, max_iterations, &
            suspected_error, min_last_predicted, predicted_size, resolution, tried_size

  ! Steps of collocation methods grow by `min_growth` or not at all, since factors serve one size.
  real(wp), parameter :: max_predicted = 10.0_wp, min_growth = 1.2_wp
  real(wp), parameter :: min_last_predicted = 1e-2_wp  ! least e_last
  integer, parameter :: max_iterations = 7             ! Newton iterations

contains

  ! The error of a step, raised where a discontinuity is suspected
  pure real(wp) function suspected_error(error, taken, t, suspicion)
    real(wp), intent(in) :: error, taken, t
    integer, intent(in) :: suspicion

    suspected_error = error
    if (suspicion > min_suspicion .and. taken > jump_factor * resolution(t)) &
      suspected_error = jump_factor * min(error, huge(error) / jump_factor)
  end function suspected_error

  ! The size of the next attempt after a rejected step; its error is huge if there is no estimate.
  pure real(wp) function rejected_size(taken, error, exponent)
    real(wp), intent(in) :: taken          ! size of the step
    real(wp), intent(in) :: error          ! in tolerances
    real(wp), intent(in) :: exponent       ! power of an error that a step size is proportional to

    rejected_size = failure_factor * taken
    if (error < huge(error)) rejected_size = max(min_factor, safety * error**(-exponent)) * taken
  end function rejected_size

  ! The size after a shortened step: the size proposed before it, as far as its error allows
  pure real(wp) function resumed_size(proposed, taken, error, exponent)
    real(wp), intent(in) :: proposed, taken, error, exponent

    resumed_size = proposed
    if (error > min_last_error) resumed_size = min(proposed, rejected_size(taken, error, exponent))
  end function resumed_size

  ! The size after an accepted step, by the PI controller
  pure subroutine accepted_size(taken, error, exponent, after_rejection, last_error, next)
    real(wp), intent(in) :: taken, error, exponent
    logical, intent(in) :: after_rejection
    real(wp), intent(inout) :: last_error  ! error of the accepted step before, then of this one
    real(wp), intent(out) :: next          ! size of the next step
    real(wp) :: factor

    factor = max_factor
    if (error > 0) then
      factor = error**(-last_power) * last_error**before_last_power
      factor = min(max_factor, max(min_factor, safety * factor**exponent))
    end if
    if (after_rejection) factor = min(factor, 1.0_wp)
    next = taken * factor
    last_error = max(error, min_last_error)
  end subroutine accepted_size

  ! The size of the step after an accepted or rejected one of a collocation method
  pure real(wp) function predicted_size(taken, error, exponent, iterations, keeps_factors, &
                                        last_taken, last_error)
    real(wp), intent(in) :: taken, error, exponent
    integer, intent(in) :: iterations      ! Newton iterations
    logical, intent(in) :: keeps_factors   ! whether factors can serve a next step of this size
    real(wp), intent(in) :: last_taken     ! zero if there was no step before
    real(wp), intent(in) :: last_error
    real(wp) :: factor

    factor = max_predicted
    if (.not. error < huge(error)) then
      factor = 0.5_wp
    else if (error > 0) then
      factor = error**(-exponent)
      if (last_taken > 0) factor = factor * min(1.0_wp, taken / last_taken &
                                                * (last_error / error)**exponent)
      factor = factor * safety * real(2 * max_iterations + 1, wp) &
               / real(2 * max_iterations + iterations, wp)
      factor = min(max_predicted, max(min_factor, factor))
    end if
    if (error <= 1 .and. factor < min_growth .and. keeps_factors) factor = 1.0_wp
    predicted_size = taken * factor
  end function predicted_size

  ! The size to try; negative if a rejection or max_step makes it less than min_size and to_end
  pure real(wp) function tried_size(proposed, min_size, to_end, max_step, after_rejection)
    real(wp), intent(in) :: proposed, min_size, to_end, max_step
    logical, intent(in) :: after_rejection

    tried_size = proposed
    if (.not. after_rejection) tried_size = max(proposed, min_size)
    tried_size = min(tried_size, max_step)
    if (tried_size < min(min_size, to_end)) tried_size = -1.0_wp
  end function tried_size

  ! A first guess, a fraction of the time |y| / |y'| in which the point changes by its size
  pure real(wp) function first_guess(point, slope, span)
    real(wp), intent(in) :: point, slope, span         ! norms in tolerances; span: of the segment

    first_guess = blind_fraction * span
    if (point > negligible .and. slope * span > negligible) &
      first_guess = guess_fraction * point / slope
  end function first_guess

  ! The first size, huge if none is too large. The rate r = max(|y''| / |y'|, |y'| / |y|) stands for
  ! derivatives beyond the second, |y'| r^p h^(p + 1) = first_error, in any unit of time.
  pure real(wp) function first_size(point, slope, curvature, exponent)
    real(wp), intent(in) :: point, slope, curvature    ! norms of y, y' and y'' in tolerances
    real(wp), intent(in) :: exponent                   ! 1 / (p + 1)
    real(wp) :: rate

    first_size = huge(first_size)
    if (slope > 0) then
      rate = curvature / slope
      if (point > 0) rate = max(rate, slope / point)
      if (rate > 0) first_size = (first_error * rate / slope)**exponent / rate
    else if (curvature > 0) then
      first_size = sqrt(first_error / curvature)
    end if
  end function first_size

  ! The smallest step size, above the rounding of t; `spacing` would be larger near zero.
  pure real(wp) function resolution(t)
    real(wp), intent(in) :: t

    resolution = min_step * (nearest(abs(t), 1.0_wp) - abs(t))
  end function resolution

end module controller_m
