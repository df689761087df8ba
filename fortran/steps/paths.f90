! The ends of the paths of method_t: y_path = exp(h sum_k weight_k f_stage(k)) ... y_origin, by
! flows of the frame, the flow of the lowest stage first. Kinds of methods differ:
!
! Explicit stages: each point is reached from coefficients that are known. On the Lie algebra
! coefficients become derivatives of the coordinates u of a point, y = exp(u) y_0. Methods of two
! registers (cg/construction/methods/low_storage.py) have Z_i = a_i Z_(i-1) + f_i and y_i =
! exp(h b_i Z_i) y_(i-1), with the register Z in place of coefficients at stages, and y_i in place
! of the ends of paths; the last y_i is the result.
!
! RATTLE (H. C. Andersen, J. Comput. Phys. 52 (1983)): kicks and drifts of mechanical systems with
! joints. Impulses along the derivatives G of constraints before each drift close them at its end:
! g(q_1) = 0 for q_1 = drift_h(q_0, mu_0 + h k F + G(q_0)^T lambda). They are found by Broyden's
! method from lambda <- lambda - (h G J^-1 G^T)^-1 g(q_1) at q_0, where the factor also removes what
! opens the joints from the momentum at the end of a step. It starts from impulses that continue
! those of the two steps before. Between the drifts of a step nothing has to be removed, since the
! next impulses would replace it. The drift is the exact free motion of the bodies.
!
! With a heat bath the drift in the middle of a step is two halves, between which momenta exchange
! heat; what opens the joints is removed from them and from the noise, in the metric of J^-1.
module paths_m
  use, intrinsic :: iso_fortran_env, only: int64
  use algebra_m, only: bracket, dexpinv
  use blocks_m, only: combine_flows
  use frames_m, only: apply_flows, restore
  use free_motion_m, only: constraints_at, drift, is_closed, remove_opening
  use heat_bath_m, only: exchange_heat
  use joints_m, only: constraint_impulse, evaluate_constraints, solve_constraints
  use kinds, only: wp
  use linear_action_m, only: move_polynomially
  use requests_m, only: reject_stage, request
  use shared_numbers, only: algebra_kind, joints_not_solved, no_stop, polynomial_kind, &
                            registers_kind, splitting_kind, step_too_long
  use phases_m, only: phase_next_stage, phase_stage_received
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: copy
  implicit none
  private
  public :: find_brackets, follow_paths, request_on_path, start_explicit, receive_explicit

contains

  ! Follows a path of a splitting method: a kick, then a drift, or at the end of a step none. With a
  ! bath momenta exchange heat in the middle of the step, which divides a drift or a kick.
  subroutine move_by_splitting(x, path, y)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size) its start, then its end
    real(wp) :: parts(2)                     ! shares of kick and drift before the middle
    integer :: middle                        ! the path with the middle of the step

    middle = size(x%method%origin) - size(x%method%c) / 2
    if (.not. x%problem%record%heated .or. path /= middle) then
      call move_part(x, path, [1.0_wp, 1.0_wp], y)
      return
    end if
    parts = [1.0_wp, 0.5_wp]                 ! the middle is in a drift
    if (modulo(size(x%method%c), 2) == 1) parts = [0.5_wp, 0.0_wp]           ! it is in a kick
    call move_part(x, path, parts, y)
    if (x%status /= no_stop) return
    associate (momenta => y(x%frame%momenta_offset + 1:))
      if (x%frame%jointed) call remove_opening(x%frame, x%joints%constraints, momenta)
      call exchange_heat(x%problem%record, x%frame, x%member, x%t, x%h, y)
      if (x%frame%jointed) call remove_opening(x%frame, x%joints%constraints, momenta)
    end associate
    call move_part(x, path, 1 - parts, y)
  end subroutine move_by_splitting

  ! Moves a point by parts of the kick and of the drift of a path.
  subroutine move_part(x, path, parts, y)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path
    real(wp), intent(in) :: parts(2)                   ! shares of kick and drift
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)
    integer :: k

    if (x%frame%jointed) call find_constraints(x, y)
    if (x%status /= no_stop) return
    associate (m => x%frame%forces, flows => x%method%flows, flow => x%method%path_first(path), &
               time => parts(2) * (x%h * x%method%scheme%drift(x%method%path_first(path))), &
               momenta => y(x%frame%momenta_offset + 1:))      ! momenta and tangents
      do k = flows%first(flow), flows%first(flow + 1) - 1
        momenta = momenta + (parts(1) * x%weight(k)) * x%f(m + 1:, flows%stage(k))
      end do
      if (x%frame%jointed .and. time /= 0) then
        call drift_closed(x, time, path, y)
      else if (x%frame%jointed) then
        call remove_opening(x%frame, x%joints%constraints, momenta)
      else if (time /= 0) then
        call drift(x%frame, time, y)
      end if
    end associate
  end subroutine move_part

  ! Finds the constraints at a point, unless they are known.
  subroutine find_constraints(x, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), contiguous, intent(in) :: y(:)
    integer :: status

    if (x%joints%constraints%factored) then
      if (all(x%joints%configuration == y(:x%frame%linkage%momenta_offset))) return
    end if
    x%joints%configuration = y(:x%frame%linkage%momenta_offset)
    call constraints_at(x%frame, y, 1, x%joints%constraints, status)
    if (status /= no_stop) call fail(x, status, x%t)
  end subroutine find_constraints

  ! Adds impulses of the joints to momenta and moves the bodies freely, such that joints are closed.
  subroutine drift_closed(x, time, path, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: time                       ! of the drift
    integer, intent(in) :: path                        ! the path of the drift
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)
    integer, parameter :: max_iterations = 50
    real(wp) :: y_start(size(y)), lambda(size(x%joints%constraints%g)), opening
    real(wp) :: change(size(lambda), max_iterations)   ! changes of lambda
    integer :: i, status

    call copy(size(y), y, y_start)
    opening = huge(opening)
    associate (linkage => x%frame%linkage, start => x%joints%constraints, trial => x%joints%trial, &
               impulse => x%joints%impulse(:size(lambda), :, path))
      lambda = 2 * impulse(:, 1) - impulse(:, 2)
      do i = 1, max_iterations
        if (i > 1) call copy(size(y), y_start, y)
        call constraint_impulse(linkage, start%gradient, lambda, &
                                y(linkage%momenta_offset + 1:linkage%momenta_end))
        call drift(x%frame, time, y)
        x%counts%nexp = x%counts%nexp + 1
        call evaluate_constraints(linkage, x%frame%blocks, x%frame%bodies, y, 0, trial, status)
        if (status /= no_stop) exit
        trial%scale(linkage%joint_rows + 1:) = start%scale(linkage%joint_rows + 1:)
        trial%min_scale(linkage%joint_rows + 1:) = start%min_scale(linkage%joint_rows + 1:)
        if (is_closed(trial, opening)) exit
        if (.not. opening < huge(opening)) exit
        call solve_constraints(linkage, start, trial%g)
        change(:, i) = -trial%g / time
        call correct_change(i, change)
        lambda = lambda + change(:, i)
      end do
      impulse(:, 2) = impulse(:, 1)
      if (all(impulse(:, 1) == 0)) impulse(:, 2) = lambda
      impulse(:, 1) = lambda
      if (status /= no_stop) then
        call fail(x, status, x%t)
      else if (i > max_iterations .or. .not. opening < huge(opening)) then
        call fail(x, joints_not_solved, x%t)
      else
        call restore(x%frame, y)
        call find_constraints(x, y)
      end if
    end associate
  end subroutine drift_closed

  ! Turns a change z by the matrix of the first iteration into that of Broyden's method. Instead of
  ! its matrices the changes s_j before are kept: C. T. Kelley, Iterative Methods for Linear and
  ! Nonlinear Equations, 1995, 7.3. Each adds (s_j.z / |s_j|^2) s_(j+1) to z, and the last one
  ! divides z by 1 - s.z / |s|^2, unless this would more than double z.
  pure subroutine correct_change(i, change)
    integer, intent(in) :: i                 ! the iteration
    real(wp), intent(inout) :: change(:, :)  ! (rows, iterations) s_j, and z in column i
    real(wp) :: along
    integer :: j

    associate (z => change(:, i))
      do j = 1, i - 1
        along = dot_product(change(:, j), z) / max(sum(change(:, j)**2), tiny(along))
        if (j < i - 1) z = z + along * change(:, j + 1)
        if (j == i - 1 .and. along < 0.5_wp) z = z / (1 - along)
      end do
    end associate
  end subroutine correct_change

  ! Computes the ends of all paths up to one. Results are restored to the manifold.
  subroutine follow_paths(x, last)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: last
    integer :: i, first, after_last                    ! flows of a path

    do i = x%paths_followed + 1, last
      if (x%problem%record%of_time .and. .not. x%method%leads(i)) cycle
      first = x%method%path_first(i)
      after_last = x%method%path_first(i + 1)
      call copy(x%frame%point_size, x%y(:, x%method%origin(i)), x%y(:, i))
      if (x%method%kind /= splitting_kind) call combine_flows( &
        x%method%flows, x%weight, first, after_last - 1, x%frame%dimension, x%f, x%v)
      select case (x%method%kind)
      case (splitting_kind)
        call move_by_splitting(x, i, x%y(:, i))
        if (x%status /= no_stop) return
        if (x%frame%jointed) cycle           ! drifts with joints have counted and restored
      case (polynomial_kind)
        call move_polynomially(x%frame%blocks(1)%action, x%v(:, :after_last - first), &
          abs(x%h) / max(abs(x%h), x%problem%duration), x%y(:, i), x%problem%inner)
        after_last = first + 1               ! they are one flow
      case default
        call apply_flows(x%frame, after_last - first, x%v, x%y(:, i))
      end select
      if (i == x%method%result .or. i == x%method%embedded) call restore(x%frame, x%y(:, i))
      x%counts%nexp = x%counts%nexp + int(after_last - first, int64)
    end do
    x%paths_followed = max(x%paths_followed, last)
  end subroutine follow_paths

  ! Computes the brackets of the fields at the stages, times the step size.
  subroutine find_brackets(x)
    type(trajectory_t), intent(inout) :: x
    real(wp), dimension(x%frame%dimension) :: u, v
    integer :: j, k

    do j = 1, size(x%method%bracket, 3)
      u = 0.0_wp
      v = 0.0_wp
      do k = 1, size(x%method%c) + j - 1
        u = u + (x%h * x%method%bracket(k, 1, j)) * x%f(:, k)
        v = v + x%method%bracket(k, 2, j) * x%f(:, k)
      end do
      call bracket(x%frame, u, v, x%f(:, size(x%method%c) + j))
    end do
  end subroutine find_brackets

  ! Takes the coefficients at the start for those of the first stage.
  subroutine start_explicit(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%slope
    if (x%method%kind == registers_kind) then
      x%y(:, 1) = x%y(:, 0)
      call move_along_register(x)
    end if
    x%stage = 2
  end subroutine start_explicit

  ! Requests the coefficients at the point of a stage; a function of time needs no point.
  subroutine request_on_path(x)
    type(trajectory_t), intent(inout) :: x
    integer :: path

    if (x%method%kind == registers_kind) then
      path = merge(0, 1, x%problem%record%of_time)
    else
      path = merge(0, x%method%stage_path(x%stage), x%problem%record%of_time)
      call follow_paths(x, path)
      if (x%status /= no_stop) return
    end if
    call request(x, x%t + x%method%c(x%stage) * x%h, x%y(:, path), phase_stage_received)
  end subroutine request_on_path

  ! Stores the coefficients f at a stage, on the Lie algebra dexp^-1_u f.
  subroutine receive_explicit(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    if (x%method%kind == registers_kind) then
      x%f(:, 1) = x%method%a(x%stage) * x%f(:, 1) + x%request%answer
      call move_along_register(x)
    else
      call copy(size(x%request%answer), x%request%answer, x%f(:, x%stage))
      if (x%stage == x%method%final_stage .or. &
          (x%problem%record%of_time .and. x%method%c(x%stage) == 1)) then
        x%end_slope(:) = x%f(:, x%stage)
        x%end_known = .true.
      end if
    end if
    if (x%method%kind == algebra_kind .and. x%method%stage_path(x%stage) > 0) then
      associate (path => x%method%stage_path(x%stage), f => x%f(:, x%stage))
        ! v has the coefficients of the flow that was followed last, unless an error was estimated
        if (x%paths_followed /= path .or. x%stage == x%method%final_stage) &
          call combine_flows(x%method%flows, x%weight, x%method%path_first(path), &
                             x%method%path_first(path), size(f), x%f, x%v)
        call dexpinv(x%frame, x%method%series, x%v(:, 1), f, exists)
        if (size(x%estimate%added) > 0) x%estimate%added(:, x%stage) = f - x%request%answer
      end associate
      if (.not. exists) then
        call reject_stage(x, step_too_long, x%t)
        return
      end if
    end if
    x%stage = x%stage + 1
    x%phase = phase_next_stage
  end subroutine receive_explicit

  ! Moves the point of a method of two registers along h b_i Z_i.
  subroutine move_along_register(x)
    type(trajectory_t), intent(inout) :: x

    x%v(:, 1) = (x%h * x%method%b(x%stage)) * x%f(:, 1)
    call apply_flows(x%frame, 1, x%v, x%y(:, 1))
    call restore(x%frame, x%y(:, 1))
    x%counts%nexp = x%counts%nexp + 1
  end subroutine move_along_register

end module paths_m
