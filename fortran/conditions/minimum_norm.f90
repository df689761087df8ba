! Levenberg-Marquardt for order conditions r(x) = 0, which are fewer than the unknowns: steps of
! least norm, with the second derivative along them taken into account.
!
! With J = dr/dx, a step p minimises |J p + r|^2 + lambda |p|^2 by p = -J^T y,
! (J J^T + lambda I) y = r, and is bent by half the acceleration a of the curve on which the linear
! model holds (M. Transtrum and J. Sethna, Improvements to the Levenberg-Marquardt algorithm for
! nonlinear least-squares minimization, arXiv:1201.5885). Narrow bent valleys, which order
! conditions are full of, are followed in steps many times longer. lambda, the variable `damping`,
! changes by H. B. Nielsen's rule (IMM-REP-1999-05).
module minimum_norm_m
  use kinds, only: wp
  use conditions_m, only: order_conditions_t
  use vectors_m, only: dpotrf, dpotrs, dsyrk
  use shared_numbers, only: no_descent, not_finite, out_of_iterations, solved, stopped
  use linalg_m, only: stop_requested
  implicit none
  private
  public :: minimise_norm

  real(wp), parameter :: min_damping = 1.0e-17_wp
  real(wp), parameter :: max_damping = 1.0e8_wp
  real(wp), parameter :: probe = 0.1_wp              ! where along p the second derivative is taken
  real(wp), parameter :: max_bend = 0.75_wp          ! largest |a| / |p| that is trusted

contains

  ! Minimises the sum of squared residuals over the unknowns listed in `moving`.
  subroutine minimise_norm(problem, x, conditions, moving, ftol, first_damping, max_iterations, &
                           f, evaluations, status)
    class(order_conditions_t), intent(inout) :: problem
    real(wp), intent(inout) :: x(:)        ! (unknowns)
    integer, intent(in) :: conditions      ! number of residuals
    integer, intent(in) :: moving(:)         ! (moving unknowns) indices
    real(wp), intent(in) :: ftol           ! >= 0
    real(wp), intent(in) :: first_damping  ! over the largest diagonal entry of J J^T
    integer, intent(in) :: max_iterations
    real(wp), intent(out) :: f             ! sum of squared residuals at x
    integer, intent(out) :: evaluations, status
    real(wp), allocatable :: full(:, :), jac(:, :), gram(:, :), factor(:, :)
    real(wp), dimension(conditions) :: r, r_trial, y
    real(wp) :: step(size(moving)), trial(size(x))
    real(wp) :: damping, growth, f_trial, gain, largest
    integer :: flag, info, iteration

    allocate (full(conditions, size(x)), jac(conditions, size(moving)))
    allocate (gram(conditions, conditions), factor(conditions, conditions), source=0.0_wp)

    status = not_finite
    evaluations = 1
    flag = 0
    call problem%residual(x, r, flag)
    f = sum(r**2)
    if (flag < 0 .or. .not. f <= huge(f)) return
    status = out_of_iterations
    if (f <= ftol) status = solved
    call linearise()
    if (flag < 0) status = not_finite
    damping = max(first_damping * largest, min_damping)
    growth = 2.0_wp

    do iteration = 1, max_iterations
      if (status /= out_of_iterations) exit
      if (stop_requested(problem%stop_flag)) then
        status = stopped
        exit
      end if
      call factorise()
      y = r
      call dpotrs('L', conditions, 1, factor, conditions, y, conditions, info)
      step = -matmul(y, jac)
      call add_acceleration()
      trial = x
      trial(moving) = x(moving) + step
      flag = 0
      call problem%residual(trial, r_trial, flag)
      evaluations = evaluations + 2
      f_trial = sum(r_trial**2)
      if (flag >= 0 .and. f_trial < f) then
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
          call linearise()
          if (flag < 0) status = no_descent
        end if
      else
        damping = damping * growth
        growth = 2.0_wp * growth
        if (damping > max_damping) status = no_descent
      end if
    end do

  contains

    ! Computes the Jacobian, its Gram matrix, and the largest diagonal entry of this.
    subroutine linearise()
      integer :: i

      flag = 0
      call problem%jacobian(x, full, flag)
      jac = full(:, moving)
      call dsyrk('L', 'N', conditions, size(moving), 1.0_wp, jac, conditions, 0.0_wp, gram, &
                 conditions)
      largest = maxval([(dot_product(jac(i, :), jac(i, :)), i=1, conditions)])
    end subroutine linearise

    ! Adds half of the acceleration a to the step: J a is minus the second derivative of r along it.
    subroutine add_acceleration()
      real(wp) :: second(conditions), acceleration(size(moving))

      trial = x
      trial(moving) = x(moving) + probe * step
      flag = 0
      call problem%residual(trial, r_trial, flag)
      if (flag < 0) return
      second = (2.0_wp / probe) * ((r_trial - r) / probe - matmul(jac, step))
      call dpotrs('L', conditions, 1, factor, conditions, second, conditions, info)
      acceleration = -matmul(second, jac)
      if (norm2(acceleration) <= max_bend * norm2(step)) step = step + 0.5_wp * acceleration
    end subroutine add_acceleration

    ! Factorises the damped Gram matrix; the damping increases if rounding makes it indefinite.
    subroutine factorise()
      integer :: i

      do
        factor = gram
        do i = 1, conditions
          factor(i, i) = factor(i, i) + damping
        end do
        call dpotrf('L', conditions, factor, conditions, info)
        if (info == 0 .or. .not. damping <= max_damping) exit      ! NaN may stay
        damping = 4.0_wp * damping
      end do
    end subroutine factorise
  end subroutine minimise_norm
end module minimum_norm_m
