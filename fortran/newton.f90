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
!
! For implicit tableaux with one weight per flow the unknowns are the coefficients k_i at the stages,
!
!   k_i = f(t + c_i h, Y_i),   Y_i = exp(h a_is k_s) ... exp(h a_i1 k_1) y,
!
! whose corrections solve (I - h A (x) J) d = r, r_i = f(t + c_i h, Y_i) - k_i, where J is the
! Jacobian along the fields of the frame, as in B. Owren, B. Welfert, "The Newton iteration on Lie
! groups", BIT 40 (2000), 121-145. If A is lower triangular, the stages are solved one by one. The
! fixed-point iteration is d = r.
module newton_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use frames_m, only: frame_t
  use lapack_m, only: dgetrf, dgetrs, zgetrf, zgetrs
  use shared_numbers, only: factor_operation, solve_operation
  implicit none
  private
  public :: newton_t, transformation_t, correction, derivatives, factor, factor_blocks, filtered, &
            predict, reserve, solve_blocks

  integer, parameter :: stages = 3           ! of a collocation method that are implicit

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
    real(wp) :: residual = 0.0_wp            ! largest one of the last iteration
    logical :: fixed_point = .false.         ! whether the iteration needs no Jacobian
    real(wp) :: last_h = 0.0_wp              ! of the last step, 0 if the solution jumped after it
    real(wp), allocatable :: last(:, :)      ! (dimension, stages) derivatives in the last step
    real(wp), allocatable :: z(:, :)         ! (dimension, stages); residuals r of tableaux
    real(wp), allocatable :: jacobian(:, :)  ! (dimension, dimension), or no column
    real(wp), allocatable :: lu(:, :, :)     ! (unknowns, unknowns, blocks)
    complex(wp), allocatable :: complex_lu(:, :)
    integer, allocatable :: pivot(:, :), complex_pivot(:)
  end type newton_t

contains

  ! Allocates the memory of an iteration for an implicit tableau or, without one, a collocation
  ! method.
  subroutine reserve(n, dense, a, newton, memory)
    integer, intent(in) :: n                 ! dimension
    logical, intent(in) :: dense             ! whether matrices are stored here
    real(wp), allocatable, intent(in) :: a(:, :)       ! (stages, stages)
    type(newton_t), intent(inout) :: newton
    integer, intent(out) :: memory           ! nonzero if there isn't enough
    integer :: blocks, columns, s, unknowns, i

    columns = merge(n, 0, dense)
    if (.not. allocated(a)) then
      newton%sparse = .not. dense
      allocate (newton%last(n, stages), newton%z(n, stages), newton%jacobian(n, columns), &
                newton%lu(columns, columns, 1), newton%complex_lu(columns, columns), &
                newton%pivot(columns, 1), newton%complex_pivot(columns), stat=memory)
      return
    end if
    newton%fixed_point = .not. dense
    s = size(a, 1)
    blocks = merge(s, 1, all([(.not. abs(a(:i - 1, i)) > 0, i = 1, s)]))
    unknowns = columns * s / blocks
    allocate (newton%last(n, 0), newton%z(n, s), newton%jacobian(n, columns), &
              newton%lu(unknowns, unknowns, blocks), newton%pivot(unknowns, blocks), stat=memory)
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
      newton%lu(:, :, 1) = -newton%jacobian
      newton%complex_lu = cmplx(-newton%jacobian, kind=wp)
      do i = 1, size(newton%lu, 1)
        newton%lu(i, i, 1) = newton%lu(i, i, 1) + gamma
        newton%complex_lu(i, i) = newton%complex_lu(i, i) + cmplx(mu(1), mu(2), wp)
      end do
    end associate
    associate (n => size(newton%complex_pivot))
      call dgetrf(n, n, newton%lu, n, newton%pivot, info)
      if (info == 0) call zgetrf(n, n, newton%complex_lu, n, newton%complex_pivot, info)
    end associate
    singular = info /= 0
  end subroutine factor

  ! Factors the diagonal blocks of I - h A (x) J. A matrix that isn't finite counts as singular.
  subroutine factor_blocks(a, h, newton, singular)
    real(wp), intent(in) :: a(:, :), h       ! a: (stages, stages)
    type(newton_t), intent(inout) :: newton
    logical, intent(out) :: singular
    integer :: block, first, i, info, j

    newton%factored_h = h
    singular = .not. all(abs(newton%jacobian) <= huge(1.0_wp))
    associate (n => size(newton%jacobian, 1), unknowns => size(newton%lu, 1), lu => newton%lu)
      do block = 1, size(lu, 3)
        if (singular) return
        first = (block - 1) * unknowns / n
        do j = 1, unknowns / n
          do i = 1, unknowns / n
            lu((i - 1) * n + 1:i * n, (j - 1) * n + 1:j * n, block) = &
              -h * a(first + i, first + j) * newton%jacobian
          end do
        end do
        do i = 1, unknowns
          lu(i, i, block) = lu(i, i, block) + 1
        end do
        call dgetrf(unknowns, unknowns, lu(:, :, block), unknowns, newton%pivot(:, block), info)
        singular = info /= 0
      end do
    end associate
  end subroutine factor_blocks

  ! Solves (I - h A (x) J) d = r, or d = r, for the residuals r of an implicit tableau.
  subroutine solve_blocks(a, h, newton, d)
    real(wp), intent(in) :: a(:, :), h       ! a: (stages, stages)
    type(newton_t), intent(in) :: newton
    real(wp), contiguous, intent(out) :: d(:, :)       ! (dimension, stages)
    real(wp) :: known(size(d, 1))
    integer :: block, count, first, info, last

    d = newton%z
    if (newton%fixed_point) return
    count = size(d, 2) / size(newton%lu, 3)
    associate (unknowns => size(newton%lu, 1))
      do block = 1, size(newton%lu, 3)
        last = block * count
        first = last - count + 1
        if (first > 1) then                            ! with one stage in each block
          known = matmul(newton%jacobian, matmul(d(:, :first - 1), a(first, :first - 1)))
          d(:, first) = d(:, first) + h * known
        end if
        call dgetrs('N', unknowns, 1, newton%lu(:, :, block), unknowns, newton%pivot(:, block), &
                    d(:, first:last), unknowns, info)
      end do
    end associate
  end subroutine solve_blocks

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
    type(newton_t), intent(inout) :: newton
    real(wp), intent(out) :: dz(:, :)                  ! (dimension, stages)
    real(wp) :: d(size(f, 1), stages)

    call derivatives(transformation, h, newton%z, d)
    newton%residual = maxval(abs(f - d))
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

  ! Predicts z from the polynomial u of the last step, at theta = 1 + c h / last_h: to first order in
  ! brackets, exp(z) exp(u(1)) = exp(u(theta)) for z = dexp^-1_(-u(1)) (u(theta) - u(1)).
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
