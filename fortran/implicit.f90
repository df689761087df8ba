! The stages of implicit methods, by the iterations of newton_m. The first stage of a collocation
! method on a Lie algebra is the start of the step, which only the error estimate uses; all others
! are implicit.
module implicit_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use controller_m, only: max_iterations
  use coordinates_m, only: sizes
  use error_norm_m, only: norm, scales, tangent
  use frames_m, only: flow_along, frame_t
  use method_m, only: method_t
  use newton_m, only: correction, derivatives, factor, factor_blocks, newton_t, predict, &
                      solve_blocks
  use requests_m, only: reject_stage, request
  use phases_m
  use trajectory_m, only: copy, fail, problem_t, trajectory_t
  use shared_numbers, only: jacobian_operation, raised, stages_not_solved
  implicit none
  private
  public :: converges_fast, correct_stages, keep_step, prepare_iteration, refactor, store_column

  ! With equal steps the iteration goes on to the level of rounding: corrections below `rounding`
  ! end it, and those below `noise` that no longer decrease, both relative to the point.
  real(wp), parameter :: rounding = 4 * epsilon(1.0_wp), noise = epsilon(1.0_wp)**0.6_wp
  integer, parameter :: max_rounds = 100
  ! A Jacobian is used again if the corrections with it decreased by this factor.
  real(wp), parameter :: fast_rate = 1e-3_wp

contains

  ! Starts the iteration of a step, or requests the first column of the Jacobian.
  subroutine prepare_iteration(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: singular

    associate (x => trajectory, newton => trajectory%newton, method => problem%method)
      newton%member = x%member
      if (.not. newton%fixed_point) then
        if (.not. newton%has_jacobian) then
          call request_jacobian(problem, trajectory)
          return
        end if
        if (abs(x%h - newton%factored_h) > noise * abs(x%h)) then
          call factor_matrices(problem%frame, method, x%h, newton, singular)
          x%nlu = x%nlu + 1
          if (method%collocation) x%nlu = x%nlu + 1
          if (singular) then
            call give_up(problem, trajectory)
            return
          end if
        end if
      end if
      if (method%collocation) then
        x%f(:, 1) = x%slope
        call predict(problem%frame, method%series, method%transformation, method%c(2:), x%h, newton)
      else
        x%f = spread(x%slope, 2, size(x%f, 2))
        newton%z = 0.0_wp
      end if
      newton%rate_factor = max(newton%rate_factor, epsilon(1.0_wp))**0.8_wp
      newton%iteration = 1
      x%stage = merge(2, 1, method%collocation)
    end associate
  end subroutine prepare_iteration

  ! Factors the matrices of the iteration for a step size.
  subroutine factor_matrices(frame, method, h, newton, singular)
    type(frame_t), intent(in) :: frame
    type(method_t), intent(in) :: method
    real(wp), intent(in) :: h
    type(newton_t), intent(inout) :: newton
    logical, intent(out) :: singular

    if (method%collocation) then
      call factor(frame, method%transformation, h, newton, singular)
    else
      call factor_blocks(method%matrix, h, newton, singular)
    end if
  end subroutine factor_matrices

  ! Factors the matrices of a restored state again.
  subroutine refactor(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: singular

    if (.not. abs(trajectory%newton%factored_h) > 0) return
    trajectory%newton%member = trajectory%member
    call factor_matrices(problem%frame, problem%method, trajectory%newton%factored_h, &
                         trajectory%newton, singular)
  end subroutine refactor

  ! Corrects the coordinates of the stages, and decides whether they are accurate.
  subroutine correct_stages(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    ! change and new values of the coordinates of the stages; those of tableaux are h k
    real(wp), dimension(size(trajectory%newton%z, 1), size(trajectory%newton%z, 2)) :: dz, z
    real(wp) :: size_of, tolerance
    integer :: remaining
    logical :: slow, solved

    associate (x => trajectory, newton => trajectory%newton, method => problem%method)
      if (method%collocation) then
        call correction(problem%frame, method%transformation, x%h, x%f(:, 2:), newton, dz)
        z = newton%z + dz
      else
        newton%residual = maxval(abs(newton%z))
        call solve_blocks(method%matrix, x%h, newton, dz)
        x%f = x%f + dz
        dz = x%h * dz
        z = x%h * x%f
      end if
      remaining = merge(max_iterations, max_rounds, problem%adaptive) - newton%iteration
      tolerance = rounding
      if (problem%adaptive) tolerance = newton_tolerance(problem%tolerances%rtol)
      size_of = correction_norm(problem, trajectory, dz, z)
      slow = .not. size_of <= huge(1.0_wp)
      solved = .not. size_of > 0
      if (newton%iteration > 1) then
        newton%rate = size_of / newton%norm
        slow = slow .or. newton%rate >= 1
        if (.not. slow) then
          newton%rate_factor = newton%rate / (1 - newton%rate)
          slow = newton%rate**remaining * size_of / (1 - newton%rate) > tolerance
        end if
        if (.not. problem%adaptive .and. slow .and. size_of <= noise) solved = .true.
      end if
      newton%norm = size_of
      ! symmetric methods keep invariants only as accurately as their stages are solved
      if (problem%adaptive .or. method%collocation) size_of = newton%rate_factor * size_of
      solved = solved .or. size_of <= tolerance .and. .not. slow
      if (.not. solved .and. (slow .or. remaining == 0)) then
        call give_up(problem, trajectory)
        return
      end if
      if (method%collocation) newton%z = z
      x%paths = 0
      if (solved) then
        if (method%collocation) call derivatives(method%transformation, x%h, z, x%f(:, 2:))
        x%phase = phase_finish_step
      else
        newton%iteration = newton%iteration + 1
        x%stage = merge(2, 1, method%collocation)
      end if
    end associate
  end subroutine correct_stages

  ! The largest error of the iteration, in tolerances
  pure real(wp) function newton_tolerance(rtol)
    real(wp), intent(in) :: rtol

    newton_tolerance = max(10 * epsilon(1.0_wp) / max(rtol, epsilon(1.0_wp)), &
                           min(0.03_wp, sqrt(rtol)))
  end function newton_tolerance

  ! The norm of a correction: in tolerances, or relative to the point where there are none
  real(wp) function correction_norm(problem, trajectory, dz, z)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: dz(:, :), z(:, :)        ! (dimension, stages)
    integer :: i

    associate (x => trajectory, frame => problem%frame, tolerances => problem%tolerances)
      if (.not. problem%adaptive) then
        call sizes(frame, x%y(:, 0), x%u)
        correction_norm = maxval(abs(dz)) / max(maxval(x%u), maxval(abs(z)), tiny(1.0_wp))
        return
      end if
      call scales(frame, tolerances, x%y(:, 0), x%y(:, 0), x%work, x%scale)
      correction_norm = 0.0_wp
      do i = 1, size(dz, 2)
        call tangent(frame, tolerances, dz(:, i), x%y(:, 0), x%v)
        correction_norm = hypot(correction_norm, norm(tolerances, x%v, x%scale))
      end do
      correction_norm = correction_norm / sqrt(real(size(dz, 2), wp))
    end associate
  end function correction_norm

  ! Tries again with the Jacobian of the present point, or else with a smaller step.
  subroutine give_up(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory, newton => trajectory%newton)
      newton%rate_factor = 1.0_wp
      x%flag = newton%iteration
      if (newton%fresh .or. newton%fixed_point) then
        call reject_stage(problem, trajectory, stages_not_solved, x%t)
      else
        newton%has_jacobian = .false.
        newton%iteration = 0
        x%phase = phase_next_stage
      end if
    end associate
  end subroutine give_up

  ! Requests the Jacobian of dexp^-1_u f(exp(u) y) at u = 0, from Python or by differences.
  subroutine request_jacobian(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp) :: answer(max(1, size(trajectory%newton%jacobian)))

    associate (x => trajectory, newton => trajectory%newton)
      x%njev = x%njev + 1
      if (.not. problem%has_jacobian) then
        call sizes(problem%frame, x%y(:, 0), newton%z(:, 1))
        newton%z(:, 1) = sqrt(epsilon(1.0_wp) * max(newton%z(:, 1), 1e-5_wp))
        newton%column = 1
        call request_column(problem, trajectory)
        return
      end if
      answer = -huge(1.0_wp)
      call problem%frame%callback%apply(jacobian_operation, &
                                         [x%t, real(x%member - 1, wp), x%slope], x%y(:, 0), answer)
      if (.not. all(abs(answer) < huge(1.0_wp))) then
        call fail(x, raised, x%t)
        return
      end if
      newton%jacobian = reshape(answer(:size(newton%jacobian)), shape(newton%jacobian))
      if (.not. newton%sparse) call add_brackets(problem, trajectory)
      call finish_jacobian(trajectory)
    end associate
  end subroutine request_jacobian

  ! Requests the coefficients at a point displaced along a field of the frame.
  subroutine request_column(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory, column => trajectory%newton%column)
      x%u = 0.0_wp
      x%u(column) = x%newton%z(column, 1)
      call copy(problem%frame%point_size, x%y(:, 0), x%y(:, x%result))
      call flow_along(problem%frame, x%u, x%y(:, x%result))
      x%nexp = x%nexp + 1
      call request(problem, trajectory, x%t, x%y(:, x%result), phase_column_received)
    end associate
  end subroutine request_column

  ! Stores a column of the Jacobian.
  subroutine store_column(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    logical :: exists

    associate (x => trajectory, newton => trajectory%newton, column => trajectory%newton%column)
      x%u = 0.0_wp
      x%u(column) = newton%z(column, 1)
      newton%jacobian(:, column) = x%received
      if (problem%method%on_algebra) call dexpinv(problem%frame, problem%method%series, x%u, &
                                                  newton%jacobian(:, column), exists)
      newton%jacobian(:, column) = (newton%jacobian(:, column) - x%slope) / newton%z(column, 1)
      column = column + 1
      if (column <= size(newton%jacobian, 2)) then
        call request_column(problem, trajectory)
      else
        call finish_jacobian(trajectory)
      end if
    end associate
  end subroutine store_column

  ! Adds the derivative of dexp^-1_u f at u = 0, which is the only odd term of the series.
  subroutine add_brackets(problem, trajectory)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), dimension(size(trajectory%u)) :: ahead, behind
    logical :: exists
    integer :: j

    associate (x => trajectory)
      do j = 1, size(x%u)
        x%u = 0.0_wp
        x%u(j) = 1.0_wp
        ahead = x%slope
        behind = x%slope
        call dexpinv(problem%frame, problem%method%series, x%u, ahead, exists)
        x%u(j) = -1.0_wp
        call dexpinv(problem%frame, problem%method%series, x%u, behind, exists)
        x%newton%jacobian(:, j) = x%newton%jacobian(:, j) + (ahead - behind) / 2
      end do
    end associate
  end subroutine add_brackets

  subroutine finish_jacobian(trajectory)
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%newton%has_jacobian = .true.
    trajectory%newton%fresh = .true.
    trajectory%newton%factored_h = 0.0_wp
    trajectory%phase = phase_next_stage
  end subroutine finish_jacobian

  ! Whether the Jacobian of a step serves the next one
  pure logical function converges_fast(trajectory)
    type(trajectory_t), intent(in) :: trajectory

    converges_fast = trajectory%newton%iteration <= 2 .or. trajectory%newton%rate <= fast_rate
  end function converges_fast

  ! Keeps the polynomial of an accepted step for the next one, and its Jacobian if it served well.
  pure subroutine keep_step(trajectory)
    type(trajectory_t), intent(inout) :: trajectory

    associate (x => trajectory, newton => trajectory%newton)
      if (size(newton%last) > 0) newton%last = x%f(:, 2:)
      newton%last_h = x%h
      newton%fresh = .false.
      newton%has_jacobian = converges_fast(x)
    end associate
  end subroutine keep_step

end module implicit_m
