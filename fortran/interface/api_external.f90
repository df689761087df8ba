! Interface for f2py of functions in C, of frames and their joints, of grids of times, and of the
! minimum-norm solver. Each procedure converts its arguments and calls the core.
module api_external_m
  use, intrinsic :: iso_c_binding, only: c_bool, c_f_pointer, c_funloc, c_intptr_t, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int64
  use algebra_m, only: dexpinv
  use conditions_m, only: order_conditions_t
  use coordinates_m, only: difference
  use frames_m, only: apply_flows, frame_t, make_frame, restore
  use free_motion_m, only: add_constraint_forces, close_joints
  use inputs_m, only: call_python_field, call_python_member, evaluate, field_at, grid_t, &
       make_grid, vector_field_t
  use joints_m, only: constraints_t, evaluate_constraints, rates
  use kinds, only: wp
  use linear_action_m, only: products
  use minimum_norm_m, only: minimise_norm
  use run_m, only: plan_at, plan_t
  use variational_m, only: variational_field
  use vectors_m, only: nan, set_addresses
  implicit none

contains

  ! Calls a function in C for each of some points, which it may overwrite, at one time or one each.
  subroutine call_field(function_address, data_address, data_stride, table_address, curves, times, &
                        t, members, n, m, y, f, done, flag) bind(c)
    !f2py threadsafe
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
    field%data%address = data_address
    field%data%stride = data_stride
    if (curves > 0) then
      call c_f_pointer(transfer(table_address, c_null_ptr), field%data%inputs, [7, curves])
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
  subroutine function_addresses(python_field, python_member, variational) bind(c)
    integer(c_intptr_t), intent(out) :: python_field, python_member, variational

    python_field = transfer(c_funloc(call_python_field), python_field)
    python_member = transfer(c_funloc(call_python_member), python_member)
    variational = transfer(c_funloc(variational_field), variational)
  end subroutine function_addresses

  ! The coefficients of the flows from points x to points y
  subroutine frame_difference(blocks, description, points, x, y, fields, v) bind(c)
    !f2py threadsafe
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
  subroutine frame_dexpinv(blocks, description, order, fields, u, v) bind(c)
    !f2py threadsafe
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
                        points, y) bind(c)
    !f2py threadsafe
    integer, intent(in) :: blocks, numbers, flows, fields, points, description(3, blocks)
    real(wp), intent(in) :: constants(numbers), v(fields)  ! v: (dimension, flows, trajectories)
    logical(c_bool), intent(in) :: restoring           ! whether to remove rounding off the manifold
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
  subroutine linear_products(count) bind(c)
    integer(int64), intent(out) :: count

    count = products
  end subroutine linear_products

  ! The number of equal steps in a span, and the size of the last one
  subroutine equal_steps(start, stop, h, steps, last) bind(c)
    real(wp), intent(in) :: start, stop, h
    integer(int64), intent(out) :: steps
    real(wp), intent(out) :: last
    type(grid_t) :: grid

    call make_grid(start, stop, h, grid)
    steps = grid%steps
    last = grid%last
  end subroutine equal_steps

  ! The constraints g at points and their derivatives by time, infinite where axes that shall
  ! coincide are others; and the sizes of the terms of both
  subroutine joints_errors(address, n, points, y, rows, g, speed, size_of_g, size_of_speed) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points, rows
    real(wp), intent(in) :: y(n, points)
    real(wp), intent(inout), dimension(rows, points) :: g, speed, size_of_g, size_of_speed
    type(plan_t), pointer :: plan
    type(constraints_t) :: c
    logical :: failed
    integer :: i

    plan => plan_at(address)
    associate (frame => plan%frame)
      do i = 1, points
        call evaluate_constraints(frame%linkage, frame%blocks, frame%bodies, y(:, i), 1, c, failed)
        if (failed) return
        g(:, i) = c%g
        if (c%exchanged) g(:, i) = huge(g)
        size_of_g(:, i) = c%scale
        associate (momenta => y(frame%linkage%before + 1:frame%linkage%after, i))
          speed(:, i) = rates(frame%linkage, c, momenta)
          c%moved = abs(c%moved)
          c%own_moved = abs(c%own_moved)
          size_of_speed(:, i) = rates(frame%linkage, c, abs(momenta))
        end associate
      end do
    end associate
  end subroutine joints_errors

  ! Closes the joints of points.
  subroutine joints_close(address, n, points, y, status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points
    real(wp), intent(inout) :: y(n, points)
    integer, intent(inout) :: status(points)             ! finished, raised or joints_not_solved
    type(plan_t), pointer :: plan
    integer :: i

    plan => plan_at(address)
    associate (frame => plan%frame)
      do i = 1, points
        call close_joints(frame, y(:, i), status(i))
      end do
    end associate
  end subroutine joints_close

  ! Adds the forces of joints to coefficients at points; they are the multipliers times derivatives.
  subroutine joints_forces(address, n, points, y, m, f, rows, multipliers, status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points, m, rows
    real(wp), intent(in) :: y(n, points)
    real(wp), intent(inout) :: f(m, points), multipliers(rows, points)
    integer, intent(inout) :: status(points)             ! finished, raised or joints_not_solved
    type(plan_t), pointer :: plan
    integer :: i

    plan => plan_at(address)
    associate (frame => plan%frame)
      do i = 1, points
        call add_constraint_forces(frame, y(:, i), .false., f(:, i), status(i), multipliers(:, i))
      end do
    end associate
  end subroutine joints_forces

  ! Sets the addresses of LAPACK.
  subroutine set_lapack(addresses) bind(c)
    integer(c_intptr_t), intent(in) :: addresses(10)

    call set_addresses(addresses)
  end subroutine set_lapack

  ! Fits order conditions, see minimise_norm. The caller has set the addresses of LAPACK.
  subroutine fit_minimum_norm(order, l, layout, n, x0, m, trees, owner, k, moving, ftol, damping, &
                              max_iterations, stop_flag, x, f, evaluations, status) bind(c)
    !f2py threadsafe
    integer, intent(in) :: order, l, n, m, k, layout(l)    ! layout: see read_layout
    real(wp), intent(in) :: x0(n)         ! packed weights
    integer, intent(in) :: trees(m)       ! none of them zero
    integer, intent(in) :: owner(m)       ! zero for the first result, see order_conditions_t
    integer, intent(in) :: moving(k)      ! indices of the unknowns that may move, from 1
    real(wp), intent(in) :: ftol, damping
    integer, intent(in) :: max_iterations
    integer, intent(inout), target :: stop_flag(1)  ! zero; set by another thread, never copied
    real(wp), intent(out) :: x(n), f
    integer, intent(out) :: evaluations, status
    type(order_conditions_t) :: conditions

    call conditions%set_up(order, layout, trees, owner)
    conditions%stop_flag => stop_flag(1)
    x = x0
    call minimise_norm(conditions, x, m, moving, ftol, damping, max_iterations, f, evaluations, &
                       status)
  end subroutine fit_minimum_norm

end module api_external_m
