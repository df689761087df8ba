! Interface for f2py of functions in C, of single operations of frames, and of grids of times.
! Each procedure converts its arguments and calls the core.

! Calls a function in C for each of some points, which it may overwrite, at one time or at one each.
subroutine call_field(function_address, data_address, data_stride, table_address, curves, times, &
                      t, members, n, m, y, f, done, flag)
  !f2py threadsafe
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_null_ptr
  use inputs_m, only: evaluate, field_at, vector_field_t
  use kinds, only: wp
  implicit none
  integer(c_intptr_t), intent(in) :: function_address, data_address  ! data_address: 0 for none
  integer(c_intptr_t), intent(in) :: data_stride     ! bytes from one member's data to the next
  integer(c_intptr_t), intent(in) :: table_address   ! of inputs, which are written into the data
  integer, intent(in) :: curves, times, members, n, m    ! curves: their number
  real(wp), intent(in) :: t(times)
  real(wp), intent(inout) :: y(n, members), f(m, members)
  integer, intent(out) :: done                       ! how many were evaluated before one failed
  integer, intent(out) :: flag                       ! what the function returned then
  type(vector_field_t) :: field

  field%rhs => field_at(function_address)
  field%data_address = data_address
  field%data_stride = data_stride
  if (curves > 0) then
    call c_f_pointer(transfer(table_address, c_null_ptr), field%inputs%table, [7, curves])
  end if
  flag = 0
  do done = 0, members - 1
    field%member = merge(done + 1, 1, data_stride /= 0)
    call evaluate(field, n, m, t(min(done + 1, times)), y(:, done + 1), f(:, done + 1), flag)
    if (flag /= 0) exit
  end do
end subroutine call_field

! The addresses of functions of the type rhs_i: those that call a function of Python, and the
! right-hand side of a solution with its derivatives
subroutine function_addresses(python_field, python_member, variational)
  use, intrinsic :: iso_c_binding, only: c_funloc, c_intptr_t
  use variational_m, only: variational_field
  use inputs_m, only: call_python_field, call_python_member
  implicit none
  integer(c_intptr_t), intent(out) :: python_field, python_member, variational

  python_field = transfer(c_funloc(call_python_field), python_field)
  python_member = transfer(c_funloc(call_python_member), python_member)
  variational = transfer(c_funloc(variational_field), variational)
end subroutine function_addresses

! The coefficients of the flows from points x to points y
subroutine frame_difference(blocks, description, points, x, y, fields, v)
  !f2py threadsafe
  use coordinates_m, only: difference
  use kinds, only: wp
  use frames_m, only: frame_t, make_frame
  implicit none
  integer, intent(in) :: blocks, points, fields, description(3, blocks)
  real(wp), intent(in) :: x(points), y(points)   ! (point_size, trajectories)
  real(wp), intent(inout) :: v(fields)           ! (dimension, trajectories)
  type(frame_t) :: frame
  integer :: i

  call make_frame(description, [real(wp) ::], frame)
  associate (n => frame%point_size, m => frame%dimension)
    do i = 0, points / n - 1
      call difference(frame, x(i * n + 1:(i + 1) * n), y(i * n + 1:(i + 1) * n), &
                      v(i * m + 1:(i + 1) * m))
    end do
  end associate
end subroutine frame_difference

! The derivatives of coordinates u that go with coefficients v, NaN where there are none
subroutine frame_dexpinv(blocks, description, order, fields, u, v)
  !f2py threadsafe
  use algebra_m, only: dexpinv
  use kinds, only: wp
  use frames_m, only: frame_t, make_frame
  use vectors_m, only: nan
  implicit none
  integer, intent(in) :: blocks, fields, description(3, blocks), order  ! order: of the method
  real(wp), intent(in) :: u(fields)          ! (dimension, trajectories)
  real(wp), intent(inout) :: v(fields)
  type(frame_t) :: frame
  logical :: exists
  integer :: i

  call make_frame(description, [real(wp) ::], frame)
  associate (m => frame%dimension)
    do i = 0, fields / m - 1
      call dexpinv(frame, order, u(i * m + 1:(i + 1) * m), v(i * m + 1:(i + 1) * m), exists)
      if (.not. exists) v(i * m + 1:(i + 1) * m) = nan
    end do
  end associate
end subroutine frame_dexpinv

! Points moved along the time-1 flows of as many fields each, the first one first
subroutine frame_move(blocks, description, numbers, constants, flows, fields, v, restoring, &
                      points, y)
  !f2py threadsafe
  use kinds, only: wp
  use frames_m, only: apply_flows, frame_t, make_frame, restore
  implicit none
  integer, intent(in) :: blocks, numbers, flows, fields, points, description(3, blocks)
  real(wp), intent(in) :: constants(numbers), v(fields)  ! v: (dimension, flows, trajectories)
  logical, intent(in) :: restoring           ! whether to remove rounding off the manifold
  real(wp), intent(inout) :: y(points)       ! (point_size, trajectories)
  type(frame_t) :: frame
  integer :: i

  call make_frame(description, constants, frame)
  associate (n => frame%point_size)
    do i = 0, points / n - 1
      call apply_flows(frame, flows, v(i * flows * frame%dimension + 1), y(i * n + 1))
      if (restoring) call restore(frame, y(i * n + 1:(i + 1) * n))
    end do
  end associate
end subroutine frame_move

! Counts the products by flows of LinearAction so far.
subroutine linear_products(count)
  use, intrinsic :: iso_fortran_env, only: int64
  use linear_action_m, only: products
  implicit none
  integer(int64), intent(out) :: count

  count = products
end subroutine linear_products

! The number of equal steps in a span, and the size of the last one
subroutine equal_steps(start, stop, h, steps, last)
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  use inputs_m, only: grid_t, make_grid
  implicit none
  real(wp), intent(in) :: start, stop, h
  integer(int64), intent(out) :: steps
  real(wp), intent(out) :: last
  type(grid_t) :: grid

  call make_grid(start, stop, h, grid)
  steps = grid%steps
  last = grid%last
end subroutine equal_steps
