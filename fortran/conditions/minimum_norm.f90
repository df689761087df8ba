! Levenberg-Marquardt for order conditions r(x) = 0, which are fewer than the unknowns: steps of
! least norm, with the second derivative along them taken into account.
!
! With J = dr/dx, a step p minimises |J p + r|^2 + lambda |p|^2 by p = -J^T y, where (J J^T + lambda
! I) y = r, and is bent by half the acceleration a of the curve on which the linear model holds (see
! cg/construction/solvers/minimum_norm.py). Steps along narrow bent valleys are then many times
! longer. lambda, the variable `damping`, changes by H. B. Nielsen's rule (IMM-REP-1999-05).
module minimum_norm_m
  use kinds, only: wp
  use conditions_m, only: order_conditions_t
  use vectors_m, only: dpotrf, dpotrs, dsyrk
  use shared_numbers, only: no_descent, not_finite, out_of_iterations, solved, stopped
  use linalg_m, only: stop_requested
  implicit none
  private
  public :: minimise_norm

  real(wp), parameter :: min_damping = 1.0e-17_wp, max_damping = 1.0e8_wp
  real(wp), parameter :: probe = 0.1_wp              ! where along p the second derivative is taken
  real(wp), parameter :: max_bend = 0.75_wp          ! largest |a| / |p| that is trusted

  ! The linear model of the residuals at a point
  type :: linear_model_t
    real(wp), allocatable :: full(:, :)      ! (conditions, unknowns)
    real(wp), allocatable :: jac(:, :)       ! (conditions, moving unknowns)
    real(wp), allocatable :: gram(:, :)      ! (conditions, conditions) J J^T
    real(wp), allocatable :: factor(:, :)    ! (conditions, conditions) factor of J J^T + lambda I
  end type linear_model_t

contains

  ! Minimises the sum of squared residuals over the unknowns listed in `moving`.
  subroutine minimise_norm(problem, x, conditions, moving, ftol, first_damping, max_iterations, &
                           f, evaluations, status)
    class(order_conditions_t), intent(inout) :: problem
    real(wp), intent(inout) :: x(:)        ! (unknowns)
    integer, intent(in) :: conditions      ! number of residuals
    integer, intent(in) :: moving(:)       ! (moving unknowns) indices
    real(wp), intent(in) :: ftol           ! >= 0
    real(wp), intent(in) :: first_damping  ! over the largest diagonal entry of J J^T
    integer, intent(in) :: max_iterations
    real(wp), intent(out) :: f             ! sum of squared residuals at x
    integer, intent(out) :: evaluations, status
    type(linear_model_t) :: model
    real(wp), dimension(conditions) :: r, r_trial, y
    real(wp) :: step(size(moving)), trial(size(x)), damping, growth, f_trial, gain
    integer :: outcome, i, info, iteration

    allocate (model%full(conditions, size(x)), model%jac(conditions, size(moving)))
    allocate (model%gram(conditions, conditions), model%factor(conditions, conditions), &
              source=0.0_wp)
    status = not_finite
    evaluations = 1
    outcome = 0
    call problem%residual(x, r, outcome)
    f = sum(r**2)
    if (outcome < 0 .or. .not. f <= huge(f)) return
    status = out_of_iterations
    if (f <= ftol) status = solved
    call linearise(problem, x, moving, model, outcome)
    if (outcome < 0) status = not_finite
    damping = max(first_damping * maxval([(dot_product(model%jac(i, :), model%jac(i, :)), &
                                           i=1, conditions)]), min_damping)
    growth = 2.0_wp
    do iteration = 1, max_iterations
      if (status /= out_of_iterations) exit
      if (stop_requested(problem%stop_flag)) then
        status = stopped
        exit
      end if
      call factor(model, damping)
      y = r
      call dpotrs('L', conditions, 1, model%factor, conditions, y, conditions, info)
      step = -matmul(y, model%jac)
      call add_acceleration(problem, x, moving, r, model, step)
      trial = x
      trial(moving) = x(moving) + step
      outcome = 0
      call problem%residual(trial, r_trial, outcome)
      evaluations = evaluations + 2
      f_trial = sum(r_trial**2)
      if (outcome >= 0 .and. f_trial < f) then
        gain = (f - f_trial) / max(f - sum((damping * y)**2), tiny(f))
        damping = max(damping * max(1.0_wp / 3.0_wp, 1.0_wp - (2.0_wp * gain - 1.0_wp)**3), &
                      min_damping)
        growth = 2.0_wp
        x = trial
        r = r_trial
        f = f_trial
        if (f <= ftol) then
          status = solved
        else
          call linearise(problem, x, moving, model, outcome)
          if (outcome < 0) status = no_descent
        end if
      else
        damping = damping * growth
        growth = 2.0_wp * growth
        if (damping > max_damping) status = no_descent
      end if
    end do
  end subroutine minimise_norm

  ! Computes the Jacobian and its Gram matrix.
  subroutine linearise(problem, x, moving, model, outcome)
    class(order_conditions_t), intent(inout) :: problem
    real(wp), intent(in) :: x(:)
    integer, intent(in) :: moving(:)
    type(linear_model_t), intent(inout) :: model
    integer, intent(out) :: outcome          ! negative if the Jacobian isn't finite

    outcome = 0
    call problem%jacobian(x, model%full, outcome)
    model%jac = model%full(:, moving)
    call dsyrk('L', 'N', size(model%jac, 1), size(moving), 1.0_wp, model%jac, size(model%jac, 1), &
               0.0_wp, model%gram, size(model%gram, 1))
  end subroutine linearise

  ! Adds half of the acceleration a to the step: J a is minus the second derivative of r along it.
  subroutine add_acceleration(problem, x, moving, r, model, step)
    class(order_conditions_t), intent(inout) :: problem
    real(wp), intent(in) :: x(:), r(:)       ! r: the residuals at x
    integer, intent(in) :: moving(:)
    type(linear_model_t), intent(in) :: model
    real(wp), intent(inout) :: step(:)
    real(wp) :: ahead(size(x)), second(size(r)), acceleration(size(step))
    integer :: outcome, info

    ahead = x
    ahead(moving) = x(moving) + probe * step
    outcome = 0
    call problem%residual(ahead, second, outcome)
    if (outcome < 0) return
    second = (2.0_wp / probe) * ((second - r) / probe - matmul(model%jac, step))
    call dpotrs('L', size(r), 1, model%factor, size(r), second, size(r), info)
    acceleration = -matmul(second, model%jac)
    if (norm2(acceleration) <= max_bend * norm2(step)) step = step + 0.5_wp * acceleration
  end subroutine add_acceleration

  ! Factorises the damped Gram matrix; the damping increases if rounding makes it indefinite.
  subroutine factor(model, damping)
    type(linear_model_t), intent(inout) :: model
    real(wp), intent(inout) :: damping
    integer :: i, info

    do
      model%factor = model%gram
      do i = 1, size(model%factor, 1)
        model%factor(i, i) = model%factor(i, i) + damping
      end do
      call dpotrf('L', size(model%factor, 1), model%factor, size(model%factor, 1), info)
      if (info == 0 .or. .not. damping <= max_damping) exit        ! NaN may stay
      damping = 4.0_wp * damping
    end do
  end subroutine factor

end module minimum_norm_m
