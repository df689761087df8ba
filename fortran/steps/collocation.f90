! Collocation methods of three stages on a Lie algebra. The first column of f is the start of the
! step, which only the error estimate uses. Stages are solved by simplified Newton iteration:
! Hairer, Wanner, "Solving Ordinary Differential Equations II", IV.8. Their coordinates z_i solve
!
!   h sum_j a_ij F_j = z_i,   F_j = dexp^-1_(z_j) f(t + c_j h, exp(z_j) y),
!
! or A^-1 z / h = F. With A^-1 = T diag(gamma, mu) T^-1, where the complex mu stands for a block of
! two rows, and with the same Jacobian J for all stages the correction of z is T d, where
!
!   (gamma / h - J) d_1 = r_1,   (mu / h - J) (d_2 + i d_3) = r_2 + i r_3,
!   r = T^-1 (F - A^-1 z / h).
module collocation_m
  use kinds, only: wp
  use algebra_m, only: bracket, dexpinv
  use controller_m, only: max_iterations
  use coordinates_m, only: coordinate_sizes, error_norm, error_scales, tangent
  use frames_m, only: apply_flows
  use requests_m, only: reject_stage, request
  use phases_m, only: phase_column_received, phase_finish_step, phase_next_stage, &
                      phase_stage_received
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: copy, dgetrf, dgetrs, zgetrf, zgetrs
  use shared_numbers, only: differences_jacobian, factor_operation, jacobian_operation, &
                            outside_jacobian, raised, solve_operation, stages_not_solved, &
                            step_too_long
  implicit none
  private
  public :: converges_fast, damp_displacement, factor_again, keep_step, receive_collocation, &
            receive_column, request_collocation

  ! With equal steps the iteration goes on to the level of rounding: corrections below `rounding`
  ! end it, and those below `near_rounding` that no longer decrease, both relative to the point.
  real(wp), parameter :: rounding = 4 * epsilon(1.0_wp), near_rounding = epsilon(1.0_wp)**0.6_wp
  integer, parameter :: max_in_equal_steps = 50           ! iterations where steps are equal
  ! A Jacobian is used again if the corrections with it decreased by this factor.
  real(wp), parameter :: fast_rate = 1e-3_wp

contains

  ! Requests the coefficients at the next stage, or first a column of the Jacobian.
  subroutine request_collocation(x)
    type(trajectory_t), intent(inout) :: x
    logical :: singular

    if (x%collocation%iteration == 0) then
      x%f(:, 1) = x%slope
      if (.not. x%collocation%has_jacobian) then
        call request_jacobian(x)
        return
      end if
      if (abs(x%h - x%collocation%factored_h) > near_rounding * abs(x%h)) then
        call factor(x, x%h, singular)
        x%counts%nlu = x%counts%nlu + 2
        if (singular) then
          call retry_or_reject(x)
          return
        end if
      end if
      call predict_stages(x)
      ! As in RADAU5 the rate of the step before begins the estimate, to a power below one: with
      ! each step it counts less (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.8).
      x%collocation%rate_factor = max(x%collocation%rate_factor, epsilon(1.0_wp))**0.8_wp
      x%collocation%iteration = 1
      x%stage = 2
    end if
    call copy(x%frame%point_size, x%y(:, 0), x%y(:, x%result))
    call apply_flows(x%frame, 1, x%collocation%z(:, x%stage - 1), x%y(:, x%result))
    x%counts%nexp = x%counts%nexp + 1
    call request(x, x%t + x%method%c(x%stage) * x%h, x%y(:, x%result), phase_stage_received)
  end subroutine request_collocation

  ! Factors the matrices of a restored state again.
  subroutine factor_again(x)
    type(trajectory_t), intent(inout) :: x
    logical :: singular

    if (x%collocation%factored_h /= 0) call factor(x, x%collocation%factored_h, singular)
  end subroutine factor_again

  ! Stores the coefficients at a stage. After the last one follows a correction of all.
  subroutine receive_collocation(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    x%f(:, x%stage) = x%request%answer
    call dexpinv(x%frame, x%method%series, x%collocation%z(:, x%stage - 1), x%f(:, x%stage), exists)
    if (.not. exists) then
      call reject_stage(x, step_too_long, x%t)
      return
    end if
    x%stage = x%stage + 1
    x%phase = phase_next_stage
    if (x%stage > size(x%method%c)) call correct_stages(x)
  end subroutine receive_collocation

  ! Predicts z from the polynomial u of the last step, at theta = 1 + c h / last_h: to first order
  ! in brackets, exp(z) exp(u(1)) = exp(u(theta)) for z = dexp^-1_(-u(1)) (u(theta) - u(1)).
  subroutine predict_stages(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: powers(3), back(size(x%slope))
    logical :: exists
    integer :: d, i

    associate (newton => x%collocation, integral => x%method%transformation%integral)
      newton%z = 0.0_wp
      if (newton%h_before == 0) return
      back = -newton%h_before * matmul(newton%slopes_before, sum(integral, dim=1))
      do i = 1, 3
        powers = [((1 + x%method%c(1 + i) * x%h / newton%h_before)**d - 1, d = 1, 3)]
        newton%z(:, i) = newton%h_before * matmul(newton%slopes_before, matmul(powers, integral))
        call dexpinv(x%frame, x%method%series, back, newton%z(:, i), exists)
        if (.not. exists) newton%z(:, i) = 0.0_wp
      end do
    end associate
  end subroutine predict_stages

  ! Factors both matrices for a step size. Those that aren't finite count as singular.
  subroutine factor(x, h, singular)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: h
    logical, intent(out) :: singular
    real(wp) :: answer(1)
    integer :: i, info

    x%collocation%factored_h = h
    associate (newton => x%collocation, n => size(x%collocation%pivot), &
               gamma => x%method%transformation%gamma / h, mu => x%method%transformation%mu / h)
      if (x%problem%record%jacobian == outside_jacobian) then
        call x%frame%callback%apply(factor_operation, [real(x%member - 1, wp), gamma, mu], &
                                    [0.0_wp], answer)
        singular = .not. answer(1) <= 0
        return
      end if
      singular = .not. all(abs(newton%jacobian) <= huge(1.0_wp))
      if (singular) return
      newton%lu = -newton%jacobian
      newton%complex_lu = cmplx(-newton%jacobian, kind=wp)
      do i = 1, n
        newton%lu(i, i) = newton%lu(i, i) + gamma
        newton%complex_lu(i, i) = newton%complex_lu(i, i) + cmplx(mu(1), mu(2), wp)
      end do
      call dgetrf(n, n, newton%lu, n, newton%pivot, info)
      if (info == 0) call zgetrf(n, n, newton%complex_lu, n, newton%complex_pivot, info)
    end associate
    singular = info /= 0
  end subroutine factor

  ! Solves (gamma / h - J) x = b or, of two columns, (mu / h - J) (x_1 + i x_2) = b_1 + i b_2.
  subroutine solve(x, count, b)
    type(trajectory_t), intent(in) :: x
    integer, intent(in) :: count
    real(wp), intent(inout) :: b(size(x%slope), count)
    complex(wp) :: solution(size(x%slope))
    real(wp) :: solutions(size(b))
    integer :: info

    associate (newton => x%collocation, n => size(x%slope))
      if (x%problem%record%jacobian == outside_jacobian) then
        call x%frame%callback%apply(solve_operation, [real(x%member - 1, wp)], [b], solutions)
        b = reshape(solutions, shape(b))
      else if (count == 1) then
        call dgetrs('N', n, 1, newton%lu, n, newton%pivot, b, n, info)
      else
        solution = cmplx(b(:, 1), b(:, 2), wp)
        call zgetrs('N', n, 1, newton%complex_lu, n, newton%complex_pivot, solution, n, info)
        b(:, 1) = solution%re
        b(:, 2) = solution%im
      end if
    end associate
  end subroutine solve

  ! A^-1 z / h, the derivatives at the stages
  pure function slopes(x)
    type(trajectory_t), intent(in) :: x
    real(wp) :: slopes(size(x%slope), 3)

    slopes = matmul(x%collocation%z, transpose(x%method%transformation%inverse / x%h))
  end function slopes

  ! Applies (1 - h J / gamma)^-1 to the displacement by an error, which damps fast components.
  subroutine damp_displacement(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: v(size(x%slope))

    v = x%norms%displacement * (x%method%transformation%gamma / x%collocation%factored_h)
    call solve(x, 1, v)
    x%norms%displacement = v
  end subroutine damp_displacement

  ! Corrects the coordinates of the stages, and decides whether they are accurate.
  subroutine correct_stages(x)
    type(trajectory_t), intent(inout) :: x
    real(wp), dimension(size(x%slope), 3) :: d, dz     ! dz: corrections of z; d: T^-1 dz
    real(wp) :: correction, tolerance
    integer :: remaining
    logical :: slow, solved

    associate (newton => x%collocation, rtol => x%tolerances%rtol)
      d = x%f(:, 2:) - slopes(x)
      d = matmul(d, transpose(x%method%transformation%t_inverse))
      call solve(x, 1, d(:, 1))
      call solve(x, 2, d(:, 2:3))
      dz = matmul(d, transpose(x%method%transformation%t))
      remaining = merge(max_iterations, max_in_equal_steps, x%problem%adaptive) - newton%iteration
      ! as in RADAU5, for the error of Newton's method in tolerances
      tolerance = rounding
      if (x%problem%adaptive) tolerance = max(10 * epsilon(rtol) / max(rtol, epsilon(rtol)), &
                                              min(0.03_wp, sqrt(rtol)))
      correction = correction_norm(x, dz)
      slow = .not. correction <= huge(1.0_wp)
      solved = correction <= 0
      if (newton%iteration > 1) then
        newton%rate = correction / newton%correction
        slow = slow .or. newton%rate >= 1
        if (.not. slow) then
          newton%rate_factor = newton%rate / (1 - newton%rate)
          slow = newton%rate**remaining * correction / (1 - newton%rate) > tolerance
        end if
        if (.not. x%problem%adaptive .and. slow .and. correction <= near_rounding) solved = .true.
      end if
      solved = solved .or. newton%rate_factor * correction <= tolerance .and. .not. slow
      newton%correction = correction
      if (solved) then
        newton%z = newton%z + dz
        x%f(:, 2:) = slopes(x)
        x%phase = phase_finish_step
      else if (slow .or. remaining == 0) then
        call retry_or_reject(x)
      else
        newton%z = newton%z + dz
        newton%iteration = newton%iteration + 1
        x%stage = 2
      end if
    end associate
  end subroutine correct_stages

  ! The norm of a correction: in tolerances, or relative to the point where there are none
  real(wp) function correction_norm(x, dz)
    type(trajectory_t), intent(inout) :: x
    real(wp), contiguous, intent(in) :: dz(:, :)       ! (dimension, stages)
    real(wp), allocatable :: magnitudes(:)             ! (dimension)
    integer :: i

    if (.not. x%problem%adaptive) then
      allocate (magnitudes(size(dz, 1)))
      call coordinate_sizes(x%frame, x%y(:, 0), magnitudes)
      correction_norm = abs(sum(dz))       ! NaN if an entry is, which maxval leaves out
      if (all(abs(dz) <= huge(dz))) correction_norm = maxval(abs(dz)) &
        / max(maxval(magnitudes), maxval(abs(x%collocation%z + dz)), tiny(1.0_wp))
      return
    end if
    call error_scales(x%frame, x%tolerances, x%y(:, 0), x%y(:, 0), x%norms%change, x%norms%scale)
    correction_norm = 0.0_wp
    do i = 1, size(dz, 2)
      call tangent(x%frame, x%tolerances, dz(:, i), x%y(:, 0), x%norms%difference)
      correction_norm = hypot(correction_norm, &
                              error_norm(x%tolerances, x%norms%difference, x%norms%scale))
    end do
    correction_norm = correction_norm / sqrt(real(size(dz, 2), wp))
  end function correction_norm

  ! Tries again with a fresh Jacobian, or with a smaller step if the Jacobian is fresh already.
  subroutine retry_or_reject(x)
    type(trajectory_t), intent(inout) :: x

    x%collocation%rate_factor = 1.0_wp
    x%request%detail = x%collocation%iteration
    if (x%collocation%fresh) then
      call reject_stage(x, stages_not_solved, x%t)
    else
      x%collocation%has_jacobian = .false.
      x%collocation%iteration = 0
      x%phase = phase_next_stage
    end if
  end subroutine retry_or_reject

  ! Requests the Jacobian of dexp^-1_u f(exp(u) y) at u = 0, from Python or by differences.
  subroutine request_jacobian(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: answer(max(1, size(x%collocation%jacobian)))
    logical :: failed

    x%counts%njev = x%counts%njev + 1
    if (x%problem%record%jacobian == differences_jacobian) then
      call find_displacements(x, x%collocation%z(:, 1))  ! z is free until the Jacobian is complete
      x%collocation%column = 1
      call request_column(x)
      return
    end if
    call x%frame%callback%apply(jacobian_operation, [x%t, real(x%member - 1, wp), x%slope], &
                                x%y(:, 0), answer, failed)
    if (failed) then
      call fail(x, raised, x%t)
      return
    end if
    x%collocation%jacobian = reshape(answer(:size(x%collocation%jacobian)), &
                                     shape(x%collocation%jacobian))
    if (x%problem%record%jacobian /= outside_jacobian) call add_derivative_of_dexpinv(x)
    call finish_jacobian(x)
  end subroutine request_jacobian

  ! Computes displacements for differences, relative to coordinates, however small, so that the unit
  ! of the point makes no difference, or to the absolute tolerance where that is larger, since
  ! smaller changes may have no digits in f. A coordinate of zero without one has the size that its
  ! slope gives it within a step. Coordinates that aren't controlled share their largest size.
  subroutine find_displacements(x, d)
    type(trajectory_t), intent(in) :: x
    real(wp), contiguous, intent(out) :: d(:)          ! (dimension)

    call coordinate_sizes(x%frame, x%y(:, 0), d)
    if (x%problem%adaptive .and. x%tolerances%in_coordinates) &
      d = max(d, merge(maxval(d, not_controlled(x)), x%tolerances%atol, not_controlled(x)))
    where (.not. d > 0) d = abs(x%h * x%slope)
    where (.not. d > 0) d = merge(maxval(d), 1.0_wp, maxval(d) > 0)
    d = sqrt(epsilon(1.0_wp)) * d
  end subroutine find_displacements

  ! The coordinates whose errors aren't controlled, such as derivatives of a solution
  pure function not_controlled(x)
    type(trajectory_t), intent(in) :: x
    logical :: not_controlled(x%frame%dimension)

    not_controlled = .false.
    if (x%problem%adaptive .and. x%tolerances%in_coordinates) &
      not_controlled = x%tolerances%atol > huge(1.0_wp)
  end function not_controlled

  ! Requests the coefficients at a point displaced along a field of the frame.
  subroutine request_column(x)
    type(trajectory_t), intent(inout) :: x

    x%v(:, 1) = 0.0_wp
    x%v(x%collocation%column, 1) = x%collocation%z(x%collocation%column, 1)
    call copy(x%frame%point_size, x%y(:, 0), x%y(:, x%result))
    call apply_flows(x%frame, 1, x%v, x%y(:, x%result))
    x%counts%nexp = x%counts%nexp + 1
    call request(x, x%t, x%y(:, x%result), phase_column_received)
  end subroutine request_column

  ! Stores a column of the Jacobian, with zeros where coordinates that aren't controlled depend on
  ! others: for derivatives of a solution these would be second differences, which have no digits.
  subroutine receive_column(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists, uncontrolled(size(x%slope))

    associate (newton => x%collocation, column => x%collocation%column, series => x%method%series)
      newton%jacobian(:, column) = x%request%answer
      call dexpinv(x%frame, series, x%v(:, 1), newton%jacobian(:, column), exists)
      newton%jacobian(:, column) = (newton%jacobian(:, column) - x%slope) / newton%z(column, 1)
      uncontrolled = not_controlled(x)
      if (.not. uncontrolled(column)) &
        newton%jacobian(:, column) = merge(0.0_wp, newton%jacobian(:, column), uncontrolled)
      column = column + 1
      if (column <= size(newton%jacobian, 2)) then
        call request_column(x)
      else
        call finish_jacobian(x)
      end if
    end associate
  end subroutine receive_column

  ! Adds the derivative of dexp^-1_u f at u = 0, -[u, f] / 2.
  subroutine add_derivative_of_dexpinv(x)
    type(trajectory_t), intent(inout) :: x
    real(wp), dimension(size(x%slope)) :: u, change
    integer :: j

    do j = 1, size(u)
      u = 0.0_wp
      u(j) = -0.5_wp
      call bracket(x%frame, u, x%slope, change)
      x%collocation%jacobian(:, j) = x%collocation%jacobian(:, j) + change
    end do
  end subroutine add_derivative_of_dexpinv

  ! Marks the Jacobian as fresh and as not factored.
  subroutine finish_jacobian(x)
    type(trajectory_t), intent(inout) :: x

    x%collocation%has_jacobian = .true.
    x%collocation%fresh = .true.
    x%collocation%factored_h = 0.0_wp
    x%phase = phase_next_stage
  end subroutine finish_jacobian

  ! Whether the Jacobian of a step serves the next one
  pure logical function converges_fast(x)
    type(trajectory_t), intent(in) :: x

    converges_fast = x%collocation%iteration <= 2 .or. x%collocation%rate <= fast_rate
  end function converges_fast

  ! Keeps the polynomial of an accepted step for the next one, and its Jacobian if it served well.
  pure subroutine keep_step(x)
    type(trajectory_t), intent(inout) :: x

    x%collocation%slopes_before = x%f(:, 2:)
    x%collocation%h_before = x%h
    x%collocation%fresh = .false.
    x%collocation%replaced = .false.
    x%collocation%has_jacobian = converges_fast(x)
  end subroutine keep_step

end module collocation_m
