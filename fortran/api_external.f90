! Faces for f2py of the integrator of a user's compiled function, and of flows on their own: they
! only shape and call.

! Trajectories in double precision, one after the other until one fails
subroutine external_field_run(function_address, data_address, blocks, description, stages, a, b, &
                              start, h, last, steps, save_every, n, stored, trajectories, y, &
                              status, flag, failed_at, failed)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t, make_external_field
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  use stepper_r64, only: failure_t, finished, grid_t, integrate_fixed
  implicit none
  integer(c_intptr_t), intent(in) :: function_address, data_address
  integer, intent(in) :: blocks, stages, steps, save_every, n, stored, trajectories
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: a(stages, stages), b(stages)
  real(wp), intent(in) :: start, h, last
  real(wp), intent(inout) :: y(n, 0:stored, trajectories)    ! column 0 is the initial point
  integer, intent(out) :: status, flag
  real(wp), intent(out) :: failed_at
  integer, intent(out) :: failed                             ! the trajectory, or 0
  type(frame_t) :: frame
  type(external_field_t) :: field
  type(grid_t) :: grid
  type(failure_t) :: failure
  integer :: i

  call make_frame(description, frame)
  call make_external_field(function_address, data_address, field)
  grid = grid_t(start=start, step=h, last=last, steps=steps, save_every=save_every)
  failed = 0
  do i = 1, trajectories
    call integrate_fixed(field, frame, a, b, grid, y(:, :, i), failure)
    if (failure%status /= finished) then
      failed = i
      exit
    end if
  end do
  status = failure%status
  flag = failure%flag
  failed_at = failure%t
end subroutine external_field_run

! Points moved along the flows of step * weight(j) times their field number stage(j), the first
! one first
subroutine frame_move(blocks, description, flows, step, weight, stage, stages, fields, f, points, y)
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame, move, restore
  implicit none
  integer, intent(in) :: blocks, flows, stages, fields, points
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: step
  real(wp), intent(in) :: weight(flows)
  integer, intent(in) :: stage(flows)
  real(wp), intent(in) :: f(fields)          ! (dimension, stages, trajectories)
  real(wp), intent(inout) :: y(points)       ! (point_size, trajectories)
  type(frame_t) :: frame
  real(wp) :: scaled(flows)

  call make_frame(description, frame)
  scaled = step * weight
  call move_all(frame%dimension, frame%point_size, points / frame%point_size, f, y)

contains

  subroutine move_all(dimension, point_size, trajectories, f, y)
    integer, intent(in) :: dimension, point_size, trajectories
    real(wp), intent(in) :: f(dimension, stages, trajectories)
    real(wp), intent(inout) :: y(point_size, trajectories)
    integer :: i

    do i = 1, trajectories
      call move(frame, scaled, stage, f(:, :, i), y(:, i))
      call restore(frame, y(:, i))
    end do
  end subroutine move_all

end subroutine frame_move
