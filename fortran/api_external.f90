! Faces for f2py of the integrator of a user's compiled function, and of flows on their own: they
! only shape and call.

! Trajectories in double precision, one after the other until one fails: budget steps in all, going
! on where the last call paused
subroutine external_field_run(function_address, data_address, blocks, description, stages, a, b, &
                              start, h, last, steps, save_every, n, stored, trajectories, y, &
                              budget, position, point, status, flag, failed_at)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t, make_external_field
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  use stepper_r64, only: failure_t, finished, grid_t, integrate_fixed, paused
  implicit none
  integer(c_intptr_t), intent(in) :: function_address, data_address
  integer, intent(in) :: blocks, stages, steps, save_every, n, stored, trajectories, budget
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: a(stages, stages), b(stages)
  real(wp), intent(in) :: start, h, last
  real(wp), intent(inout) :: y(n, 0:stored, trajectories)    ! column 0 is the initial point
  integer, intent(inout) :: position(2)                      ! trajectories, then steps, done
  real(wp), intent(inout) :: point(n)                        ! after those steps
  integer, intent(out) :: status, flag
  real(wp), intent(out) :: failed_at
  type(frame_t) :: frame
  type(external_field_t) :: field
  type(grid_t) :: grid
  type(failure_t) :: failure
  integer :: i, left

  call make_frame(description, frame)
  call make_external_field(function_address, data_address, field)
  grid = grid_t(start=start, step=h, last=last, steps=steps, save_every=save_every)
  left = budget
  do i = position(1) + 1, trajectories
    if (left == 0) exit
    if (position(2) == 0) point = y(:, 0, i)
    grid%done = position(2)
    grid%pause = grid%done + min(left, steps - grid%done)
    call integrate_fixed(field, frame, a, b, grid, point, y(:, :, i), failure)
    if (failure%status /= finished) exit
    left = left - (grid%pause - grid%done)
    position(2) = grid%pause
    if (grid%pause == steps) position = [i, 0]
  end do
  status = failure%status
  if (status == finished .and. position(1) < trajectories) status = paused
  flag = failure%flag
  failed_at = failure%t
end subroutine external_field_run

! Adaptive steps of one trajectory, or those of a grid: at most budget trial steps, going on where the
! last call paused
subroutine external_field_adapt(function_address, data_address, blocks, description, stages, a, b, &
                                embedded, c, m, atol, limits, steps, done, n, reals, logicals, &
                                point, slope, budget, capacity, t_kept, y_kept, f_kept, times, &
                                wanted, y_wanted, counts, status, flag)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use adaptive, only: integrate_adaptive, integrate_on_grid, make_pair, output_t, run_t
  use external_field, only: external_field_t, make_external_field
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  use stepper_r64, only: failure_t, grid_t
  implicit none
  integer(c_intptr_t), intent(in) :: function_address, data_address
  integer, intent(in) :: blocks, stages, m, n, budget, capacity, times
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: a(stages, stages), b(stages), embedded(stages), c(stages)
  real(wp), intent(in) :: atol(m)
  ! final time; then rtol, exponent and largest step, or start, step and last step of the grid
  real(wp), intent(in) :: limits(4)
  integer, intent(in) :: steps, done            ! of the grid, none if steps have to be chosen
  real(wp), intent(inout) :: reals(4)           ! time, next step, last error, time of failure
  integer, intent(inout) :: logicals(3)         ! after a rejected step; slope is known; keep steps
  real(wp), intent(inout) :: point(n)
  real(wp), intent(inout) :: slope(m)           ! the coefficients there
  ! the capacity is at least budget if steps are kept
  real(wp), intent(inout), target :: t_kept(capacity), y_kept(n, capacity), f_kept(m, capacity)
  real(wp), intent(inout), target :: wanted(times), y_wanted(n, times)
  integer, intent(out) :: counts(5)             ! attempts, accepted, nfev, nexp, times reached
  integer, intent(out) :: status, flag
  type(frame_t) :: frame
  type(external_field_t) :: field
  type(run_t) :: run
  type(output_t) :: output
  type(failure_t) :: failure

  call make_frame(description, frame)
  call make_external_field(function_address, data_address, field)
  call make_pair(frame, a, b, embedded, c, run)
  run%atol = atol
  run%stop = limits(1)
  run%t = reals(1)
  run%size = reals(2)
  run%last_error = reals(3)
  run%after_rejection = logicals(1) /= 0
  run%known = logicals(2) /= 0
  run%point = point
  run%f(:, 1) = slope
  output%keep = logicals(3) /= 0
  output%t => t_kept
  output%y => y_kept
  output%f => f_kept
  output%wanted => wanted
  output%y_wanted => y_wanted

  if (steps > 0) then
    call integrate_on_grid(field, frame, run, output, &
                           grid_t(start=limits(2), step=limits(3), last=limits(4), steps=steps, &
                                  done=done, pause=done + min(budget, steps - done)), failure)
  else
    run%rtol = limits(2)
    run%exponent = limits(3)
    run%max_step = limits(4)
    call integrate_adaptive(field, frame, run, output, budget, failure)
  end if
  reals = [run%t, run%size, run%last_error, failure%t]
  logicals(1:2) = merge(1, 0, [run%after_rejection, run%known])
  point = run%point
  slope = run%f(:, 1)
  counts = [run%attempts, run%accepted, run%nfev, run%nexp, output%used]
  status = failure%status
  flag = failure%flag
end subroutine external_field_adapt

! The coefficients of the flows from points x to points y
subroutine frame_difference(blocks, description, points, x, y, fields, v)
  use coordinates, only: difference
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  implicit none
  integer, intent(in) :: blocks, points, fields
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: x(points), y(points)   ! (point_size, trajectories)
  real(wp), intent(inout) :: v(fields)           ! (dimension, trajectories)
  type(frame_t) :: frame
  integer :: i

  call make_frame(description, frame)
  associate (n => frame%point_size, m => frame%dimension)
    do i = 0, points / n - 1
      call difference(frame, x(i * n + 1:(i + 1) * n), y(i * n + 1:(i + 1) * n), &
                      v(i * m + 1:(i + 1) * m))
    end do
  end associate
end subroutine frame_difference

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
