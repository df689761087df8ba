! Simplified Newton iteration for collocation methods of three stages, after Hairer and Wanner,
! "Solving Ordinary Differential Equations II", section IV.8. The coordinates of the stages solve
!
!   h sum_j a_ij F_j = z_i,   F_j = dexp^-1_(z_j) f(t + c_j h, exp(z_j) y),
!
! or A^-1 z / h = F. With A^-1 = T diag(gamma, mu) T^-1, where the complex mu stands for a block of
! two rows, and with the same Jacobian J for all stages the correction of z is T d, where
!
!   (gamma / h - J) d_1 = r_1,   (mu / h - J) (d_2 + i d_3) = r_2 + i r_3,
!   r = T^-1 (F - A^-1 z / h).
module newton_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use frames_m, only: frame_t
  use vectors_m, only: dgetrf, dgetrs, zgetrf, zgetrs
  use shared_numbers, only: factor_operation, solve_operation
  implicit none
  private
  public :: newton_t, transformation_t, correction, derivatives, factor, filtered, predict, reserve

  integer, parameter :: stages = 3           ! that are implicit

  type :: transformation_t                   ! in the order in which Python has its numbers
    sequence
    real(wp) :: inverse(stages, stages)      ! A^-1
    real(wp) :: t(stages, stages), t_inverse(stages, stages)
    ! (power, stage) coefficients of the integrals of Lagrange's polynomials
    real(wp) :: integral(stages, stages)
    real(wp) :: gamma, mu(2)                 ! mu: real and imaginary part
  end type transformation_t

  ! What is kept between steps, besides arrays
  type :: newton_state_t
    logical :: has_jacobian = .false., fresh = .false. ! fresh: that of the present point
    logical :: moved = .false.               ! whether the point has been replaced after the last step
    real(wp) :: factored_h = 0.0_wp          ! step size of the factors, 0 if there are none
    real(wp) :: rate_factor = 1.0_wp         ! rate / (1 - rate) of the last iteration
    real(wp) :: last_h = 0.0_wp              ! the last step, 0 if the solution jumped after it
  end type newton_state_t

  ! What a trajectory keeps for its iterations
  type, extends(newton_state_t) :: newton_t
    type(frame_t), pointer :: frame => null()
    type(transformation_t), pointer :: transformation => null()
    logical :: sparse = .false.              ! whether Python keeps the Jacobian and its factors
    integer :: member = 1
    integer :: column = 0                    ! that of the Jacobian that is evaluated next
    integer :: iteration = 0                 ! 0 before the first one of an attempt
    real(wp) :: rate = 0.0_wp, norm = 0.0_wp ! those of corrections
    real(wp), allocatable :: last(:, :)      ! (dimension, stages) derivatives in the last step
    real(wp), allocatable :: z(:, :)         ! (dimension, stages)
    real(wp), allocatable :: jacobian(:, :)  ! (dimension, dimension), or no column if it is sparse
    real(wp), allocatable :: lu(:, :)
    complex(wp), allocatable :: complex_lu(:, :)
    integer, allocatable :: pivot(:), complex_pivot(:)
  end type newton_t

contains

  ! Allocates the memory of an iteration.
  subroutine reserve(frame, transformation, sparse, self, memory)
    type(frame_t), target, intent(in) :: frame
    type(transformation_t), target, intent(in) :: transformation
    logical, intent(in) :: sparse
    type(newton_t), intent(inout) :: self
    integer, intent(out) :: memory           ! nonzero if there isn't enough

    self%frame => frame
    self%transformation => transformation
    self%sparse = sparse
    associate (n => frame%dimension, m => merge(0, frame%dimension, sparse))
      allocate (self%last(n, stages), self%z(n, stages), self%jacobian(n, m), self%lu(m, m), &
                self%complex_lu(m, m), self%pivot(m), self%complex_pivot(m), stat=memory)
    end associate
  end subroutine reserve

  ! Factors both matrices for a step size. Those that aren't finite count as singular.
  subroutine factor(self, h, singular)
    type(newton_t), intent(inout) :: self
    real(wp), intent(in) :: h
    logical, intent(out) :: singular
    real(wp) :: answer(1)
    integer :: i, info

    self%factored_h = h
    associate (gamma => self%transformation%gamma / h, mu => self%transformation%mu / h)
      if (self%sparse) then
        answer = 1.0_wp
        call self%frame%callback%apply(factor_operation, [real(self%member - 1, wp), gamma, mu], &
                                       [0.0_wp], answer)
        singular = .not. answer(1) <= 0
        return
      end if
      singular = .not. all(abs(self%jacobian) <= huge(1.0_wp))
      if (singular) return
      self%lu = -self%jacobian
      self%complex_lu = cmplx(-self%jacobian, kind=wp)
      do i = 1, size(self%lu, 1)
        self%lu(i, i) = self%lu(i, i) + gamma
        self%complex_lu(i, i) = self%complex_lu(i, i) + cmplx(mu(1), mu(2), wp)
      end do
    end associate
    associate (n => size(self%pivot))
      call dgetrf(n, n, self%lu, n, self%pivot, info)
      if (info == 0) call zgetrf(n, n, self%complex_lu, n, self%complex_pivot, info)
    end associate
    singular = info /= 0
  end subroutine factor

  ! Solves (gamma / h - J) x = b or, of two columns, (mu / h - J) (x_1 + i x_2) = b_1 + i b_2.
  subroutine solve(self, n, columns, b)
    type(newton_t), intent(in) :: self
    integer, intent(in) :: n, columns
    real(wp), intent(inout) :: b(n, columns)
    complex(wp) :: x(n)
    real(wp) :: numbers(n * columns)
    integer :: info

    if (self%sparse) then
      numbers = [b]
      call self%frame%callback%apply(solve_operation, [real(self%member - 1, wp)], [b], numbers)
      b = reshape(numbers, shape(b))
    else if (columns == 1) then
      call dgetrs('N', n, 1, self%lu, n, self%pivot, b, n, info)
    else
      x = cmplx(b(:, 1), b(:, 2), wp)
      call zgetrs('N', n, 1, self%complex_lu, n, self%complex_pivot, x, n, info)
      b(:, 1) = x%re
      b(:, 2) = x%im
    end if
  end subroutine solve

  ! Computes the correction of z from the derivatives at the stages.
  subroutine correction(self, h, f, dz)
    type(newton_t), intent(in) :: self
    real(wp), intent(in) :: h, f(:, :)                 ! f: (dimension, stages)
    real(wp), intent(out) :: dz(:, :)                  ! (dimension, stages)
    real(wp) :: d(size(f, 1), stages)

    call derivatives(self, h, d)
    d = matmul(f - d, transpose(self%transformation%t_inverse))
    call solve(self, size(f, 1), 1, d(:, 1))
    call solve(self, size(f, 1), 2, d(:, 2:3))
    dz = matmul(d, transpose(self%transformation%t))
  end subroutine correction

  ! Computes A^-1 z / h, the derivatives at the stages with coordinates z.
  pure subroutine derivatives(self, h, f)
    type(newton_t), intent(in) :: self
    real(wp), intent(in) :: h
    real(wp), intent(out) :: f(:, :)                   ! (dimension, stages)

    f = matmul(self%z, transpose(self%transformation%inverse / h))
  end subroutine derivatives

  ! Applies (1 - h J / gamma)^-1, which damps fast components of error estimates.
  subroutine filtered(self, v)
    type(newton_t), intent(in) :: self
    real(wp), contiguous, intent(inout) :: v(:)        ! (dimension)

    v = v * (self%transformation%gamma / self%factored_h)
    call solve(self, size(v), 1, v)
  end subroutine filtered

  ! Predicts z from the polynomial u of the last step, at theta = 1 + c h / last_h: to first order
  ! in brackets, exp(z) exp(u(1)) = exp(u(theta)) for z = dexp^-1_(-u(1)) (u(theta) - u(1)).
  subroutine predict(self, series, c, h)
    type(newton_t), intent(inout) :: self
    integer, intent(in) :: series            ! order up to which dexp^-1 is needed
    real(wp), intent(in) :: c(:), h                    ! c: (stages)
    real(wp) :: powers(stages), back(size(self%z, 1))
    logical :: exists
    integer :: d, i

    self%z = 0.0_wp
    if (self%last_h == 0) return
    back = -self%last_h * matmul(self%last, sum(self%transformation%integral, dim=1))
    do i = 1, stages
      powers = [((1 + c(i) * h / self%last_h)**d - 1, d = 1, stages)]
      self%z(:, i) = self%last_h * matmul(self%last, matmul(powers, self%transformation%integral))
      call dexpinv(self%frame, series, back, self%z(:, i), exists)
      if (.not. exists) self%z(:, i) = 0.0_wp
    end do
  end subroutine predict

end module newton_m
