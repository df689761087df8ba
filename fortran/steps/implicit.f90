! The stage equations of implicit Crouch-Grossman methods (one weight per flow), k_i = f(t + c_i h,
! Y_i(k)) with Y_i(k) = exp(h a_is k_s) ... exp(h a_i1 k_1) y. The unknowns are the coefficients at
! the stages, which lie in a linear space whatever the manifold is.
!
! If A is lower triangular, each stage is a block of its own, solved after those before it;
! otherwise all stages are one block. The fixed-point iteration repeats the equation. Newton's
! method takes the Jacobian of k - f(Y(k)) by differences along the flows, as in B. Owren, B.
! Welfert, "The Newton iteration on Lie groups", BIT 40 (2000), 121-145, but with the derivative of
! the exponential inside the difference. It keeps its factors, also over several steps of the same
! size, as long as corrections decrease by a factor of ten. Both iterate down to the level of
! rounding, since invariants are preserved as accurately as stages are solved.
module implicit_m
  use kinds, only: wp
  use coordinates_m, only: coordinate_sizes
  use vectors_m, only: dgetrf, dgetrs
  use paths_m, only: request_on_path
  use requests_m, only: reject_stage
  use phases_m, only: phase_finish_step, phase_next_stage
  use trajectory_m, only: trajectory_t
  use shared_numbers, only: fixed_point_limit, newton_limit, stages_not_solved
  implicit none
  private
  public :: request_implicit, receive_implicit

  real(wp), parameter :: rounding = 1e-10_wp   ! corrections below it may be rounding errors of f
  real(wp), parameter :: max_rate = 0.1_wp     ! of corrections, above which factors are replaced
  real(wp), parameter :: max_residual_growth = 1e3_wp    ! above which an iteration diverges

contains

  ! Requests the coefficients at the next stage. With the first one the first block starts.
  subroutine request_implicit(x)
    type(trajectory_t), intent(inout) :: x

    if (x%implicit%first_stage == 0) then
      x%f = spread(x%slope, 2, size(x%f, 2))
      x%implicit%last_stage = 0
      call next_block(x)
      if (x%phase == phase_finish_step) return
    end if
    call request_on_path(x)
  end subroutine request_implicit

  ! Starts the next block whose coefficients aren't those at the start, or finishes the step.
  subroutine next_block(x)
    type(trajectory_t), intent(inout) :: x

    associate (solver => x%implicit, stages => size(x%method%c))
      if (solver%last_stage > 0) call rewind_paths(x)
      do
        solver%first_stage = solver%last_stage + 1
        if (solver%first_stage > stages) exit
        solver%last_stage = solver%last_stage + stages / x%method%blocks
        if (solver%first_stage < solver%last_stage) exit
        if (x%method%stage_path(solver%first_stage) > 0) exit
      end do
      solver%iteration = 1
      solver%column = 0
      solver%correction = huge(1.0_wp)
      solver%min_residual = huge(1.0_wp)
      x%stage = solver%first_stage
      x%phase = merge(phase_finish_step, phase_next_stage, solver%first_stage > stages)
    end associate
  end subroutine next_block

  ! Returns to the first stage of the block. If it is the only one, only its path is followed again.
  pure subroutine rewind_paths(x)
    type(trajectory_t), intent(inout) :: x

    x%stage = x%implicit%first_stage
    x%paths_followed = 0
    if (x%method%blocks > 1 .and. .not. x%problem%record%of_time) &
      x%paths_followed = max(x%method%stage_path(x%stage) - 1, 0)
  end subroutine rewind_paths

  ! Stores the coefficients at a stage; the last one of a block leads on to a correction or column.
  subroutine receive_implicit(x)
    type(trajectory_t), intent(inout) :: x
    integer :: block, flow, info, row

    associate (solver => x%implicit, n => size(x%f, 1), method => x%method)
      block = merge(solver%first_stage, 1, method%blocks > 1)
      if (method%blocks > 1) then
        flow = method%path_first(method%stage_path(x%stage) + 1) - 1     ! the last one to its point
        if (method%flows%stage(method%flows%first(flow)) /= x%stage) then      ! explicit
          x%f(:, x%stage) = x%request%answer
          call next_block(x)
          return
        end if
      end if
      if (solver%column == 0) then
        solver%value(:, x%stage) = x%request%answer
      else
        row = (x%stage - solver%first_stage) * n
        solver%lu(row + 1:row + n, solver%column, block) = &
          (solver%value(:, x%stage) - x%request%answer) / solver%displacement
      end if
      x%stage = x%stage + 1
      x%phase = phase_next_stage
      if (x%stage <= solver%last_stage) return
      call rewind_paths(x)
      call prepare_correction(x, block, info)
      if (info /= 0) then
        call reject_block(x, block)
      else if (solver%column > 0) then
        call displace_unknown(x)
      else
        call correct(x, block)
      end if
    end associate
  end subroutine receive_implicit

  ! Goes on to the next column of the Jacobian, or factors it: column 0 means that it is.
  subroutine prepare_correction(x, block, info)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: block
    integer, intent(out) :: info             ! nonzero if the matrix is singular

    info = 0
    associate (solver => x%implicit, n => size(x%f, 1))
      if (solver%column > 0) then
        x%f(1 + mod(solver%column - 1, n), solver%first_stage + &
            (solver%column - 1) / n) = solver%undisplaced
        solver%column = solver%column + 1
      else if (.not. (solver%fixed_point .or. solver%factored_h(block) == x%h)) then
        x%counts%njev = x%counts%njev + 1
        solver%column = 1
        solver%factored_h(block) = 0.0_wp              ! columns overwrite the factors
      end if
      if (solver%column <= size(solver%lu, 1)) return
      call factor(solver%lu(:, :, block), solver%pivot(:, block), info)
      x%counts%nlu = x%counts%nlu + 1
      solver%factored_h(block) = x%h
      solver%column = 0
    end associate
  end subroutine prepare_correction

  ! Displaces the unknown of a column of the Jacobian.
  subroutine displace_unknown(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: scale(size(x%f, 1))

    associate (solver => x%implicit, i => 1 + mod(x%implicit%column - 1, size(x%f, 1)), &
               stage => x%implicit%first_stage + (x%implicit%column - 1) / size(x%f, 1))
      call scale_of(x, x%f(:, stage), scale)
      solver%undisplaced = x%f(i, stage)
      x%f(i, stage) = solver%undisplaced + sqrt(epsilon(1.0_wp)) * scale(i)
      solver%displacement = x%f(i, stage) - solver%undisplaced
    end associate
  end subroutine displace_unknown

  ! The scale of coefficients: their moduli, at least what moves coordinates by their own size
  subroutine scale_of(x, k, scale)
    type(trajectory_t), intent(in) :: x
    real(wp), contiguous, intent(in) :: k(:)           ! (dimension)
    real(wp), contiguous, intent(out) :: scale(:)      ! (dimension)

    call coordinate_sizes(x%frame, x%y(:, 0), scale)
    scale = max(abs(k), scale / abs(x%h))
    where (.not. scale > 0) scale = merge(maxval(scale), 1.0_wp, maxval(scale) > 0)
  end subroutine scale_of

  ! Adds the identity to a matrix and factors it.
  subroutine factor(matrix, pivot, info)
    real(wp), contiguous, intent(inout) :: matrix(:, :)
    integer, contiguous, intent(inout) :: pivot(:)
    integer, intent(out) :: info
    integer :: i

    info = 1
    if (.not. all(abs(matrix) <= huge(1.0_wp))) return
    do i = 1, size(pivot)
      matrix(i, i) = matrix(i, i) + 1
    end do
    call dgetrf(size(pivot), size(pivot), matrix, size(pivot), pivot, info)
  end subroutine factor

  ! Corrects the unknowns of a block, and goes on to the next one if the correction is rounding.
  subroutine correct(x, block)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: block
    real(wp) :: d(size(x%f, 1), x%implicit%first_stage:x%implicit%last_stage)      ! the corrections
    real(wp) :: scale(size(x%f, 1)), correction        ! correction: the largest one, relative
    integer :: i, info, max_iterations

    associate (solver => x%implicit, first => x%implicit%first_stage, last => x%implicit%last_stage)
      d = solver%value(:, first:last) - x%f(:, first:last)
      solver%residual = maxval(abs(d))
      if (.not. solver%fixed_point) call dgetrs('N', size(d), 1, solver%lu(:, :, block), size(d), &
                                                solver%pivot(:, block), d, size(d), info)
      if (.not. all(abs(d) <= huge(d))) then       ! max and maxval leave out NaN
        call reject_block(x, block)
        return
      end if
      correction = 0.0_wp
      do i = first, last
        x%f(:, i) = x%f(:, i) + d(:, i)
        call scale_of(x, x%f(:, i), scale)
        correction = max(correction, maxval(abs(d(:, i)) / scale))
      end do
      if (correction <= epsilon(1.0_wp) &
          .or. (solver%correction <= correction .and. correction <= rounding)) then
        call next_block(x)
        return
      end if
      max_iterations = merge(fixed_point_limit, newton_limit, solver%fixed_point)
      if (.not. solver%residual <= max_residual_growth * solver%min_residual &
          .or. solver%iteration == max_iterations) then
        call reject_block(x, block)
        return
      end if
      if (correction > max(max_rate * solver%correction, rounding)) &
        solver%factored_h(block) = 0.0_wp
      solver%correction = correction
      solver%min_residual = min(solver%min_residual, solver%residual)
      solver%iteration = solver%iteration + 1
    end associate
  end subroutine correct

  ! Rejects the step, and forgets the factors of the block that wasn't solved.
  subroutine reject_block(x, block)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: block

    x%implicit%factored_h(block) = 0.0_wp
    x%request%detail = x%implicit%iteration
    call reject_stage(x, stages_not_solved, x%t)
  end subroutine reject_block

end module implicit_m
