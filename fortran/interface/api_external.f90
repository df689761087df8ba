! Interface for f2py of functions in C, of frames and their joints, of grids of times, of the
! minimum-norm solver, and of lmdif on a function in Python. They convert arguments, no more.
module api_external_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_f_procpointer, c_funloc, c_intptr_t, &
                                         c_null_funptr, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int64
  use algebra_m, only: dexpinv
  use callback_m, only: callback_t
  use conditions_m, only: order_conditions_t
  use coordinates_m, only: difference
  use frames_m, only: apply_flows, frame_t, make_frame, restore
  use free_motion_m, only: add_constraint_forces, close_joints
  use inputs_m, only: call_python_rhs, evaluate_rhs, grid_t, make_grid, rhs_t
  use joints_m, only: constraints_t, evaluate_constraints, rates
  use kinds, only: wp
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  use linalg_m, only: least_squares_t
  use minimum_norm_m, only: minimise_norm
  use run_m, only: plan_at, plan_t
  use shared_numbers, only: coordinates_operation, flow_operation, no_stop, residual_operation, &
                            stopped_by_user
  use variational_m, only: variational_rhs
  use vectors_m, only: dgemm, dgetrf, dgetrs, dpotrf, dpotrs, dsyevd, dsyrk, nan, zgemm, zgetrf, &
                       zgetrs
  implicit none
  private :: python_function_t, residual

  type, extends(least_squares_t) :: python_function_t
    type(callback_t) :: python
  contains
    procedure :: residual
  end type python_function_t

contains

  ! Calls a function in C for each of some points, which it may overwrite, at one time or one each.
  subroutine call_rhs(function_address, data_address, data_stride, table_address, curves, times, &
                      t, members, n, m, y, f, done, code) bind(c)
    !f2py threadsafe
    integer(c_intptr_t), intent(in) :: function_address, data_address  ! data_address: 0 for none
    integer(c_intptr_t), intent(in) :: data_stride     ! bytes from one member's data to the next
    integer(c_intptr_t), intent(in) :: table_address   ! inputs, which are written into data
    integer, intent(in) :: curves, times, members, n, m    ! curves: their number
    real(wp), intent(in) :: t(times)
    real(wp), intent(inout) :: y(n, members), f(m, members)
    integer, intent(out) :: done                       ! how many were evaluated before one failed
    integer, intent(out) :: code                       ! what the function returned then
    type(rhs_t) :: rhs

    call c_f_procpointer(transfer(function_address, c_null_funptr), rhs%function)
    rhs%data%address = data_address
    rhs%data%stride = data_stride
    if (curves > 0) call c_f_pointer(transfer(table_address, c_null_ptr), rhs%data%inputs, [curves])
    code = 0
    do done = 0, members - 1
      rhs%member = merge(done + 1, 1, data_stride /= 0)
      call evaluate_rhs(rhs, n, m, t(min(done + 1, times)), y(:, done + 1), f(:, done + 1), code)
      if (code /= 0) exit
    end do
  end subroutine call_rhs

  ! The addresses of call_python_rhs and of variational_rhs, as functions in C
  subroutine function_addresses(python_rhs, variational) bind(c)
    integer(c_intptr_t), intent(out) :: python_rhs, variational

    python_rhs = transfer(c_funloc(call_python_rhs), python_rhs)
    variational = transfer(c_funloc(variational_rhs), variational)
  end subroutine function_addresses

  ! Applies an operation of shared_numbers to vectors a and b of each of some trajectories: moves
  ! points b along the time-1 flows of fields a, the first one first; finds the coefficients of the
  ! flow from point a to b; or derivatives of coordinates a that belong to coefficients b, or NaN.
  subroutine frame_apply(operation, blocks, description, numbers, constants, option, count, na, a, &
                         nb, b, nc, c) bind(c)
    !f2py threadsafe
    integer, intent(in) :: operation, blocks, numbers, count, na, nb, nc, description(3, blocks)
    real(wp), intent(in) :: constants(numbers), a(na, count), b(nb, count)
    integer, intent(in) :: option    ! the order of the method; 0 leaves rounding off the manifold
    real(wp), intent(inout) :: c(nc, count)
    type(frame_t) :: frame
    logical :: exists
    integer :: i

    call make_frame(description, constants, frame)
    do i = 1, count
      if (operation == coordinates_operation) then
        call difference(frame, a(:, i), b(:, i), c(:, i))
        cycle
      end if
      c(:, i) = b(:, i)
      if (operation == flow_operation) then
        call apply_flows(frame, na / frame%dimension, a(1, i), c(1, i))
        if (option > 0) call restore(frame, c(:, i))
      else
        call dexpinv(frame, option, a(:, i), c(:, i), exists)
        if (.not. exists) c(:, i) = nan
      end if
    end do
  end subroutine frame_apply

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

  ! The constraints at points (infinite if axes are exchanged), their rates, and sizes of terms
  subroutine joints_errors(address, n, points, y, rows, g, speed, size_of_g, size_of_speed, &
                           status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points, rows
    real(wp), intent(in) :: y(n, points)
    real(wp), intent(inout), dimension(rows, points) :: g, speed, size_of_g, size_of_speed
    integer, intent(inout) :: status(points)             ! no_stop, raised or out_of_memory
    type(plan_t), pointer :: plan
    type(constraints_t) :: c
    integer :: i

    plan => plan_at(address)
    associate (frame => plan%frame)
      do i = 1, points
        call evaluate_constraints(frame%linkage, frame%blocks, frame%bodies, y(:, i), 1, c, &
                                  status(i))
        if (status(i) /= no_stop) return
        g(:, i) = c%g
        if (c%exchanged) g(:, i) = huge(g)
        size_of_g(:, i) = c%scale
        associate (momenta => y(frame%linkage%momenta_offset + 1:frame%linkage%momenta_end, i))
          speed(:, i) = rates(frame%linkage, c%response, momenta)
          size_of_speed(:, i) = rates(frame%linkage, abs(c%response), abs(momenta))
        end associate
      end do
    end associate
  end subroutine joints_errors

  ! Moves points to where the joints are closed; see close_joints.
  subroutine joints_close(address, n, points, y, status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points
    real(wp), intent(inout) :: y(n, points)
    integer, intent(inout) :: status(points)             ! see joints_errors
    type(plan_t), pointer :: plan
    integer :: i

    plan => plan_at(address)
    do i = 1, points
      call close_joints(plan%frame, y(:, i), status(i))
    end do
  end subroutine joints_close

  ! Adds the forces of joints to coefficients at points; they are the multipliers times derivatives.
  subroutine joints_forces(address, n, points, y, m, f, rows, multipliers, status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, points, m, rows
    real(wp), intent(in) :: y(n, points)
    real(wp), intent(inout) :: f(m, points), multipliers(rows, points)
    integer, intent(inout) :: status(points)             ! see joints_errors
    type(plan_t), pointer :: plan
    integer :: i

    plan => plan_at(address)
    do i = 1, points
      call add_constraint_forces(plan%frame, y(:, i), forces_alone=.false., f=f(:, i), &
                                 status=status(i), multipliers=multipliers(:, i))
    end do
  end subroutine joints_forces

  ! Sets the addresses of the routines of BLAS and LAPACK.
  subroutine set_lapack(addresses) bind(c)
    integer(c_intptr_t), intent(in) :: addresses(10)

    call c_f_procpointer(transfer(addresses(1), c_null_funptr), dsyrk)
    call c_f_procpointer(transfer(addresses(2), c_null_funptr), dpotrf)
    call c_f_procpointer(transfer(addresses(3), c_null_funptr), dpotrs)
    call c_f_procpointer(transfer(addresses(4), c_null_funptr), dgetrf)
    call c_f_procpointer(transfer(addresses(5), c_null_funptr), zgetrf)
    call c_f_procpointer(transfer(addresses(6), c_null_funptr), dgetrs)
    call c_f_procpointer(transfer(addresses(7), c_null_funptr), zgetrs)
    call c_f_procpointer(transfer(addresses(8), c_null_funptr), dgemm)
    call c_f_procpointer(transfer(addresses(9), c_null_funptr), zgemm)
    call c_f_procpointer(transfer(addresses(10), c_null_funptr), dsyevd)
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

  ! Evaluates the residuals of lmdif_of_python.
  subroutine residual(self, x, f, outcome)
    class(python_function_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)   ! (n)
    real(wp), intent(out) :: f(:)  ! (m)
    integer, intent(inout) :: outcome
    logical :: failed

    call self%python%apply(residual_operation, x, x(:0), f, failed)
    if (failed) outcome = stopped_by_user
  end subroutine residual

  ! MINPACK's lmdif on a function in Python. It isn't `threadsafe`: the function needs the lock.
  subroutine lmdif_of_python(context, n, m, x0, diag, ftol, xtol, gtol, maxfev, epsfcn, &
                             factor, x, fvec, info, nfev, fjac, ipvt, qtf) bind(c)
    integer(c_intptr_t), intent(in) :: context     ! the function
    integer, intent(in) :: n, m, maxfev
    real(wp), intent(in) :: diag(n)                ! zeros if it isn't given
    real(wp), intent(in) :: x0(n), ftol, xtol, gtol, epsfcn, factor
    real(wp), intent(out) :: x(n), fvec(m), fjac(m, n), qtf(n)
    integer, intent(out) :: info, nfev, ipvt(n)
    type(python_function_t) :: problem
    type(lmdif_t) :: solver

    problem%python%context = transfer(context, c_null_ptr)
    solver = lmdif_t(ftol=ftol, xtol=xtol, gtol=gtol, maxfev=maxfev, epsfcn=epsfcn, factor=factor)
    if (all(diag > 0)) solver%diag = diag
    x = x0
    call lmdif(problem, x, fvec, solver)
    info = solver%info
    nfev = solver%nfev
    fjac = solver%fjac
    ipvt = solver%ipvt
    qtf = solver%qtf
  end subroutine lmdif_of_python

end module api_external_m
