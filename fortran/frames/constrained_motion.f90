! Motion with joints: the forces that keep them closed, and points and momenta without what opens
! them.
module constrained_motion_m
  use kinds, only: wp
  use frames_m, only: apply_flows, frame_t
  use free_motion_m, only: add_free_motion
  use joints_m, only: axes_coincide, constraint_impulse, constraints_t, evaluate_constraints, &
                      factor_constraints, rates, solve_constraints
  use shared_numbers, only: finished, joints_not_solved, raised
  implicit none
  private
  public :: add_constraint_forces, close_joints, constraints_at, is_closed, remove_opening, &
            without_opening

contains

  ! Evaluates the constraints at a point and factors their matrix.
  subroutine constraints_at(frame, y, depth, c, status)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    integer, intent(in) :: depth                       ! see evaluate_constraints
    type(constraints_t), intent(inout) :: c
    integer, intent(out) :: status                     ! finished, raised or joints_not_solved
    logical :: failed

    call evaluate_constraints(frame%linkage, frame%blocks, frame%bodies, y, depth, c, failed)
    if (.not. failed) call factor_constraints(frame%linkage, c)
    status = merge(raised, merge(finished, joints_not_solved, c%known), failed)
  end subroutine constraints_at

  ! Adds the forces of constraints to the coefficients at a point: those for which the second
  ! derivatives of the constraints vanish.
  subroutine add_constraint_forces(frame, y, forces_alone, f, status, multipliers)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    logical, intent(in) :: forces_alone                ! whether the free motion is left out of f
    real(wp), contiguous, intent(inout) :: f(:)        ! (dimension)
    integer, intent(out) :: status
    real(wp), optional, intent(out) :: multipliers(:)
    type(constraints_t) :: c
    real(wp) :: whole(size(f))
    real(wp), allocatable :: x(:)

    call constraints_at(frame, y, 2, c, status)
    if (status /= finished) return
    whole = f
    if (forces_alone) call add_free_motion(frame, y, whole)
    associate (m => frame%linkage%forces)
      x = -rates(frame%linkage, c, whole(m + 1:2 * m)) - c%bias
      call solve_constraints(frame%linkage, c, x)
      call constraint_impulse(frame%linkage, c, .false., x, f(m + 1:2 * m))
    end associate
    if (present(multipliers)) multipliers = x
  end subroutine add_constraint_forces

  ! The largest value of a constraint, in roundings of some sizes
  pure real(wp) function opening(c, sizes)
    type(constraints_t), intent(in) :: c
    real(wp), intent(in) :: sizes(:)

    opening = maxval(abs(c%g) / max(sizes, tiny(sizes))) / epsilon(1.0_wp)
    if (.not. all(abs(c%g) <= huge(c%g))) opening = huge(opening)
  end function opening

  ! Whether an iteration has closed all joints, up to rounding: of the constraints, or of what
  ! they are computed from, where a further iteration brings nothing.
  logical function is_closed(c, last)
    type(constraints_t), intent(in) :: c
    real(wp), intent(inout) :: last          ! the opening before; huge at first
    real(wp), parameter :: closed = 8, nearly_closed = 1e4_wp

    associate (now => opening(c, merge(c%scale, c%least, c%scale > 0)), &
               near => opening(c, max(c%scale, c%least)))
      is_closed = now <= closed .or. (near <= nearly_closed .and. .not. now < last / 2)
      last = now
    end associate
  end function is_closed

  ! Moves a point to where the joints are closed, in the metric of the inertia, and removes the
  ! momenta that would open them. Points that have moved by far more than the size of the system have
  ! diverged.
  subroutine close_joints(frame, y, status)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)
    integer, intent(out) :: status
    integer, parameter :: iterations = 50
    real(wp), parameter :: far = 30
    type(constraints_t) :: c
    real(wp) :: v(frame%dimension), last, size_before
    real(wp), allocatable :: x(:)
    integer :: i

    last = huge(last)
    do i = 1, iterations
      call constraints_at(frame, y, 1, c, status)
      if (status /= finished) return
      if (i == 1) size_before = maxval(max(c%scale, c%least))
      if (is_closed(c, last)) then
        call remove_opening(frame, c, y(frame%linkage%before + 1:frame%linkage%after))
        if (size_before > 0 .and. maxval(c%scale) > far * size_before) status = joints_not_solved
        if (.not. axes_coincide(frame%linkage, frame%blocks, y)) status = joints_not_solved
        return
      end if
      x = -c%g
      call solve_constraints(frame%linkage, c, x)
      v = 0.0_wp
      call constraint_impulse(frame%linkage, c, .true., x, v(:frame%linkage%forces))
      call apply_flows(frame, 1, v, y)
    end do
    status = joints_not_solved
  end subroutine close_joints

  ! Removes the momenta that would open joints; the second time what is left by rounding, which may
  ! be more than what moves.
  pure subroutine remove_opening(frame, c, momenta)
    type(frame_t), intent(in) :: frame
    type(constraints_t), intent(in) :: c
    real(wp), intent(inout) :: momenta(:)
    real(wp) :: x(size(c%g))
    integer :: i

    do i = 1, 2
      x = -rates(frame%linkage, c, momenta)
      call solve_constraints(frame%linkage, c, x)
      call constraint_impulse(frame%linkage, c, .false., x, momenta)
    end do
  end subroutine remove_opening

  ! Closes the joints of a point between steps, unless it has none or they can't be closed.
  subroutine without_opening(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(inout) :: y(:)
    real(wp) :: closed(size(y))
    integer :: status

    if (.not. frame%jointed) return
    closed = y
    call close_joints(frame, closed, status)
    if (status == finished) y = closed
  end subroutine without_opening

end module constrained_motion_m
