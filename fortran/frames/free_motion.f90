! Mechanical systems: points are configurations and momenta, coefficients velocities and derivatives
! of momenta. Right-hand sides give the forces alone; free motion is added here, or moves points.
! With joints, their forces are added, and points and momenta are made to agree with them.
module free_motion_m
  use blocks_m, only: body_t, find_velocities
  use frames_m, only: apply_flows, frame_t
  use gyroscopic_m, only: carry_tangents, move_by_series, rotor_momentum, substeps, turn_with_rotor
  use joints_m, only: constraint_impulse, constraints_t, evaluate_constraints, &
                      factor_constraints, rates, solve_constraints
  use kinds, only: wp
  use rigid_body_m, only: turn_freely
  use rotations_m, only: turn_point
  use shared_numbers, only: euclidean_block, joints_not_solved, no_stop, sphere_block
  use vectors_m, only: cross, finite
  implicit none
  private
  public :: add_constraint_forces, add_free_motion, close_joints, complete_forces, constraints_at, &
            drift, is_closed, make_bodies, make_tangential, move_by_impulses, remove_opening, &
            try_close_joints

contains

  ! Makes the bodies of the blocks of a frame but the last, the momenta. Constants of each are its
  ! inverse inertia, the root of its inertia, and an option: 0; 1 before a gyroscopic matrix that
  ! commutes with free motion, 2 before another one. Those of top_t end a body that turns.
  subroutine make_bodies(columns, constants, frame, bodies, alloc_status)
    integer, intent(in) :: columns(:)        ! (bodies) of its inertia, negative if it turns
    real(wp), intent(in) :: constants(:)
    type(frame_t), intent(in) :: frame
    type(body_t), intent(out) :: bodies(:)
    integer, intent(out) :: alloc_status     ! nonzero if there isn't enough memory
    real(wp) :: option(1)
    integer :: i, used

    alloc_status = 0
    used = 0
    do i = 1, size(columns)
      associate (body => bodies(i), n => frame%blocks(i)%dimension, width => abs(columns(i)))
        allocate (body%inverse(n, width), body%root(n, width), stat=alloc_status)
        if (alloc_status /= 0) return
        call take(n * width, body%inverse)
        call take(n * width, body%root)
        call take(1, option)
        body%commutes = option(1) < 2
        if (option(1) > 0) allocate (body%gyroscopic(n, n), stat=alloc_status)
        if (alloc_status /= 0) return
        if (option(1) > 0) call take(n**2, body%gyroscopic)
        body%turns = columns(i) < 0
        if (.not. body%turns) cycle
        body%top = transfer(constants(used + 1:), body%top)
        used = used + storage_size(body%top) / storage_size(option)
      end associate
    end do

  contains

    ! Takes the next constants.
    subroutine take(count, numbers)
      integer, intent(in) :: count
      real(wp), intent(out) :: numbers(count)

      numbers = constants(used + 1:used + count)
      used = used + count
    end subroutine take

  end subroutine make_bodies

  ! Makes coefficients of the forces that a right-hand side has returned at the beginning of f. They
  ! alone are the coefficients of splitting methods, which follow free motion by themselves.
  subroutine complete_forces(frame, y, forces_alone, with_joints, f, status)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    logical, intent(in) :: forces_alone, with_joints   ! with_joints: whether to add their forces
    real(wp), contiguous, intent(inout) :: f(:)        ! (dimension)
    integer, intent(out) :: status                     ! see constraints_at

    status = no_stop
    f(frame%forces + 1:) = f(:frame%forces)
    f(:frame%forces) = 0.0_wp
    call make_tangential(frame, y, f(frame%forces + 1:))
    if (.not. forces_alone) call add_free_motion(frame, y, f)
    if (frame%jointed .and. with_joints .and. finite(size(f), f)) &
      call add_constraint_forces(frame, y, forces_alone, f, status)
  end subroutine complete_forces

  ! Makes forces or momenta tangential: on a sphere they have no component along the point.
  pure subroutine make_tangential(frame, configuration, vector)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: configuration(frame%momenta_offset)
    real(wp), intent(inout) :: vector(frame%forces)
    integer :: i

    do i = 1, size(frame%bodies)
      associate (block => frame%blocks(i))
        if (block%kind == sphere_block) &
          call remove_component(configuration(block%p1:block%p2), vector(block%v1:block%v2))
      end associate
    end do
  end subroutine make_tangential

  ! Sets the velocities, and adds to forces what they do to the momenta of bodies.
  pure subroutine add_free_motion(frame, y, f)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: y(frame%point_size)
    real(wp), intent(inout) :: f(frame%dimension)
    integer :: i

    do i = 1, size(frame%bodies)
      associate (v => frame%blocks(i)%v1, last => frame%blocks(i)%v2, body => frame%bodies(i), &
                 m => frame%forces, k => frame%momenta_offset)
        associate (momentum => y(k + v:k + last), velocity => f(v:last), slope => f(m + v:m + last))
          call find_velocities(body, size(velocity), momentum, velocity)
          if (body%turns) slope = slope + cross(momentum, velocity)
          if (allocated(body%gyroscopic)) slope = slope + matmul(body%gyroscopic, velocity)
        end associate
      end associate
    end do
  end subroutine add_free_motion

  ! Moves a point by impulses, which needn't be tangential, and free motion after each of them.
  subroutine move_by_impulses(frame, impulse, times, y)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: times(:)         ! (impulses)
    real(wp), intent(in) :: impulse(frame%dimension, size(times))
    real(wp), intent(inout) :: y(frame%point_size)
    integer :: j

    associate (m => frame%forces, k => frame%momenta_offset)
      do j = 1, size(times)
        y(k + 1:) = y(k + 1:) + impulse(m + 1:, j)
        call make_tangential(frame, y(:k), y(k + 1:))
        if (times(j) /= 0) call drift(frame, times(j), y)
      end do
    end associate
  end subroutine move_by_impulses

  ! Moves all bodies freely, or with their gyroscopic forces.
  subroutine drift(frame, time, y)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: y(frame%point_size)
    real(wp) :: momenta(frame%forces), part
    integer :: i, k

    momenta = y(frame%momenta_offset + 1:frame%momenta_offset + frame%forces)
    if (frame%tangents > 0) &
      call carry_tangents(frame, time, momenta, y(frame%momenta_offset + frame%forces + 1:))
    do i = 1, size(frame%bodies)
      associate (block => frame%blocks(i), body => frame%bodies(i))
        associate (momentum => momenta(block%v1:block%v2), point => y(block%p1:block%p2))
          if (.not. allocated(body%gyroscopic)) then
            call move_body(frame, i, time, momentum, y)
          else if (block%kind == euclidean_block) then
            call move_by_series(body, time, momentum, point)
          else
            momentum = momentum + rotor_momentum(body)
            do k = 1, merge(1, size(substeps), body%commutes)
              part = merge(time, time * substeps(k), body%commutes)
              call turn_with_rotor(block, body, part / 2, momentum, point)
              call move_body(frame, i, part, momentum, y)
              call turn_with_rotor(block, body, part / 2, momentum, point)
            end do
            momentum = momentum - rotor_momentum(body)
          end if
        end associate
      end associate
    end do
    y(frame%momenta_offset + 1:frame%momenta_offset + frame%forces) = momenta
  end subroutine drift

  ! Moves one body along its free motion without gyroscopic forces.
  subroutine move_body(frame, i, time, momentum, y)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: i
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(frame%blocks(i)%dimension), y(frame%point_size)
    real(wp) :: v(frame%forces), q(4)

    associate (block => frame%blocks(i), body => frame%bodies(i))
      associate (point => y(block%p1:block%p2), flow => v(block%v1:block%v2))
        if (body%turns) then
          call turn_freely(body%top, time, momentum, q)
          call turn_point(block, q, point)
        else
          call find_velocities(body, block%dimension, momentum, flow)
          flow = time * flow
          call apply_flows(frame, 1, v, y, i)
          if (block%kind == sphere_block) call remove_component(point, momentum)
        end if
      end associate
    end associate
  end subroutine move_body

  ! Removes the component of a vector along a unit vector.
  pure subroutine remove_component(point, vector)
    real(wp), intent(in) :: point(3)
    real(wp), intent(inout) :: vector(3)

    vector = vector - sum(point * vector) / sum(point**2) * point
  end subroutine remove_component

  ! Evaluates the constraints at a point and factors their matrix.
  subroutine constraints_at(frame, y, depth, c, status)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    integer, intent(in) :: depth                       ! see evaluate_constraints
    type(constraints_t), intent(inout) :: c
    integer, intent(out) :: status           ! no_stop, raised, out_of_memory, joints_not_solved

    call evaluate_constraints(frame%linkage, frame%blocks, frame%bodies, y, depth, c, status)
    if (status /= no_stop) return
    call factor_constraints(frame%linkage, c)
    if (.not. c%factored) status = joints_not_solved
  end subroutine constraints_at

  ! Adds the forces G^T x of constraints to forces f: G J^-1 (f + G^T x) + bias = 0, the second
  ! derivatives of constraints along the motion.
  subroutine add_constraint_forces(frame, y, forces_alone, f, status, multipliers)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    logical, intent(in) :: forces_alone                ! whether the free motion is left out of f
    real(wp), contiguous, intent(inout) :: f(:)        ! (dimension)
    integer, intent(out) :: status
    real(wp), optional, intent(out) :: multipliers(:)
    type(constraints_t) :: c
    real(wp) :: total(size(f))               ! with the free motion
    real(wp), allocatable :: x(:)

    call constraints_at(frame, y, 2, c, status)
    if (status /= no_stop) return
    total = f
    if (forces_alone) call add_free_motion(frame, y, total)
    associate (m => frame%linkage%forces)
      x = -rates(frame%linkage, c%response, total(m + 1:2 * m)) - c%bias
      call solve_constraints(frame%linkage, c, x)
      call constraint_impulse(frame%linkage, c%gradient, x, f(m + 1:2 * m))
    end associate
    if (present(multipliers)) multipliers = x
  end subroutine add_constraint_forces

  ! Whether joints are closed up to rounding, or nearly, if iterations bring nothing more
  logical function is_closed(c, opening)
    type(constraints_t), intent(in) :: c
    ! the largest |g_i| in roundings of its terms, of the last iteration (huge at first), then of c
    real(wp), intent(inout) :: opening
    real(wp), parameter :: closed = 8, nearly_closed = 1e4_wp
    real(wp) :: opening_before, opening_at_one     ! opening_at_one: with terms of size 1 or more

    opening_before = opening
    opening = maxval(abs(c%g) / max(c%scale, tiny(opening))) / epsilon(opening)
    opening_at_one = maxval(abs(c%g) / max(c%scale, c%min_scale, tiny(opening))) / epsilon(opening)
    if (.not. all(abs(c%g) <= huge(opening))) opening = huge(opening)
    is_closed = opening <= closed &
                .or. (opening_at_one <= nearly_closed .and. .not. opening < opening_before / 2)
    if (.not. opening < huge(opening)) is_closed = .false.
  end function is_closed

  ! Moves a point to where the joints are closed, in the metric of the inertia, and removes the
  ! momenta that would open them. Points that move far beyond the size of the system diverge.
  subroutine close_joints(frame, y, status)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)
    integer, intent(out) :: status
    integer, parameter :: max_iterations = 50
    real(wp), parameter :: max_growth = 30             ! of the size of the system
    type(constraints_t) :: c
    real(wp) :: v(frame%dimension), opening, size_before
    real(wp), allocatable :: x(:)
    integer :: i

    opening = huge(opening)
    do i = 1, max_iterations
      call constraints_at(frame, y, 1, c, status)
      if (status /= no_stop) return
      if (i == 1) size_before = maxval(max(c%scale, c%min_scale))
      if (is_closed(c, opening)) then
        call remove_opening(frame, c, y(frame%linkage%momenta_offset + 1:frame%linkage%momenta_end))
        if (c%exchanged .or. (size_before > 0 .and. maxval(c%scale) > max_growth * size_before)) &
          status = joints_not_solved
        return
      end if
      x = -c%g
      call solve_constraints(frame%linkage, c, x)
      v = 0.0_wp
      call constraint_impulse(frame%linkage, c%response, x, v(:frame%linkage%forces))
      call apply_flows(frame, 1, v, y)
    end do
    status = joints_not_solved
  end subroutine close_joints

  ! Removes the momenta that would open joints; the second time what rounding has left.
  pure subroutine remove_opening(frame, c, momenta)
    type(frame_t), intent(in) :: frame
    type(constraints_t), intent(in) :: c
    real(wp), intent(inout) :: momenta(:)
    real(wp) :: x(size(c%g))
    integer :: i

    do i = 1, 2
      x = -rates(frame%linkage, c%response, momenta)
      call solve_constraints(frame%linkage, c, x)
      call constraint_impulse(frame%linkage, c%gradient, x, momenta)
    end do
  end subroutine remove_opening

  ! Closes the joints of a point between steps, unless they can't be closed.
  subroutine try_close_joints(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(inout) :: y(:)
    real(wp) :: closed(size(y))
    integer :: status

    closed = y
    call close_joints(frame, closed, status)
    if (status == no_stop) y = closed
  end subroutine try_close_joints

end module free_motion_m
