! Least-squares problems of m residuals of n unknowns, and the linear algebra of MINPACK's lmdif: a
! pivoted QR factorisation a P = Q R, and the damped steps x that minimise |a x - b|**2 + par |D
! x|**2, by Givens rotations: More, Garbow, Hillstrom, User Guide for MINPACK-1, ANL-80-74 (1980).
!
! LAPACK has no real(16). Sums run in MINPACK's order, so that real(8) repeats its bits.
!
! What takes long in real(16) reads a flag by which another thread may end it, without results.
module linalg_m
  use kinds, only: wp
  implicit none
  private
  public :: enorm, least_squares_t, lmpar, qrfac, reflect, stop_requested

  type, abstract :: least_squares_t
    integer, pointer :: stop_flag => null()  ! another thread ends the solve by setting it
  contains
    procedure(residual_i), deferred :: residual
  end type least_squares_t

  abstract interface
    ! f(x). A negative `outcome` stops the solver, whose `info` it becomes.
    subroutine residual_i(self, x, f, outcome)
      import :: least_squares_t, wp
      class(least_squares_t), intent(inout) :: self
      real(wp), intent(in) :: x(:)       ! (n)
      real(wp), intent(out) :: f(:)      ! (m)
      integer, intent(inout) :: outcome
    end subroutine residual_i
  end interface

  ! MINPACK's numbers, since others would round differently near zero residuals: squares of numbers
  ! between them neither underflow nor overflow in any kind with the exponents of single precision.
  real(wp), parameter :: rdwarf = 3.834e-20_wp, rgiant = 1.304e19_wp

contains

  ! Whether another thread has set the flag since the call began; false without a flag
  logical function stop_requested(stop_flag)
    ! volatile, which excludes intent(in): every call reads the memory afresh
    integer, intent(inout), volatile, optional :: stop_flag

    stop_requested = .false.
    if (present(stop_flag)) stop_requested = stop_flag /= 0
  end function stop_requested

  ! Euclidean norm without overflow: small, ordinary and large components are summed apart.
  pure function enorm(x) result(norm)
    real(wp), intent(in) :: x(:)  ! (n)
    real(wp) :: norm, large, ordinary, small, large_scale, small_scale, magnitude, giant
    integer :: i

    large = 0
    ordinary = 0
    small = 0
    large_scale = 0
    small_scale = 0
    giant = rgiant / real(max(size(x), 1), wp)
    do i = 1, size(x)
      magnitude = abs(x(i))
      if (magnitude > rdwarf .and. magnitude < giant) then
        ordinary = ordinary + magnitude**2
      else if (magnitude <= rdwarf) then
        if (magnitude > 0) call add_scaled(magnitude, small_scale, small)
      else
        call add_scaled(magnitude, large_scale, large)
      end if
    end do
    if (large <= 0 .and. ordinary <= 0) then
      norm = small_scale * sqrt(small)
    else if (large <= 0 .and. ordinary >= small_scale) then
      norm = sqrt(ordinary * (1 + (small_scale / ordinary) * (small_scale * small)))
    else if (large <= 0) then
      norm = sqrt(small_scale * ((ordinary / small_scale) + (small_scale * small)))
    else
      norm = large_scale * sqrt(large + (ordinary / large_scale) / large_scale)
    end if
  end function enorm

  ! Adds magnitude**2 to the sum scale**2 * total, keeping scale the largest.
  pure subroutine add_scaled(magnitude, scale, total)
    real(wp), intent(in) :: magnitude
    real(wp), intent(inout) :: scale, total

    if (magnitude <= scale) then
      total = total + (magnitude / scale)**2
    else
      total = 1 + total * (scale / magnitude)**2
      scale = magnitude
    end if
  end subroutine add_scaled

  ! Householder QR with column pivoting, a P = Q R. On return the strict upper triangle of `a` is
  ! R's, `rdiag` R's diagonal (of decreasing magnitude), and the lower trapezoid of `a` the vectors
  ! u of the reflections 1 - u u^T / u_j, from which Q is formed.
  subroutine qrfac(a, ipvt, rdiag, acnorm, stop_flag)
    real(wp), intent(inout), contiguous :: a(:,:)  ! (m, n)
    integer, intent(out) :: ipvt(:)                ! (n): column j of P is column ipvt(j) of 1
    real(wp), intent(out) :: rdiag(:)              ! (n)
    real(wp), intent(out) :: acnorm(:)             ! (n): norms of the columns of a on entry
    integer, intent(inout), optional :: stop_flag
    real(wp) :: reference(size(a, 2))              ! the column norms when last computed afresh
    real(wp) :: norm
    integer :: j, k, m, n

    m = size(a, 1)
    n = size(a, 2)
    acnorm = [(enorm(a(:, j)), j=1, n)]
    rdiag = acnorm
    reference = acnorm
    ipvt = [(j, j=1, n)]
    do j = 1, min(m, n)
      k = j - 1 + maxloc(rdiag(j:), dim=1)
      if (k /= j) then
        a(:, [j, k]) = a(:, [k, j])
        rdiag(k) = rdiag(j)
        reference(k) = reference(j)
        ipvt([j, k]) = ipvt([k, j])
      end if
      norm = enorm(a(j:, j))
      if (norm > 0) then
        if (a(j, j) < 0) norm = -norm
        a(j:, j) = a(j:, j) / norm
        a(j, j) = a(j, j) + 1
        do k = j + 1, n
          if (stop_requested(stop_flag)) return
          call reflect(a(j:, j), a(j:, k))
          call downdate(a(j:, k), rdiag(k), reference(k))
        end do
      end if
      rdiag(j) = -norm
    end do
  end subroutine qrfac

  ! y := (1 - u u^T / u_1) y
  pure subroutine reflect(u, y)
    real(wp), intent(in), contiguous :: u(:)     ! (length)
    real(wp), intent(inout), contiguous :: y(:)  ! (length)
    real(wp) :: factor

    factor = dot_product(u, y) / u(1)
    y = y - factor * u
  end subroutine reflect

  ! The norm of a column without its first element; computed afresh if half its digits cancel
  pure subroutine downdate(column, norm, reference)
    real(wp), intent(in), contiguous :: column(:)  ! (rows left, the eliminated one first)
    real(wp), intent(inout) :: norm, reference
    real(wp) :: ratio

    if (.not. norm > 0) return
    ratio = column(1) / norm
    norm = norm * sqrt(max(0.0_wp, 1 - ratio**2))
    if (0.05_wp * (norm / reference)**2 <= epsilon(1.0_wp)) then
      norm = enorm(column(2:))
      reference = norm
    end if
  end subroutine downdate

  ! Given a P = Q R, minimises |a x - b|**2 + |D x|**2. The upper triangle of `r` holds R and stays.
  ! With P^T (a^T a + D**2) P = S^T S the lower triangle returns S^T, `sdiag` its diagonal.
  subroutine qrsolv(r, ipvt, diag, qtb, x, sdiag, stop_flag)
    real(wp), intent(inout), contiguous :: r(:,:)  ! (>= n, n)
    integer, intent(in) :: ipvt(:)                 ! (n)
    real(wp), intent(in) :: diag(:)                ! (n): D
    real(wp), intent(in) :: qtb(:)                 ! (n): first n elements of Q^T b
    real(wp), intent(out) :: x(:), sdiag(:)        ! (n)
    integer, intent(inout), optional :: stop_flag
    real(wp) :: rhs(size(r, 2)), rdiag(size(r, 2))
    integer :: j, n, rank

    n = size(r, 2)
    x = 0
    rhs = qtb(:n)
    do j = 1, n
      r(j:n, j) = r(j, j:n)
      rdiag(j) = r(j, j)
    end do
    do j = 1, n
      if (stop_requested(stop_flag)) return
      if (abs(diag(ipvt(j))) > 0) call rotate_in(j, diag(ipvt(j)), r, rhs, sdiag)
      sdiag(j) = r(j, j)
      r(j, j) = rdiag(j)
    end do
    rank = findloc([abs(sdiag) > 0, .false.], .false., 1) - 1
    rhs(rank + 1:) = 0
    do j = rank, 1, -1
      rhs(j) = (rhs(j) - dot_product(r(j + 1:rank, j), rhs(j + 1:rank))) / sdiag(j)
    end do
    x(ipvt) = rhs
  end subroutine qrsolv

  ! Givens rotations that eliminate the row of D whose entry in column j is d.
  pure subroutine rotate_in(j, d, r, rhs, row)
    integer, intent(in) :: j
    real(wp), intent(in) :: d
    real(wp), intent(inout), contiguous :: r(:,:)  ! (>= n, n): S^T in the lower triangle
    real(wp), intent(inout) :: rhs(:)              ! (n)
    real(wp), intent(inout) :: row(:)              ! (n): work from element j on
    real(wp) :: cosine, sine, ratio, row_rhs, rotated
    integer :: i, k

    row(j) = d
    row(j + 1:) = 0
    row_rhs = 0
    do k = j, size(r, 2)
      if (.not. abs(row(k)) > 0) cycle
      if (abs(r(k, k)) < abs(row(k))) then
        ratio = r(k, k) / row(k)
        sine = 0.5_wp / sqrt(0.25_wp + 0.25_wp * ratio**2)
        cosine = sine * ratio
      else
        ratio = row(k) / r(k, k)
        cosine = 0.5_wp / sqrt(0.25_wp + 0.25_wp * ratio**2)
        sine = cosine * ratio
      end if
      r(k, k) = cosine * r(k, k) + sine * row(k)
      rotated = cosine * rhs(k) + sine * row_rhs
      row_rhs = -sine * rhs(k) + cosine * row_rhs
      rhs(k) = rotated
      do i = k + 1, size(r, 2)
        rotated = cosine * r(i, k) + sine * row(i)
        row(i) = -sine * r(i, k) + cosine * row(i)
        r(i, k) = rotated
      end do
    end do
  end subroutine rotate_in

  ! The Levenberg-Marquardt parameter: with x minimising |a x - b|**2 + par |D x|**2, either par = 0
  ! and |D x| <= 1.1 delta, or par > 0 and |D x| is within a tenth of delta (More, 1978).
  subroutine lmpar(r, ipvt, diag, qtb, delta, par, x, sdiag, stop_flag)
    real(wp), intent(inout), contiguous :: r(:,:)  ! (>= n, n): as for qrsolv
    integer, intent(in) :: ipvt(:)                 ! (n)
    real(wp), intent(in) :: diag(:)                ! (n): D, all positive
    real(wp), intent(in) :: qtb(:)                 ! (n)
    real(wp), intent(in) :: delta                  ! > 0
    real(wp), intent(inout) :: par                 ! estimate in, final out
    real(wp), intent(out) :: x(:), sdiag(:)        ! (n)
    integer, intent(inout), optional :: stop_flag
    integer, parameter :: max_iterations = 10
    real(wp) :: scaled(size(r, 2)), work(size(r, 2)), excess, previous, xnorm, gnorm, lower, upper
    integer :: iteration, j, n, rank

    n = size(r, 2)
    sdiag = 0
    call gauss_newton(r, ipvt, qtb, x, rank)
    scaled = diag * x
    xnorm = enorm(scaled)
    excess = xnorm - delta
    if (excess <= 0.1_wp * delta) then
      par = 0
      return
    end if
    lower = 0
    if (rank == n) then
      work = diag(ipvt) * (scaled(ipvt) / xnorm)
      do j = 1, n
        work(j) = (work(j) - dot_product(r(:j - 1, j), work(:j - 1))) / r(j, j)
      end do
      lower = newton_correction(work)
    end if
    work = [(dot_product(r(:j, j), qtb(:j)), j=1, n)] / diag(ipvt)
    gnorm = enorm(work)
    upper = gnorm / delta
    if (.not. upper > 0) upper = tiny(1.0_wp) / min(delta, 0.1_wp)
    par = min(max(par, lower), upper)
    if (.not. par > 0) par = gnorm / xnorm
    do iteration = 1, max_iterations
      if (.not. par > 0) par = max(tiny(1.0_wp), 0.001_wp * upper)
      call qrsolv(r, ipvt, sqrt(par) * diag, qtb, x, sdiag, stop_flag)
      if (stop_requested(stop_flag)) return
      scaled = diag * x
      xnorm = enorm(scaled)
      previous = excess
      excess = xnorm - delta
      if (abs(excess) <= 0.1_wp * delta) exit
      if (.not. lower > 0 .and. excess <= previous .and. previous < 0) exit
      if (iteration == max_iterations) exit
      work = diag(ipvt) * (scaled(ipvt) / xnorm)
      do j = 1, n
        work(j) = work(j) / sdiag(j)
        work(j + 1:) = work(j + 1:) - r(j + 1:n, j) * work(j)
      end do
      if (excess > 0) lower = max(lower, par)
      if (excess < 0) upper = min(upper, par)
      par = max(lower, par + newton_correction(work))
    end do

  contains

    ! One Newton step for 1/delta - 1/|D x(par)| = 0.
    pure real(wp) function newton_correction(derivative)
      real(wp), intent(in) :: derivative(:)  ! (n)
      real(wp) :: norm

      norm = enorm(derivative)
      newton_correction = ((excess / delta) / norm) / norm
    end function newton_correction

  end subroutine lmpar

  ! x = P R^-1 Q^T b; from the first zero on R's diagonal on, zeros instead.
  pure subroutine gauss_newton(r, ipvt, qtb, x, rank)
    real(wp), intent(in), contiguous :: r(:,:)  ! (>= n, n)
    integer, intent(in) :: ipvt(:)              ! (n)
    real(wp), intent(in) :: qtb(:)              ! (n)
    real(wp), intent(out) :: x(:)               ! (n)
    integer, intent(out) :: rank                ! elements of the diagonal before the first zero
    real(wp) :: work(size(r, 2))
    integer :: j

    rank = findloc([(abs(r(j, j)) > 0, j=1, size(r, 2)), .false.], .false., 1) - 1
    work(:rank) = qtb(:rank)
    work(rank + 1:) = 0
    do j = rank, 1, -1
      work(j) = work(j) / r(j, j)
      work(:j - 1) = work(:j - 1) - r(:j - 1, j) * work(j)
    end do
    x(ipvt) = work
  end subroutine gauss_newton

end module linalg_m
