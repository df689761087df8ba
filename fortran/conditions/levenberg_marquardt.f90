! MINPACK's lmdif: minimises |f(x)| by steps p within an elliptic trust region |D p| <= delta, that
! minimise |J p + f|**2 + par |D p|**2, with J by forward differences. delta follows how well the
! linear model foretells |f|: J. J. More, The Levenberg-Marquardt algorithm, LNM 630 (1978).
!
! The paper's searches ran with it; in real(8) its steps repeat MINPACK's bit for bit.
module levenberg_marquardt_m
  use kinds, only: wp
  use linalg_m, only: enorm, least_squares_t, lmpar, qrfac, reflect, stop_requested
  use shared_numbers, only: ftol_too_small, gtol_too_small, improper_input, small_gradient, &
                            small_reduction, small_reduction_and_step, small_step, &
                            stopped_by_user, too_many_evaluations, xtol_too_small
  implicit none
  private
  public :: lmdif, lmdif_t

  real(wp), parameter :: eps = epsilon(1.0_wp)
  integer, parameter :: no_reason_yet = improper_input           ! MINPACK's info at first

  ! The settings and the results of one solve, under MINPACK's names
  type :: lmdif_t
    real(wp) :: ftol = 0.0_wp, xtol = 0.0_wp, gtol = 0.0_wp    ! >= 0
    integer :: maxfev = 0                    ! > 0: largest number of evaluations
    real(wp) :: epsfcn = 0.0_wp              ! relative error of f, at least epsilon is taken
    real(wp) :: factor = 100.0_wp            ! > 0: the first delta is factor * |D x|
    ! (n): D, positive; if it isn't given, it comes from the columns of J
    real(wp), allocatable :: diag(:)
    integer :: info = no_reason_yet          ! an LmdifStatus, or a negative outcome of the problem
    integer :: nfev = 0                      ! evaluations, including the ones for differences
    real(wp), allocatable :: fjac(:, :)      ! (m, n): R and the reflections of the last Jacobian
    integer, allocatable :: ipvt(:)          ! (n): its pivots
    real(wp), allocatable :: qtf(:)          ! (n): first n elements of Q^T f
  end type lmdif_t

contains

  ! Minimises |f(x)|. There are at least as many residuals as unknowns.
  subroutine lmdif(problem, x, fvec, solver)
    class(least_squares_t), intent(inout) :: problem
    real(wp), intent(inout) :: x(:)                   ! (n): start in, last accepted point out
    real(wp), intent(out) :: fvec(:)                  ! (m): f(x)
    type(lmdif_t), intent(inout) :: solver
    real(wp) :: step(size(x)), trial(size(x)), acnorm(size(x)), work(size(x))
    real(wp) :: fnorm, fnorm_trial, gnorm, xnorm, pnorm, delta, par, actual, predicted, slope, ratio
    real(wp), allocatable :: ftrial(:)  ! (m)
    integer :: iteration
    logical :: given                    ! whether D is given

    fvec = 0
    allocate (ftrial(size(fvec)), solver%fjac(size(fvec), size(x)), solver%qtf(size(x)), &
              source=0.0_wp)
    allocate (solver%ipvt(size(x)), source=0)
    given = allocated(solver%diag)
    call problem%residual(x, fvec, solver%info)
    solver%nfev = 1
    if (solver%info < 0) return
    fnorm = enorm(fvec)
    par = 0
    iteration = 1
    outer: do
      call linearise(problem, x, fvec, solver, ftrial, acnorm)
      if (solver%info < 0) return
      if (iteration == 1) then
        if (.not. given) solver%diag = merge(acnorm, 1.0_wp, acnorm > 0)
        xnorm = enorm(solver%diag * x)
        delta = solver%factor * xnorm
        if (.not. delta > 0) delta = solver%factor
      end if
      gnorm = scaled_gradient(solver, fnorm, acnorm)
      if (gnorm <= solver%gtol) then
        solver%info = small_gradient
        return
      end if
      if (.not. given) solver%diag = max(solver%diag, acnorm)
      inner: do
        call lmpar(solver%fjac, solver%ipvt, solver%diag, solver%qtf, delta, par, step, work, &
                   problem%stop_flag)
        if (stop_requested(problem%stop_flag)) solver%info = stopped_by_user
        if (solver%info < 0) return
        step = -step
        trial = x + step
        pnorm = enorm(solver%diag * step)
        if (iteration == 1) delta = min(delta, pnorm)
        call problem%residual(trial, ftrial, solver%info)
        solver%nfev = solver%nfev + 1
        if (solver%info < 0) return
        fnorm_trial = enorm(ftrial)
        actual = -1
        if (0.1_wp * fnorm_trial < fnorm) actual = 1 - (fnorm_trial / fnorm)**2
        call predict_reduction(solver, step, fnorm, par, pnorm, predicted, slope)
        ratio = 0
        if (abs(predicted) > 0) ratio = actual / predicted
        call adjust_region(ratio, actual, slope, 0.1_wp * fnorm_trial >= fnorm, pnorm, delta, par)
        if (ratio >= 1.0e-4_wp) then
          x = trial
          fvec = ftrial
          xnorm = enorm(solver%diag * x)
          fnorm = fnorm_trial
          iteration = iteration + 1
        end if
        solver%info = stop_reason(solver, actual, predicted, ratio, delta, xnorm, gnorm)
        if (solver%info /= no_reason_yet) return
        if (.not. ratio < 1.0e-4_wp) exit inner
      end do inner
    end do outer
  end subroutine lmdif

  ! Factorises the Jacobian at x, by forward differences with steps sqrt(epsfcn) * |x_j|, applies
  ! its reflections to f, whose first n elements are kept, and then overwrites them by R's diagonal.
  subroutine linearise(problem, x, fvec, solver, work, acnorm)
    class(least_squares_t), intent(inout) :: problem
    real(wp), intent(inout) :: x(:)     ! (n): unchanged on return
    real(wp), intent(in) :: fvec(:)     ! (m): f(x)
    type(lmdif_t), intent(inout) :: solver
    real(wp), intent(inout), contiguous :: work(:)     ! (m)
    real(wp), intent(out) :: acnorm(:)                 ! (n): norms of the Jacobian's columns
    real(wp) :: diagonal(size(x)), step, x_j
    integer :: j

    associate (qr => solver%fjac)
      do j = 1, size(x)
        x_j = x(j)
        step = sqrt(max(solver%epsfcn, eps)) * abs(x_j)
        if (.not. step > 0) step = sqrt(max(solver%epsfcn, eps))
        x(j) = x_j + step
        call problem%residual(x, qr(:, j), solver%info)
        solver%nfev = solver%nfev + 1
        x(j) = x_j
        if (stop_requested(problem%stop_flag)) solver%info = stopped_by_user
        if (solver%info < 0) return
        qr(:, j) = (qr(:, j) - fvec) / step
      end do
      call qrfac(qr, solver%ipvt, diagonal, acnorm, problem%stop_flag)
      if (stop_requested(problem%stop_flag)) solver%info = stopped_by_user
      if (solver%info < 0) return
      work = fvec
      do j = 1, size(x)
        if (abs(qr(j, j)) > 0) call reflect(qr(j:, j), work(j:))
        qr(j, j) = diagonal(j)
      end do
      solver%qtf = work(:size(x))
    end associate
  end subroutine linearise

  ! Largest cosine of the angle between f and a column of the Jacobian.
  pure real(wp) function scaled_gradient(solver, fnorm, acnorm)
    type(lmdif_t), intent(in) :: solver        ! whose fjac has R in the upper triangle
    real(wp), intent(in) :: fnorm, acnorm(:)   ! acnorm: (n), norms of the Jacobian's columns
    integer :: j

    scaled_gradient = 0
    if (.not. fnorm > 0) return
    do j = 1, size(acnorm)
      if (.not. acnorm(solver%ipvt(j)) > 0) cycle
      scaled_gradient = max(scaled_gradient, abs(dot_product(solver%fjac(:j, j), &
                            solver%qtf(:j) / fnorm) / acnorm(solver%ipvt(j))))
    end do
  end function scaled_gradient

  ! Relative reduction of |f|**2 in the linear model, and half its derivative along the step.
  pure subroutine predict_reduction(solver, step, fnorm, par, pnorm, reduction, slope)
    type(lmdif_t), intent(in) :: solver        ! whose fjac has R in the upper triangle
    real(wp), intent(in) :: step(:), fnorm, par, pnorm   ! step: (n)
    real(wp), intent(out) :: reduction, slope
    real(wp) :: image(size(step)), linear, damping
    integer :: j

    image = 0
    do j = 1, size(step)
      image(:j) = image(:j) + solver%fjac(:j, j) * step(solver%ipvt(j))
    end do
    linear = enorm(image) / fnorm
    damping = (sqrt(par) * pnorm) / fnorm
    reduction = linear**2 + damping**2 / 0.5_wp
    slope = -(linear**2 + damping**2)
  end subroutine predict_reduction

  ! Shrinks or widens the trust region by how well the model foretold f.
  pure subroutine adjust_region(ratio, actual, slope, far_worse, pnorm, delta, par)
    real(wp), intent(in) :: ratio, actual, slope, pnorm
    logical, intent(in) :: far_worse  ! |f| grew tenfold or more
    real(wp), intent(inout) :: delta, par
    real(wp) :: shrink

    if (ratio <= 0.25_wp) then
      shrink = 0.5_wp
      if (actual < 0) shrink = 0.5_wp * slope / (slope + 0.5_wp * actual)
      if (far_worse .or. shrink < 0.1_wp) shrink = 0.1_wp
      delta = shrink * min(delta, pnorm / 0.1_wp)
      par = par / shrink
    else if (.not. par > 0 .or. ratio >= 0.75_wp) then
      delta = pnorm / 0.5_wp
      par = 0.5_wp * par
    end if
  end subroutine adjust_region

  ! MINPACK's tests in MINPACK's order, until one is met
  pure integer function stop_reason(solver, actual, predicted, ratio, delta, xnorm, gnorm) &
      result(info)
    type(lmdif_t), intent(in) :: solver
    real(wp), intent(in) :: actual, predicted, ratio, delta, xnorm, gnorm

    info = no_reason_yet
    if (reduction_within(solver%ftol)) info = small_reduction
    if (delta <= solver%xtol * xnorm) info = small_step
    if (reduction_within(solver%ftol) .and. info == small_step) info = small_reduction_and_step
    if (info /= no_reason_yet) return
    if (solver%nfev >= solver%maxfev) info = too_many_evaluations
    if (reduction_within(eps)) info = ftol_too_small
    if (delta <= eps * xnorm) info = xtol_too_small
    if (gnorm <= eps) info = gtol_too_small

  contains

    ! Whether the actual and the foretold reduction of |f|**2 are within a tolerance
    pure logical function reduction_within(tolerance)
      real(wp), intent(in) :: tolerance
      reduction_within = abs(actual) <= tolerance .and. predicted <= tolerance &
          .and. 0.5_wp * ratio <= 1
    end function reduction_within

  end function stop_reason

end module levenberg_marquardt_m
