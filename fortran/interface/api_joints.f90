! Interface for f2py of phase spaces with joints, which stay in memory between calls.

! Makes a phase space with joints; see make_bodies and make_linkage.
subroutine joints_open(blocks, description, numbers, constants, columns, column, entries, inertia, &
                       bodies, places, rows, integers, joints, reals, own, context, address)
  use, intrinsic :: iso_c_binding, only: c_intptr_t, c_loc, c_null_ptr
  use frames_m, only: frame_t, make_frame
  use free_motion_m, only: make_bodies
  use joints_m, only: make_linkage
  use kinds, only: wp
  implicit none
  integer, intent(in) :: blocks, numbers, columns, entries, bodies, rows, joints, own
  integer, intent(in) :: description(3, blocks), column(columns)
  ! the last columns are unused, since no array may be empty
  integer, intent(in) :: places(2, bodies), integers(3, rows)
  real(wp), intent(in) :: constants(numbers), inertia(entries), reals(13, joints)
  integer(c_intptr_t), intent(in) :: context           ! evaluates own rows
  integer(c_intptr_t), intent(out) :: address
  type(frame_t), pointer :: frame

  allocate (frame)
  call make_frame(description, constants, frame)
  frame%before = frame%blocks(columns + 1)%p1 - 1
  frame%forces = frame%blocks(columns + 1)%dimension
  allocate (frame%bodies(columns))
  call make_bodies(column, inertia, frame, frame%bodies)
  call make_linkage(frame%blocks, frame%forces, places(:, :bodies - 1), integers(:, :rows - 1), &
                    reals(:, :joints - 1), own, frame%linkage)
  frame%linkage%python%context = transfer(context, c_null_ptr)
  frame%jointed = .true.
  address = transfer(c_loc(frame), address)
end subroutine joints_open

! Frees a phase space.
subroutine joints_free(address)
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_null_ptr
  use frames_m, only: frame_t
  implicit none
  integer(c_intptr_t), intent(in) :: address
  type(frame_t), pointer :: frame

  call c_f_pointer(transfer(address, c_null_ptr), frame)
  deallocate (frame%bodies)
  deallocate (frame)
end subroutine joints_free

! The constraints g at points and their derivatives by time, infinite where axes that shall coincide
! are others; and the sizes of the terms of both
subroutine joints_errors(address, n, points, y, rows, g, speed, size_of_g, size_of_speed)
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_null_ptr
  use frames_m, only: frame_t
  use joints_m, only: axes_coincide, constraints_t, evaluate_constraints, rates
  use kinds, only: wp
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: n, points, rows
  real(wp), intent(in) :: y(n, points)
  real(wp), intent(inout), dimension(rows, points) :: g, speed, size_of_g, size_of_speed
  type(frame_t), pointer :: frame
  type(constraints_t) :: c
  logical :: failed
  integer :: i

  call c_f_pointer(transfer(address, c_null_ptr), frame)
  do i = 1, points
    call evaluate_constraints(frame%linkage, frame%blocks, frame%bodies, y(:, i), 1, c, failed)
    if (failed) return
    g(:, i) = c%g
    if (.not. axes_coincide(frame%linkage, frame%blocks, y(:, i))) g(:, i) = huge(g)
    size_of_g(:, i) = c%scale
    associate (momenta => y(frame%linkage%before + 1:frame%linkage%after, i))
      speed(:, i) = rates(frame%linkage, c, momenta)
      c%moved = abs(c%moved)
      c%own_moved = abs(c%own_moved)
      size_of_speed(:, i) = rates(frame%linkage, c, abs(momenta))
    end associate
  end do
end subroutine joints_errors

! Closes the joints of points.
subroutine joints_close(address, n, points, y, status)
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_null_ptr
  use free_motion_m, only: close_joints
  use frames_m, only: frame_t
  use kinds, only: wp
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: n, points
  real(wp), intent(inout) :: y(n, points)
  integer, intent(inout) :: status(points)             ! finished, raised or joints_not_solved
  type(frame_t), pointer :: frame
  integer :: i

  call c_f_pointer(transfer(address, c_null_ptr), frame)
  do i = 1, points
    call close_joints(frame, y(:, i), status(i))
  end do
end subroutine joints_close

! Adds the forces of joints to coefficients at points; they are the multipliers times derivatives.
subroutine joints_forces(address, n, points, y, m, f, rows, multipliers, status)
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_intptr_t, c_null_ptr
  use free_motion_m, only: add_constraint_forces
  use frames_m, only: frame_t
  use kinds, only: wp
  implicit none
  integer(c_intptr_t), intent(in) :: address
  integer, intent(in) :: n, points, m, rows
  real(wp), intent(in) :: y(n, points)
  real(wp), intent(inout) :: f(m, points), multipliers(rows, points)
  integer, intent(inout) :: status(points)             ! finished, raised or joints_not_solved
  type(frame_t), pointer :: frame
  integer :: i

  call c_f_pointer(transfer(address, c_null_ptr), frame)
  do i = 1, points
    call add_constraint_forces(frame, y(:, i), .false., f(:, i), status(i), multipliers(:, i))
  end do
end subroutine joints_forces
