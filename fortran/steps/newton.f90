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
  use lapack_m, only: dgetrf, dgetrs, zgetrf, zgetrs
  use shared_numbers, only: factor_operation, solve_operation
  implicit none
  private
  public :: newton_t, transformation_t, correction, derivatives, factor, filtered, predict, reserve

  integer, parameter :: stages = 3           ! that are implicit

  type :: transformation_t
    real(wp) :: inverse(stages, stages)      ! A^-1
    real(wp) :: t(stages, stages), t_inverse(stages, stages)
    ! (power, stage) coefficients of the integrals of Lagrange's polynomials
    real(wp) :: integral(stages, stages)
    real(wp) :: gamma, mu(2)                 ! mu: real and imaginary part
  end type transformation_t

  ! What a trajectory keeps for its iterations
  type :: newton_t
    logical :: has_jacobian = .false.
    logical :: fresh = .false.               ! whether the Jacobian is that of the present point
    logical :: sparse = .false.              ! whether Python keeps the Jacobian and its factors
    integer :: member = 1
    integer :: column = 0                    ! of the Jacobian, that is evaluated next
    integer :: iteration = 0                 ! 0 before the first one of an attempt
    real(wp) :: factored_h = 0.0_wp          ! step size of the factors, 0 if there are none
    real(wp) :: rate_factor = 1.0_wp         ! rate / (1 - rate) of the last iteration
    real(wp) :: rate = 0.0_wp, norm = 0.0_wp ! of corrections
    real(wp) :: last_h = 0.0_wp              ! of the last step, 0 if the solution jumped after it
    real(wp), allocatable :: last(:, :)      ! (dimension, stages) derivatives in the last step
    real(wp), allocatable :: z(:, :)         ! (dimension, stages)
    real(wp), allocatable :: jacobian(:, :)  ! (dimension, dimension), or no column if it is sparse
    real(wp), allocatable :: lu(:, :)
    complex(wp), allocatable :: complex_lu(:, :)
    integer, allocatable :: pivot(:), complex_pivot(:)
  end type newton_t

contains

  ! Allocates the memory of an iteration.
  subroutine reserve(n, sparse, newton, memory)
    integer, intent(in) :: n                 ! dimension
    logical, intent(in) :: sparse
    type(newton_t), intent(inout) :: newton
    integer, intent(out) :: memory           ! nonzero if there isn't enough

    newton%sparse = sparse
    associate (m => merge(0, n, sparse))
      allocate (newton%last(n, stages), newton%z(n, stages), newton%jacobian(n, m), &
                newton%lu(m, m), newton%complex_lu(m, m), newton%pivot(m), &
                newton%complex_pivot(m), stat=memory)
    end associate
  end subroutine reserve

  ! Factors both matrices for a step size. Those that aren't finite count as singular.
  subroutine factor(frame, transformation, h, newton, singular)
    type(frame_t), intent(in) :: frame
    type(transformation_t), intent(in) :: transformation
    real(wp), intent(in) :: h
    type(newton_t), intent(inout) :: newton
    logical, intent(out) :: singular
    real(wp) :: answer(1)
    integer :: i, info

    newton%factored_h = h
    associate (gamma => transformation%gamma / h, mu => transformation%mu / h)
      if (newton%sparse) then
        answer = 1.0_wp
        call frame%callback%apply(factor_operation, [real(newton%member - 1, wp), gamma, mu], &
                                  [0.0_wp], answer)
        singular = .not. answer(1) <= 0
        return
      end if
      singular = .not. all(abs(newton%jacobian) <= huge(1.0_wp))
      if (singular) return
      newton%lu = -newton%jacobian
      newton%complex_lu = cmplx(-newton%jacobian, kind=wp)
      do i = 1, size(newton%lu, 1)
        newton%lu(i, i) = newton%lu(i, i) + gamma
        newton%complex_lu(i, i) = newton%complex_lu(i, i) + cmplx(mu(1), mu(2), wp)
      end do
    end associate
    associate (n => size(newton%pivot))
      call dgetrf(n, n, newton%lu, n, newton%pivot, info)
      if (info == 0) call zgetrf(n, n, newton%complex_lu, n, newton%complex_pivot, info)
    end associate
    singular = info /= 0
  end subroutine factor

  ! Solves (gamma / h - J) x = b or, of two columns, (mu / h - J) (x_1 + i x_2) = b_1 + i b_2.
  subroutine solve(frame, newton, n, columns, b)
    type(frame_t), intent(in) :: frame
    type(newton_t), intent(in) :: newton
    integer, intent(in) :: n, columns
    real(wp), intent(inout) :: b(n, columns)
    complex(wp) :: x(n)
    real(wp) :: numbers(n * columns)
    integer :: info

    if (newton%sparse) then
      numbers = [b]
      call frame%callback%apply(solve_operation, [real(newton%member - 1, wp)], (numbers), numbers)
      b = reshape(numbers, shape(b))
    else if (columns == 1) then
      call dgetrs('N', n, 1, newton%lu, n, newton%pivot, b, n, info)
    else
      x = cmplx(b(:, 1), b(:, 2), wp)
      call zgetrs('N', n, 1, newton%complex_lu, n, newton%complex_pivot, x, n, info)
      b(:, 1) = x%re
      b(:, 2) = x%im
    end if
  end subroutine solve

  ! Computes the correction of z from the derivatives at the stages.
  subroutine correction(frame, transformation, h, f, newton, dz)
    type(frame_t), intent(in) :: frame
    type(transformation_t), intent(in) :: transformation
    real(wp), intent(in) :: h
    real(wp), intent(in) :: f(:, :)                    ! (dimension, stages)
    type(newton_t), intent(in) :: newton
    real(wp), intent(out) :: dz(:, :)                  ! (dimension, stages)
    real(wp) :: d(size(f, 1), stages)

    call derivatives(transformation, h, newton%z, d)
    d = matmul(f - d, transpose(transformation%t_inverse))
    call solve(frame, newton, size(f, 1), 1, d(:, 1))
    call solve(frame, newton, size(f, 1), 2, d(:, 2:3))
    dz = matmul(d, transpose(transformation%t))
  end subroutine correction

  ! Computes A^-1 z / h, the derivatives at the stages with coordinates z.
  pure subroutine derivatives(transformation, h, z, f)
    type(transformation_t), intent(in) :: transformation
    real(wp), intent(in) :: h
    real(wp), intent(in) :: z(:, :)                    ! (dimension, stages)
    real(wp), intent(out) :: f(:, :)                   ! (dimension, stages)

    f = matmul(z, transpose(transformation%inverse / h))
  end subroutine derivatives

  ! Applies (1 - h J / gamma)^-1, which damps fast components of error estimates.
  subroutine filtered(frame, transformation, newton, v)
    type(frame_t), intent(in) :: frame
    type(transformation_t), intent(in) :: transformation
    type(newton_t), intent(in) :: newton
    real(wp), contiguous, intent(inout) :: v(:)        ! (dimension)

    v = v * (transformation%gamma / newton%factored_h)
    call solve(frame, newton, size(v), 1, v)
  end subroutine filtered

  ! Predicts z from the polynomial u of the last step, at theta = 1 + c h / last_h: to first order
  ! in brackets, exp(z) exp(u(1)) = exp(u(theta)) for z = dexp^-1_(-u(1)) (u(theta) - u(1)).
  subroutine predict(frame, series, transformation, c, h, newton)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: series            ! order up to which dexp^-1 is needed
    type(transformation_t), intent(in) :: transformation
    real(wp), intent(in) :: c(:), h                    ! c: (stages)
    type(newton_t), intent(inout) :: newton
    real(wp) :: powers(stages), back(size(newton%z, 1))
    logical :: exists
    integer :: d, i

    newton%z = 0.0_wp
    if (.not. abs(newton%last_h) > 0) return
    back = -newton%last_h * matmul(newton%last, sum(transformation%integral, dim=1))
    do i = 1, stages
      powers = [((1 + c(i) * h / newton%last_h)**d - 1, d = 1, stages)]
      newton%z(:, i) = newton%last_h * matmul(newton%last, matmul(powers, transformation%integral))
      call dexpinv(frame, series, back, newton%z(:, i), exists)
      if (.not. exists) newton%z(:, i) = 0.0_wp
    end do
  end subroutine predict

end module newton_m
