! RATTLE: kicks and drifts of mechanical systems with joints. Before each drift, impulses along the
! derivatives G of the constraints at its start are added to the kick, such that the joints are
! closed at its end,
!
!   q_1 = drift_h(q_0, mu_0 + h k F + G(q_0)^T lambda),   g(q_1) = 0,
!
! by Broyden's method from lambda <- lambda - (h G J^-1 G^T)^-1 g(q_1) at q_0, where the factor
! also removes what opens the joints from the momentum at the end of a step. It starts from impulses
! that continue those of the two steps before. Between the drifts of a
! step nothing has to be removed, since the next impulses would replace it. The drift is the exact
! free motion of the bodies.
!
! With a heat bath the drift in the middle of a step is two halves, between which momenta exchange
! heat; what opens the joints is removed from them and from the noise, in the metric of J^-1.
module rattle_m
  use kinds, only: wp
  use constrained_motion_m, only: constraints_at, is_closed, remove_opening
  use frames_m, only: restore
  use free_motion_m, only: drift
  use heat_bath_m, only: exchange_heat
  use joints_m, only: constraint_impulse, evaluate_constraints, solve_constraints
  use method_m, only: middle_path
  use shared_numbers, only: finished, joints_not_solved, raised
  use trajectory_m, only: fail, trajectory_t
  use vectors_m, only: copy
  implicit none
  private
  public :: move_with_joints

contains

  ! Follows a path: a kick, then a drift, or at the end of a step none.
  subroutine move_with_joints(x, path, y)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size) its start, then its end
    real(wp) :: time
    integer :: flow, k

    flow = x%method%path_first(path)
    time = x%h * x%method%drift(flow)
    call find_constraints(x, y)
    if (x%status /= finished) return
    associate (m => x%frame%forces, flows => x%method%flows)
      associate (momenta => y(size(y) - m + 1:))
        do k = flows%first(flow), flows%first(flow + 1) - 1
          momenta = momenta + x%weight(k) * x%f(m + 1:2 * m, flows%stage(k))
        end do
        if (x%problem%bath%present .and. path == middle_path(x%method)) then
          call drift_closed(x, time / 2, path, y)
          if (x%status /= finished) return
          call remove_opening(x%frame, x%joints%here, momenta)
          call exchange_heat(x%problem%bath, x%frame, x%member, x%t, x%h, y)
          call remove_opening(x%frame, x%joints%here, momenta)
          call drift_closed(x, time / 2, path, y)
        else if (abs(time) > 0) then
          call drift_closed(x, time, path, y)
        else
          call remove_opening(x%frame, x%joints%here, momenta)
        end if
      end associate
    end associate
  end subroutine move_with_joints

  ! Finds the constraints at a point, unless they are known.
  subroutine find_constraints(x, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), contiguous, intent(in) :: y(:)
    integer :: status

    associate (n => x%frame%linkage%before)
      if (x%joints%here%known) then
        if (all(abs(x%joints%place - y(:n)) <= 0)) return
      end if
      x%joints%place = y(:n)
      call constraints_at(x%frame, y, 1, x%joints%here, status)
    end associate
    if (status /= finished) call fail(x, status, x%t)
  end subroutine find_constraints

  ! Adds impulses of the joints to momenta and moves the bodies freely, such that joints are closed.
  subroutine drift_closed(x, time, path, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: time
    integer, intent(in) :: path
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)
    integer, parameter :: iterations = 50
    real(wp) :: start(size(y)), lambda(size(x%joints%here%g)), last
    real(wp) :: change(size(lambda), iterations)       ! of lambda
    logical :: failed
    integer :: i

    call copy(size(y), y, start)
    last = huge(last)
    associate (linkage => x%frame%linkage, here => x%joints%here, ahead => x%joints%ahead)
      associate (impulse => x%joints%impulse(:size(lambda), :, path))
        lambda = 2 * impulse(:, 1) - impulse(:, 2)
        do i = 1, iterations
          if (i > 1) call copy(size(y), start, y)
          call constraint_impulse(linkage, here, .false., lambda, &
                                  y(linkage%before + 1:linkage%after))
          call drift(x%frame, time, y)
          x%counts%nexp = x%counts%nexp + 1
          call evaluate_constraints(linkage, x%frame%blocks, x%frame%bodies, y, 0, ahead, failed)
          if (failed) exit
          if (linkage%own > 0) then
            ahead%scale(linkage%rows + 1:) = here%scale(linkage%rows + 1:)
            ahead%least(linkage%rows + 1:) = here%least(linkage%rows + 1:)
          end if
          if (is_closed(ahead, last)) exit
          if (.not. last < huge(last)) exit
          call solve_constraints(linkage, here, ahead%g)
          change(:, i) = -ahead%g / time
          call correct_change(i, change)
          lambda = lambda + change(:, i)
        end do
        impulse(:, 2) = impulse(:, 1)
        if (.not. any(abs(impulse(:, 1)) > 0)) impulse(:, 2) = lambda
        impulse(:, 1) = lambda
      end associate
      if (failed) then
        call fail(x, raised, x%t)
      else if (i > iterations .or. .not. last < huge(last)) then
        call fail(x, joints_not_solved, x%t)
      else
        call restore(x%frame, y)
        call find_constraints(x, y)
      end if
    end associate
  end subroutine drift_closed

  ! Makes the last change that of Broyden's method from that by the first matrix, where changes
  ! become smaller.
  pure subroutine correct_change(i, change)
    integer, intent(in) :: i
    real(wp), intent(inout) :: change(:, :)
    real(wp) :: along
    integer :: j

    associate (now => change(:, i))
      do j = 1, i - 1
        along = dot_product(change(:, j), now) / max(sum(change(:, j)**2), tiny(along))
        if (j < i - 1) now = now + along * change(:, j + 1)
        if (j == i - 1 .and. along < 0.5_wp) now = now / (1 - along)
      end do
    end associate
  end subroutine correct_change

end module rattle_m
