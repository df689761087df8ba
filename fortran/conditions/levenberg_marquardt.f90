! MINPACK's lmdif on order conditions: minimises |f(x)| by steps p within an elliptic trust region
! |D p| <= delta, that minimise |J p + f|**2 + par |D p|**2, with J by forward differences. delta
! grows where the linear model foretells |f| well, and shrinks where it doesn't. J. J. More, The
! Levenberg-Marquardt algorithm: implementation and theory, LNM 630 (1978).
!
! The paper's searches ran with it, in double and in real(16), in which there is no LAPACK. Constants,
! tests and statuses are MINPACK's; damped steps are by a factorisation of R and sqrt(par) D together.
module levenberg_marquardt_m
  use kinds, only: wp
  use conditions_m, only: order_conditions_t, stop_requested
  use shared_numbers
  implicit none
  private
  public :: lmdif

  real(wp), parameter :: eps = epsilon(1.0_wp)
  real(wp), parameter :: factor = 100.0_wp   ! the first delta is factor * |D x|
  real(wp), parameter :: worse = 10.0_wp     ! how many times larger |f| counts at most
  real(wp), parameter :: accepted = 1e-4_wp  ! the least reduction, as part of what is predicted

contains

  ! Minimises |f(x)|. Of the conditions, zeros among them included, there are no fewer than unknowns.
  subroutine lmdif(problem, ftol, xtol, maxfev, x, f, info, nfev)
    type(order_conditions_t), intent(inout) :: problem
    real(wp), intent(in) :: ftol, xtol       ! >= 0: relative reduction of |f|**2, relative step
    integer, intent(in) :: maxfev            ! number of evaluations after which no iteration starts
    real(wp), intent(inout) :: x(:)          ! (unknowns): start in, last accepted point out
    real(wp), intent(out) :: f(:)            ! (conditions): f(x)
    integer, intent(out) :: info, nfev       ! a Status, and the number of evaluations
    real(wp) :: a(size(f), size(x) + 1)      ! J, then R, and f, then Q^T f
    real(wp), dimension(size(x)) :: diag, norms, step, p     ! D, norms of the columns of J
    integer :: order(size(x))                ! columns of J in the order of those of R and p
    real(wp) :: trial(size(x)), f_trial(size(f))
    real(wp) :: fnorm, pnorm, xnorm, delta, par, gradient, actual, predicted, linear, damping, ratio
    integer :: flag, j
    logical :: first                         ! whether no step has been accepted

    info = stopped_by_user
    flag = 0
    call problem%residual(x, f, flag)
    nfev = 1
    if (flag < 0) return
    fnorm = norm2(f)
    par = 0.0_wp
    first = .true.
    do
      call difference_jacobian(problem, x, f, a(:, :size(x)), flag)
      nfev = nfev + size(x)
      if (flag < 0) return
      norms = norm2(a(:, :size(x)), 1)
      if (first) then
        diag = merge(norms, 1.0_wp, norms > 0)
        xnorm = norm2(diag * x)
        delta = merge(factor * xnorm, factor, xnorm > 0)
      end if
      gradient = 0.0_wp
      if (fnorm > 0) gradient = maxval(abs(matmul(f / fnorm, a(:, :size(x)))) &
                                       / merge(norms, 1.0_wp, norms > 0))
      info = small_gradient
      if (.not. gradient > 0) return
      info = stopped_by_user
      diag = max(diag, norms)
      a(:, size(x) + 1) = f
      order = [(j, j=1, size(x))]
      call triangularise(a, problem%stop_flag, order)
      do
        if (stop_requested(problem%stop_flag)) return
        call find_step(a(:size(x), :), diag(order), delta, problem%stop_flag, par, p, linear)
        if (stop_requested(problem%stop_flag)) return
        step(order) = p
        trial = x + step
        pnorm = norm2(diag * step)
        if (first) delta = min(delta, pnorm)
        call problem%residual(trial, f_trial, flag)
        nfev = nfev + 1
        if (flag < 0) return

        ! relative reductions of |f|**2, the actual one and that of the linear model
        actual = 1 - (min(norm2(f_trial), worse * fnorm) / fnorm)**2
        linear = (linear / fnorm)**2
        damping = par * (pnorm / fnorm)**2
        predicted = linear + 2 * damping
        ratio = 0.0_wp
        if (predicted > 0) ratio = actual / predicted
        call adjust_region(ratio, actual, -(linear + damping), pnorm, delta, par)
        if (ratio >= accepted) then
          first = .false.
          x = trial
          f = f_trial
          fnorm = norm2(f)
          xnorm = norm2(diag * x)
        end if
        info = status(actual, predicted, ratio, delta <= xtol * xnorm, delta <= eps * xnorm)
        if (info /= improper_input) return
        info = stopped_by_user
        if (ratio >= accepted) exit
      end do
    end do

  contains

    ! The outcome of MINPACK's tests, in their order; improper_input stands for "go on".
    pure integer function status(actual, predicted, ratio, small, smallest)
      real(wp), intent(in) :: actual, predicted, ratio
      logical, intent(in) :: small, smallest ! whether delta is, relative to x
      logical :: slow

      status = improper_input
      slow = max(abs(actual), predicted) <= ftol .and. ratio <= 2
      if (slow) status = small_reduction
      if (small) status = merge(small_reduction_and_step, small_step, slow)
      if (status /= improper_input) return
      if (nfev >= maxfev) status = too_many_evaluations
      if (max(abs(actual), predicted) <= eps .and. ratio <= 2) status = ftol_too_small
      if (smallest) status = xtol_too_small
      if (gradient <= eps) status = gtol_too_small
    end function status

  end subroutine lmdif

  ! Computes the Jacobian by forward differences with steps sqrt(eps) |x_j|.
  subroutine difference_jacobian(problem, x, f, jac, flag)
    type(order_conditions_t), intent(inout) :: problem
    real(wp), intent(inout) :: x(:)          ! (unknowns): unchanged on return
    real(wp), intent(in) :: f(:)             ! (conditions): f(x)
    real(wp), intent(out) :: jac(:, :)       ! (conditions, unknowns)
    integer, intent(inout) :: flag           ! negative where it isn't finite, or the solve shall end
    real(wp) :: step, held
    integer :: j

    do j = 1, size(x)
      held = x(j)
      step = sqrt(eps) * abs(held)
      if (.not. step > 0) step = sqrt(eps)
      x(j) = held + step
      call problem%residual(x, jac(:, j), flag)
      x(j) = held
      if (stop_requested(problem%stop_flag)) flag = stopped_by_user
      if (flag < 0) return
      jac(:, j) = (jac(:, j) - f) / step
    end do
  end subroutine difference_jacobian

  ! Replaces a matrix [A, b] by R and Q^T b, where A = Q R, by Householder's reflections. With an
  ! order it is that of columns with which the diagonal of R decreases in magnitude.
  subroutine triangularise(a, stop_flag, order)
    real(wp), intent(inout) :: a(:, :)       ! (m, n + 1), m >= n
    integer, optional, intent(inout) :: stop_flag
    integer, optional, intent(inout) :: order(:)       ! (n)
    integer, parameter :: renewal = 8        ! columns after which sums are computed afresh
    real(wp) :: u(size(a, 1)), squares(size(a, 2) - 1)
    integer :: j, k, last, n

    n = size(a, 2) - 1
    do j = 1, n
      if (stop_requested(stop_flag)) return
      if (present(order)) then
        ! what is left of columns, without the rows that are done
        if (modulo(j, renewal) == 1) squares(j:) = sum(a(j:, j:n)**2, 1)
        k = j - 1 + maxloc(squares(j:), 1)
        a(:, [j, k]) = a(:, [k, j])
        order([j, k]) = order([k, j])
        squares([j, k]) = squares([k, j])
      end if
      last = findloc(abs(a(:, j)) > 0, .true., 1, back=.true.)
      if (last < j) cycle
      u(j:last) = a(j:last, j) / norm2(a(j:last, j))
      u(j) = u(j) + sign(1.0_wp, u(j))
      do k = j, n + 1
        a(j:last, k) = a(j:last, k) - dot_product(u(j:last), a(j:last, k)) / abs(u(j)) * u(j:last)
      end do
      if (present(order)) squares(j + 1:) = squares(j + 1:) - a(j, j + 1:n)**2
    end do
  end subroutine triangularise

  ! Finds the step p of the parameter par, where either par = 0 and |D p| <= 1.1 delta, or par > 0
  ! and |D p| is within a tenth of delta (More, 1978): a zero of |D p| - delta by Newton's method for
  ! the reciprocals, within bounds.
  subroutine find_step(a, diag, delta, stop_flag, par, p, linear)
    real(wp), intent(in) :: a(:, :)          ! (n, n + 1): R and Q^T f
    real(wp), intent(in) :: diag(:)          ! (n): D, all positive
    real(wp), intent(in) :: delta            ! > 0
    integer, optional, intent(inout) :: stop_flag
    real(wp), intent(inout) :: par           ! that of the step before, then of this one
    real(wp), intent(out) :: p(:)            ! (n)
    real(wp), intent(out) :: linear          ! |J p|
    integer, parameter :: max_iterations = 10
    real(wp) :: s(2 * size(p), size(p) + 1)  ! the damped system, then its triangle
    real(wp) :: excess, previous, lower, upper
    integer :: iteration, j, n

    n = size(p)
    linear = 0.0_wp
    call solve(0.0_wp)
    if (excess <= 0.1_wp * delta) then
      par = 0.0_wp
    else
      lower = 0.0_wp
      if (all([(abs(s(j, j)) > 0, j=1, n)])) lower = correction()
      upper = norm2([(dot_product(a(:j, j), a(:j, n + 1)) / diag(j), j=1, n)]) / delta
      if (.not. upper > 0) upper = tiny(1.0_wp) / min(delta, 0.1_wp)
      par = min(max(par, lower), upper)
      if (.not. par > 0) par = upper * delta / norm2(diag * p)
      do iteration = 1, max_iterations
        if (.not. par > 0) par = max(tiny(1.0_wp), 0.001_wp * upper)
        previous = excess
        call solve(sqrt(par))
        if (stop_requested(stop_flag)) return
        if (abs(excess) <= 0.1_wp * delta .or. iteration == max_iterations) exit
        if (.not. lower > 0 .and. excess <= previous .and. previous < 0) exit
        if (excess > 0) lower = max(lower, par)
        if (excess < 0) upper = min(upper, par)
        par = max(lower, par + correction())
      end do
    end if
    linear = norm2([(dot_product(a(j, j:n), p(j:)), j=1, n)])

  contains

    ! Computes the step with damping, and by how much it is longer than delta. Rows of R and of D
    ! alternate, so that columns end early. Where the diagonal of the triangle is zero, so is the step.
    subroutine solve(damping)
      real(wp), intent(in) :: damping        ! the root of par
      integer :: j

      s = 0.0_wp
      do j = 1, n
        s(1:2 * j - 1:2, j) = a(:j, j)
        s(2 * j, j) = damping * diag(j)
      end do
      s(1::2, n + 1) = a(:, n + 1)
      call triangularise(s, stop_flag)
      p = -s(:n, n + 1)
      do j = n, 1, -1
        p(j) = merge(p(j), 0.0_wp, abs(s(j, j)) > 0) / merge(s(j, j), 1.0_wp, abs(s(j, j)) > 0)
        p(:j - 1) = p(:j - 1) - s(:j - 1, j) * p(j)
      end do
      excess = norm2(diag * p) - delta
    end subroutine solve

    ! The step of Newton's method for 1 / delta - 1 / |D p| = 0 as a function of par
    real(wp) function correction()
      real(wp) :: w(n)                       ! S^-T D^2 p / |D p|
      integer :: j

      w = diag * (diag * p / norm2(diag * p))
      do j = 1, n
        w(j) = (w(j) - dot_product(s(:j - 1, j), w(:j - 1))) / s(j, j)
      end do
      correction = ((excess / delta) / norm2(w)) / norm2(w)
    end function correction

  end subroutine find_step

  ! Shrinks or widens the trust region by how well the model foretold f.
  pure subroutine adjust_region(ratio, actual, slope, pnorm, delta, par)
    real(wp), intent(in) :: ratio, actual, slope, pnorm
    real(wp), intent(inout) :: delta, par
    real(wp) :: shrink

    if (ratio <= 0.25_wp) then
      shrink = 0.5_wp
      if (actual < 0) shrink = max(0.1_wp, 0.5_wp * slope / (slope + 0.5_wp * actual))
      delta = shrink * min(delta, pnorm / 0.1_wp)
      par = par / shrink
    else if (.not. par > 0 .or. ratio >= 0.75_wp) then
      delta = pnorm / 0.5_wp
      par = 0.5_wp * par
    end if
  end subroutine adjust_region

end module levenberg_marquardt_m
