! Faces for f2py of the integration of a function in C, and of flows on their own: they only shape
! and call. What belongs to one integration stays here between calls, known by its address.
module runs
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_loc, c_null_ptr, c_ptr
  use external_field, only: external_field_t, make_external_field
  use integration_r64, only: problem_t, trajectory_t
  implicit none
  private
  public :: run_t, run_at, address_of, make_field

  type :: run_t
    type(problem_t) :: problem
    integer(c_intptr_t) :: function_address = 0
    integer(c_intptr_t) :: data_address = 0          ! 0 for none
    integer(c_intptr_t) :: data_stride = 0           ! bytes from one trajectory's data to the next
    type(trajectory_t), allocatable :: trajectories(:)
  end type run_t

contains

  integer(c_intptr_t) function address_of(run)
    type(run_t), pointer, intent(in) :: run

    address_of = transfer(c_loc(run), address_of)
  end function address_of

  function run_at(address) result(run)
    integer(c_intptr_t), intent(in) :: address
    type(run_t), pointer :: run
    type(c_ptr) :: pointer

    pointer = transfer(address, c_null_ptr)
    call c_f_pointer(pointer, run)
  end function run_at

  subroutine make_field(run, trajectory, field)
    type(run_t), intent(in) :: run
    integer, intent(in) :: trajectory                ! whose data the function is given
    type(external_field_t), intent(out) :: field

    call make_external_field(run%function_address, run%data_address &
                             + int(trajectory - 1, c_intptr_t) * run%data_stride, field)
  end subroutine make_field

end module runs

! An integration of trajectories that start at the same time. Steps have to be chosen next.
subroutine run_open(blocks, description, numbers, constants, members, integers, list, terms, &
                    weight, stages, c, function_address, data_address, data_stride, n, &
                    trajectories, t, points, first_step, address)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use frames_r64, only: make_frame
  use integration_r64, only: start_trajectory
  use kinds_r64, only: wp
  use method_r64, only: make_method
  use runs, only: address_of, run_t
  implicit none
  integer, intent(in) :: blocks, numbers, members, integers, terms, stages, n, trajectories
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: constants(numbers)
  integer, intent(in) :: list(integers)
  real(wp), intent(in) :: weight(terms), c(stages)
  integer(c_intptr_t), intent(in) :: function_address, data_address, data_stride
  real(wp), intent(in) :: t
  real(wp), intent(in) :: points(n, trajectories)
  real(wp), intent(in) :: first_step                 ! zero to choose it
  integer(c_intptr_t), intent(out) :: address
  type(run_t), pointer :: run
  integer :: i

  allocate (run)
  call make_frame(description, constants, members, run%problem%frame)
  call make_method(list, weight, c, run%problem%method)
  run%problem%members = members
  run%function_address = function_address
  run%data_address = data_address
  run%data_stride = data_stride
  allocate (run%trajectories(trajectories))
  do i = 1, trajectories
    call start_trajectory(run%problem, t, points(:, i), first_step, run%trajectories(i))
  end do
  address = address_of(run)
end subroutine run_open

subroutine run_close(address)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use runs, only: run_at, run_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  type(run_t), pointer :: run

  run => run_at(address)
  deallocate (run)
end subroutine run_close

! A trajectory takes no more steps.
subroutine run_finish(address, i)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use runs, only: run_at, run_t
  use shared_numbers, only: finished
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: i
  type(run_t), pointer :: run

  run => run_at(address)
  run%trajectories(i)%failure%status = finished
end subroutine run_finish

! A trajectory's coefficients where it is are evaluated again, since the function gives others now.
subroutine run_forget(address, i)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use runs, only: run_at, run_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: i
  type(run_t), pointer :: run

  run => run_at(address)
  run%trajectories(i)%known = .false.
end subroutine run_forget

! Equal steps from start to stop
subroutine run_use_grid(address, start, stop, step, last, steps)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use integration_r64, only: grid_t
  use kinds_r64, only: wp
  use runs, only: run_at, run_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  real(wp), intent(in) :: start, stop, step, last
  integer, intent(in) :: steps
  type(run_t), pointer :: run

  run => run_at(address)
  run%problem%adaptive = .false.
  run%problem%stop = stop
  run%problem%grid = grid_t(start=start, step=step, last=last, steps=steps)
end subroutine run_use_grid

! Steps chosen by the error estimate of a pair
subroutine run_use_tolerances(address, stop, rtol, m, atol, in_entries, exponent, max_step)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use error_norm_r64, only: tolerances_t
  use kinds_r64, only: wp
  use runs, only: run_at, run_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  real(wp), intent(in) :: stop, rtol, exponent, max_step
  integer, intent(in) :: m
  real(wp), intent(in) :: atol(m)
  logical, intent(in) :: in_entries                  ! of points, not in coordinates
  type(run_t), pointer :: run

  run => run_at(address)
  run%problem%adaptive = .true.
  run%problem%stop = stop
  run%problem%tolerances = tolerances_t(atol=atol, rtol=rtol, in_entries=in_entries, &
                                        exponent=exponent, max_step=max_step)
end subroutine run_use_tolerances

! At most budget trial steps of each of some trajectories
subroutine run_advance(address, first, last, budget, every, keep_slopes, column, capacity, columns, &
                       n, m, t, y, f, counts, status, flag, failed_at)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t
  use integration_r64, only: integrate, output_t
  use kinds_r64, only: wp
  use runs, only: make_field, run_at, run_t
  use shared_numbers, only: paused
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: first, last, budget         ! trajectories from 1
  integer, intent(in) :: every                       ! steps between stored ones
  logical, intent(in) :: keep_slopes
  integer, intent(in) :: column                      ! that the first of them is stored in, from 1
  integer, intent(in) :: capacity, columns           ! numbers of steps and of trajectories there
  integer, intent(in) :: n, m                        ! sizes of points and slopes
  real(wp), intent(inout), target :: t(capacity)
  real(wp), intent(inout), target :: y(n, columns, capacity)
  real(wp), intent(inout), target :: f(m, columns, capacity)
  integer, intent(out) :: counts(5, first:last)      ! attempts, accepted, stored, nfev, nexp
  integer, intent(out) :: status(first:last), flag(first:last)
  real(wp), intent(out) :: failed_at(first:last)
  type(run_t), pointer :: run
  type(external_field_t) :: field
  type(output_t) :: output
  integer :: i

  run => run_at(address)
  counts = 0
  do i = first, last
    associate (trajectory => run%trajectories(i))
      if (trajectory%failure%status == paused) then
        call make_field(run, i, field)
        output%every = every
        output%t => t
        output%y => y(:, column + i - first, :)
        nullify (output%f)
        if (keep_slopes) output%f => f(:, column + i - first, :)
        call integrate(run%problem, field, budget, trajectory, output)
        counts(:, i) = [trajectory%attempts, trajectory%accepted, output%stored, trajectory%nfev, &
                        trajectory%nexp]
      end if
      status(i) = trajectory%failure%status
      flag(i) = trajectory%failure%flag
      failed_at(i) = trajectory%failure%t
    end associate
  end do
end subroutine run_advance

! The coefficients where a trajectory has got to, which its next step won't evaluate again
subroutine run_slope(address, i, m, f, evaluations, status, flag)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t
  use kinds_r64, only: wp
  use runs, only: make_field, run_at, run_t
  use shared_numbers, only: finished
  use stepper_r64, only: evaluate, failure_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: i, m
  real(wp), intent(out) :: f(m)
  integer, intent(out) :: evaluations, status, flag
  type(run_t), pointer :: run
  type(external_field_t) :: field
  type(failure_t) :: failure
  real(wp), allocatable :: point(:)                  ! which the function might write into

  run => run_at(address)
  evaluations = 0
  associate (trajectory => run%trajectories(i))
    if (.not. trajectory%known) then
      call make_field(run, i, field)
      point = trajectory%point
      call evaluate(field, run%problem%frame, trajectory%t, point, trajectory%slope, failure)
      evaluations = 1
      trajectory%known = failure%status == finished
    end if
    f = trajectory%slope
  end associate
  status = failure%status
  flag = failure%flag
end subroutine run_slope

! The coefficients at any times and points, with a trajectory's data
subroutine run_evaluate(address, i, points, n, m, t, y, f, done, status, flag)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t
  use kinds_r64, only: wp
  use runs, only: make_field, run_at, run_t
  use shared_numbers, only: finished
  use stepper_r64, only: evaluate, failure_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: i, points, n, m
  real(wp), intent(in) :: t(points), y(n, points)
  real(wp), intent(inout) :: f(m, points)
  integer, intent(out) :: done                       ! how many were evaluated before one failed
  integer, intent(out) :: status, flag
  type(run_t), pointer :: run
  type(external_field_t) :: field
  type(failure_t) :: failure

  run => run_at(address)
  call make_field(run, i, field)
  do done = 0, points - 1
    call evaluate(field, run%problem%frame, t(done + 1), y(:, done + 1), f(:, done + 1), failure)
    if (failure%status /= finished) exit
  end do
  status = failure%status
  flag = failure%flag
end subroutine run_evaluate

! One call of a function in C for each of some points, which it may write into
subroutine call_field(function_address, data_address, data_stride, t, members, n, m, y, f, done, flag)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use external_field, only: external_field_t, make_external_field
  use kinds_r64, only: wp
  implicit none
  integer(c_intptr_t), intent(in) :: function_address
  integer(c_intptr_t), intent(in) :: data_address    ! 0 for none
  integer(c_intptr_t), intent(in) :: data_stride     ! bytes from one member's data to the next
  real(wp), intent(in) :: t
  integer, intent(in) :: members, n, m
  real(wp), intent(inout) :: y(n, members), f(m, members)
  integer, intent(out) :: done                       ! how many were evaluated before one failed
  integer, intent(out) :: flag                       ! what the function returned then
  type(external_field_t) :: field

  flag = 0
  do done = 0, members - 1
    call make_external_field(function_address, data_address + int(done, c_intptr_t) * data_stride, &
                             field)
    call field%coefficients(n, m, t, y(:, done + 1), f(:, done + 1), flag)
    if (flag /= 0) exit
  end do
end subroutine call_field

! The address of the function in C that calls one of Python
subroutine python_field_address(address)
  use, intrinsic :: iso_c_binding, only: c_double, c_funloc, c_int, c_intptr_t, c_ptr
  implicit none
  integer(c_intptr_t), intent(out) :: address

  interface

    function call_python_field(t, y, f, user_data) bind(c) result(code)
      import :: c_double, c_int, c_ptr
      real(c_double), value, intent(in) :: t
      real(c_double), intent(in) :: y(*)
      real(c_double), intent(inout) :: f(*)
      type(c_ptr), value, intent(in) :: user_data
      integer(c_int) :: code
    end function call_python_field

  end interface

  address = transfer(c_funloc(call_python_field), address)
end subroutine python_field_address

! The coefficients of the flows from points x to points y
subroutine frame_difference(blocks, description, points, x, y, fields, v)
  use coordinates_r64, only: difference
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  implicit none
  integer, intent(in) :: blocks, points, fields
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: x(points), y(points)   ! (point_size, trajectories)
  real(wp), intent(inout) :: v(fields)           ! (dimension, trajectories)
  type(frame_t) :: frame
  integer :: i

  call make_frame(description, [real(wp) ::], 1, frame)
  associate (n => frame%point_size, m => frame%dimension)
    do i = 0, points / n - 1
      call difference(frame, x(i * n + 1:(i + 1) * n), y(i * n + 1:(i + 1) * n), &
                      v(i * m + 1:(i + 1) * m))
    end do
  end associate
end subroutine frame_difference

! The derivatives of coordinates u that go with coefficients v, NaN where there are none
subroutine frame_dexpinv(blocks, description, order, fields, u, v)
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use algebra_r64, only: dexpinv
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame
  implicit none
  integer, intent(in) :: blocks, fields
  integer, intent(in) :: description(3, blocks)
  integer, intent(in) :: order               ! of the method
  real(wp), intent(in) :: u(fields)          ! (dimension, trajectories)
  real(wp), intent(inout) :: v(fields)
  type(frame_t) :: frame
  logical :: exists
  integer :: i

  call make_frame(description, [real(wp) ::], 1, frame)
  associate (m => frame%dimension)
    do i = 0, fields / m - 1
      call dexpinv(frame, order, u(i * m + 1:(i + 1) * m), v(i * m + 1:(i + 1) * m), exists)
      if (.not. exists) v(i * m + 1:(i + 1) * m) = ieee_value(v(1), ieee_quiet_nan)
    end do
  end associate
end subroutine frame_dexpinv

! Points moved along the time-1 flows of as many fields each, the first one first
subroutine frame_move(blocks, description, numbers, constants, flows, fields, v, restoring, &
                      points, y)
  use kinds_r64, only: wp
  use frames_r64, only: frame_t, make_frame, move, restore
  implicit none
  integer, intent(in) :: blocks, numbers, flows, fields, points
  integer, intent(in) :: description(3, blocks)
  real(wp), intent(in) :: constants(numbers)
  real(wp), intent(in) :: v(fields)          ! (dimension, flows, trajectories)
  logical, intent(in) :: restoring           ! whether to remove rounding off the manifold
  real(wp), intent(inout) :: y(points)       ! (point_size, trajectories)
  type(frame_t) :: frame
  real(wp) :: ones(flows)
  integer :: order(flows + 1), i

  call make_frame(description, constants, 1, frame)
  ones = 1.0_wp
  order = [(i, i=1, flows + 1)]
  call move_all(frame%dimension, frame%point_size, points / frame%point_size, v, y)

contains

  subroutine move_all(dimension, point_size, trajectories, v, y)
    integer, intent(in) :: dimension, point_size, trajectories
    real(wp), intent(in) :: v(dimension, flows, trajectories)
    real(wp), intent(inout) :: y(point_size, trajectories)

    do i = 1, trajectories
      call move(frame, 1, flows, flows, flows, flows, order, ones, order(:flows), v(:, :, i), &
                y(:, i))
      if (restoring) call restore(frame, y(:, i))
    end do
  end subroutine move_all

end subroutine frame_move

! The controller, for steps that are taken in Python
subroutine control_step(taken, error, exponent, last_error, after_rejection, accepted, next_size, &
                        next_last_error)
  use controller_r64, only: accepted_size, rejected_size
  use kinds_r64, only: wp
  implicit none
  real(wp), intent(in) :: taken, error, exponent, last_error
  logical, intent(in) :: after_rejection
  logical, intent(out) :: accepted
  real(wp), intent(out) :: next_size, next_last_error

  accepted = error <= 1
  next_last_error = last_error
  if (accepted) then
    call accepted_size(taken, error, exponent, after_rejection, next_last_error, next_size)
  else
    next_size = rejected_size(taken, error, exponent)
  end if
end subroutine control_step

subroutine control_first_guess(point, slope, span, size)
  use controller_r64, only: first_guess
  use kinds_r64, only: wp
  implicit none
  real(wp), intent(in) :: point, slope, span
  real(wp), intent(out) :: size

  size = first_guess(point, slope, span)
end subroutine control_first_guess

subroutine control_first_size(point, slope, curvature, exponent, size)
  use controller_r64, only: first_size
  use kinds_r64, only: wp
  implicit none
  real(wp), intent(in) :: point, slope, curvature, exponent
  real(wp), intent(out) :: size

  size = first_size(point, slope, curvature, exponent)
end subroutine control_first_size

subroutine control_smallest_size(t, size)
  use controller_r64, only: smallest_size
  use kinds_r64, only: wp
  implicit none
  real(wp), intent(in) :: t
  real(wp), intent(out) :: size

  size = smallest_size(t)
end subroutine control_smallest_size

subroutine control_tried_size(wanted, t, stop, max_step, after_rejection, size)
  use controller_r64, only: tried_size
  use kinds_r64, only: wp
  implicit none
  real(wp), intent(in) :: wanted, t, stop, max_step
  logical, intent(in) :: after_rejection
  real(wp), intent(out) :: size

  size = tried_size(wanted, t, stop, max_step, after_rejection)
end subroutine control_tried_size
