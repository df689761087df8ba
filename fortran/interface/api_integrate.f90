! Interface for f2py of built-in problems with equal steps from time 0, all of which are stored.
! A call takes `count` steps after the first `done` ones, which earlier calls have taken.
module built_in_m
  use iso_fortran_env, only: int64
  use kinds, only: wp
  use frames_m, only: frame_t, make_frame
  use interpolant_m, only: scheme_t
  use loop_m, only: resume
  use method_m, only: make_method, method_t
  use output_m, only: output_t
  use shared_numbers, only: buffer_full, out_of_memory, paused
  use time_grid_m, only: grid_t
  use trajectory_m, only: follow_grid, problem_t, set_start, start, trajectory_t
  use vector_field_m, only: vector_field_t
  implicit none
  private
  public :: integrate_steps

contains

  ! Takes some steps of a built-in problem.
  subroutine integrate_steps(field, description, constants, list, weight, c, h, steps, done, &
                             count, y, status, failed_at)
    class(vector_field_t), target, intent(inout) :: field
    integer, intent(in) :: description(:, :)                         ! (3, blocks)
    real(wp), intent(in) :: constants(:)                             ! see make_frame
    integer, intent(in) :: list(:)                                   ! see make_method
    real(wp), intent(in) :: weight(:), c(:)                          ! (terms), (stages)
    real(wp), intent(in) :: h
    integer, intent(in) :: steps, done, count
    real(wp), intent(inout), target, contiguous :: y(:, 0:)          ! (point_size, 0:steps)
    integer, intent(out) :: status
    real(wp), intent(out) :: failed_at
    type(problem_t) :: problem
    type(frame_t), target :: frame
    type(method_t), target :: method
    type(scheme_t), target :: scheme
    type(trajectory_t) :: trajectory
    type(output_t) :: output
    real(wp), target :: t(count)
    integer(int64) :: budget
    integer :: memory

    call make_frame(description, constants, frame)
    call make_method(list, weight, c, method)
    problem%frame => frame
    problem%method => method
    problem%scheme => scheme
    problem%field => field
    problem%h = h
    problem%stops = [real(steps, wp) * h]
    failed_at = 0.0_wp
    status = out_of_memory
    call start(problem, .false., .false., trajectory, memory)
    if (memory /= 0) return
    call set_start(real(done, wp) * h, y(:, done), 0.0_wp, trajectory)
    call follow_grid(grid_t(step=h, last=h, steps=int(steps, int64)), int(done, int64), trajectory)
    output%step_capacity = int(count, int64)
    output%step_t => t
    output%step_y => y(:, done + 1:)
    budget = int(count, int64)
    call resume(problem, trajectory, output, budget)
    status = trajectory%status
    if (status == buffer_full) status = paused
    failed_at = trajectory%failed_at
  end subroutine integrate_steps

end module built_in_m

! The heavy top
subroutine core_heavy_top(inertia, mgl, integers, list, terms, weight, stages, c, h, steps, done, &
                           count, y, status, failed_at)
  use built_in_m, only: integrate_steps
  use kinds, only: wp
  use heavy_top_m, only: heavy_top_t
  use shared_numbers, only: euclidean_block, so3_block
  implicit none
  integer, intent(in) :: integers, terms, stages, steps, done, count
  real(wp), intent(in) :: inertia(3), mgl(1)
  integer, intent(in) :: list(integers)
  real(wp), intent(in) :: weight(terms), c(stages)
  real(wp), intent(in) :: h(1)
  real(wp), intent(inout), target :: y(12, 0:steps)    ! columns up to done are given
  integer, intent(out) :: status
  real(wp), intent(out) :: failed_at(1)
  type(heavy_top_t) :: top

  top = heavy_top_t(inertia=inertia, mgl=mgl(1))
  call integrate_steps(top, reshape([so3_block, 3, 0, euclidean_block, 3, 0], [3, 2]), &
                       [real(wp) ::], list, weight, c, h(1), steps, done, count, y, status, &
                       failed_at(1))
end subroutine core_heavy_top

! A field with affine coefficients on any frame
subroutine core_affine_field(blocks, description, numbers, constants, m, n, constant, linear, &
                              slope, integers, list, terms, weight, stages, c, h, steps, done, &
                              count, y, status, failed_at)
  use built_in_m, only: integrate_steps
  use kinds, only: wp
  use affine_field_m, only: affine_field_t
  implicit none
  integer, intent(in) :: blocks, numbers, m, n, integers, terms, stages, steps, done, count
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: constants(numbers)
  real(wp), intent(in) :: constant(m), linear(m, n), slope(m)
  integer, intent(in) :: list(integers)
  real(wp), intent(in) :: weight(terms), c(stages)
  real(wp), intent(in) :: h(1)
  real(wp), intent(inout), target :: y(n, 0:steps)     ! columns up to done are given
  integer, intent(out) :: status
  real(wp), intent(out) :: failed_at(1)
  type(affine_field_t) :: field

  field = affine_field_t(constant=constant, linear=linear, slope=slope)
  call integrate_steps(field, description, constants, list, weight, c, h(1), steps, done, count, &
                       y, status, failed_at(1))
end subroutine core_affine_field
