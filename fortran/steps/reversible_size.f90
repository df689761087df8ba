! Variable steps of symmetric methods that stay reversible: E. Hairer, G. Söderlind, "Explicit, time
! reversible, adaptive step size control", SIAM J. Sci. Comput. 26 (2005).
!
! The user's function s of the configuration says how steps are to vary, h s. Their density is
! carried along, from step to step,
!
!   rho_(n + 1/2) = rho_(n - 1/2) - h d/dt log s(q_n),     step h / rho_(n + 1/2),
!
! at first from 1 / s by half as much. Backward, the derivative changes its sign, and the steps are
! the same ones.
module reversible_size_m
  use kinds, only: wp
  use free_motion_m, only: add_free_motion
  use frames_m, only: apply_flows
  use shared_numbers, only: raised, size_failed, step_too_small
  use trajectory_m, only: fail, trajectory_t
  implicit none
  private
  public :: choose_reversibly

contains

  ! Chooses the size and the end of the next step. The size is that before if a stop cuts the step.
  subroutine choose_reversibly(x, stop)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: stop
    real(wp) :: v(x%problem%frame%dimension), values(-1:1), time, change, density
    real(wp), parameter :: near = 1e-2_wp              ! of a step, where s is compared
    integer :: i

    associate (problem => x%problem, size => x%control%step_size)
      v = 0.0_wp
      call add_free_motion(problem%frame, x%y(:, 0), v)
      v(problem%frame%forces + 1:) = 0.0_wp
      call evaluate_size(x, 0 * v, values(0))
      time = near * problem%h * values(0)
      do i = -1, 1, 2
        if (x%status /= raised) call evaluate_size(x, real(i, wp) * time * v, values(i))
      end do
      if (x%status == raised) return
      change = sign(1.0_wp, stop - x%t) * problem%h * log(values(1) / values(-1)) / (2 * time)
      if (size > 0) then
        density = problem%h / size - change
      else
        density = 1 / values(0) - change / 2
      end if
      if (density > 0) size = problem%h / density
      x%h = sign(size, stop - x%t)
      x%t_end = x%t + x%h
      if (.not. (density > 0 .and. abs(x%t_end - x%t) > 0)) call fail(x, step_too_small, x%t)
      if (abs(x%t_end - x%t) < (1 - epsilon(1.0_wp)) * abs(stop - x%t)) return
      x%t_end = stop
      x%h = stop - x%t
    end associate
  end subroutine choose_reversibly

  ! Evaluates the function at the end of a flow; the trajectory fails unless it is positive.
  subroutine evaluate_size(x, v, value)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: v(x%problem%frame%dimension)
    real(wp), intent(out) :: value
    real(wp) :: y(x%problem%frame%point_size), flow(size(v)), values(1)
    logical :: failed

    y = x%y(:, 0)
    flow = v
    call apply_flows(x%problem%frame, 1, flow, y)
    call x%problem%sizes%observe(x%member, x%t, y, values, failed)
    value = values(1)
    if (.not. failed) failed = .not. (value > 0 .and. value <= huge(value))
    if (.not. failed) return
    value = 1.0_wp
    x%request%flag = size_failed
    call fail(x, raised, x%t)
  end subroutine evaluate_size

end module reversible_size_m
