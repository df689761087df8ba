! Interface for f2py of plans and runs, which stay in memory between calls, at addresses.
module api_run_m
  use, intrinsic :: iso_c_binding, only: c_bool, c_f_pointer, c_intptr_t, c_loc, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int8, int64
  use callback_m, only: callback_t
  use collocation_m, only: factor_again
  use frames_m, only: distance_bound, frame_t, make_frame
  use free_motion_m, only: make_bodies
  use joints_m, only: make_linkage
  use kinds, only: wp
  use method_m, only: make_method, reals
  use output_m, only: evaluate_stored
  use run_m, only: drive, open_run, plan_at, plan_t, run_at, run_t, read_functions, store_lane, wake
  use shared_numbers, only: callback_block, events_stored, interpolants_stored, &
                            linear_action_block, method_record_t, steps_stored, terminal_event
  use trajectory_m, only: continue_trajectory, exchange_state, set_start
  implicit none

contains

  ! Makes a plan from a frame and a method, or of a frame alone.
  subroutine plan_open(blocks, description, numbers, constants, derivatives, method_address, &
                       address) bind(c)
    integer, intent(in) :: blocks, numbers, description(3, blocks)
    real(wp), intent(in) :: constants(numbers)
    logical(c_bool), intent(in) :: derivatives     ! whether right-hand sides give those of points
    integer(c_intptr_t), intent(in) :: method_address    ! address of a method_record_t, or 0
    integer(c_intptr_t), intent(out) :: address
    type(plan_t), pointer :: plan
    type(method_record_t), pointer :: record

    allocate (plan)
    call make_frame(description, constants, plan%frame)
    plan%frame%derivatives = derivatives
    plan%frame%python_derivatives = any(plan%frame%blocks%kind == callback_block &
                                        .or. plan%frame%blocks%kind == linear_action_block)
    address = transfer(c_loc(plan), address)
    if (method_address == 0) return
    call c_f_pointer(transfer(method_address, c_null_ptr), record)
    call make_method(record, plan%method)
  end subroutine plan_open

  ! Gives the frame of a plan inertia; see make_bodies.
  subroutine plan_set_bodies(address, bodies, columns, numbers, constants, tangents, &
                             alloc_status) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: bodies, numbers, columns(bodies), tangents
    real(wp), intent(in) :: constants(numbers)
    integer, intent(out) :: alloc_status           ! nonzero if there isn't enough memory
    type(plan_t), pointer :: plan

    plan => plan_at(address)
    plan%frame%momenta_offset = plan%frame%blocks(bodies + 1)%p1 - 1
    plan%frame%forces = plan%frame%blocks(bodies + 1)%dimension
    plan%frame%tangents = tangents
    allocate (plan%frame%bodies(bodies), stat=alloc_status)
    if (alloc_status == 0) &
      call make_bodies(columns, constants, plan%frame, plan%frame%bodies, alloc_status)
  end subroutine plan_set_bodies

  ! Gives the frame of a plan with inertia joints; see make_linkage.
  subroutine plan_set_joints(address, bodies, body_blocks, rows, integers, joints, numbers, &
                             user_rows, context) bind(c)
    integer(c_intptr_t), intent(in) :: address, context  ! context: evaluates the user's rows
    integer, intent(in) :: bodies, rows, joints, user_rows
    ! the last columns are unused, since no array may be empty
    integer, intent(in) :: body_blocks(2, bodies), integers(3, rows)
    real(wp), intent(in) :: numbers(13, joints)
    type(plan_t), pointer :: plan

    plan => plan_at(address)
    associate (frame => plan%frame)
      call make_linkage(frame%blocks, frame%forces, body_blocks(:, :bodies - 1), &
                        integers(:, :rows - 1), numbers(:, :joints - 1), user_rows, frame%linkage)
      frame%linkage%python%context = transfer(context, c_null_ptr)
      frame%jointed = .true.
    end associate
  end subroutine plan_set_joints

  ! Gives the frame of a plan the joints of a phase space, which is this frame or its first factor.
  subroutine plan_share_joints(address, space) bind(c)
    integer(c_intptr_t), intent(in) :: address, space    ! addresses of plans
    type(plan_t), pointer :: plan, other

    plan => plan_at(address)
    other => plan_at(space)
    if (.not. associated(plan%frame%bodies)) allocate (plan%frame%bodies, source=other%frame%bodies)
    plan%frame%linkage = other%frame%linkage
    plan%frame%jointed = .true.
  end subroutine plan_share_joints

  ! No less than the distances of points from the manifold; see distance_bound.
  subroutine plan_distance_bound(address, n, members, y, bound) bind(c)
    !f2py threadsafe
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, members
    real(wp), intent(in) :: y(n, members)
    real(wp), intent(out) :: bound                       ! bound of all distances
    type(plan_t), pointer :: plan
    integer :: i

    plan => plan_at(address)
    bound = maxval([0.0_wp, (distance_bound(plan%frame, y(:, i)), i=1, members)])
  end subroutine plan_distance_bound

  subroutine plan_close(address) bind(c)
    integer(c_intptr_t), intent(in) :: address
    type(plan_t), pointer :: plan

    plan => plan_at(address)
    if (associated(plan%frame%bodies)) deallocate (plan%frame%bodies)
    deallocate (plan)
  end subroutine plan_close

  ! Opens a run of a plan from its record.
  subroutine run_open(plan_address, record_address, address) bind(c)
    integer(c_intptr_t), intent(in) :: plan_address, record_address
    integer(c_intptr_t), intent(out) :: address          ! 0 if there isn't enough memory
    type(run_t), pointer :: run
    integer :: alloc_status

    allocate (run)
    call c_f_pointer(transfer(record_address, c_null_ptr), run%record)
    call open_run(plan_at(plan_address), run, alloc_status)
    address = transfer(c_loc(run), address)
    if (alloc_status == 0) return
    address = 0
    deallocate (run)
  end subroutine run_open

  subroutine run_close(address) bind(c)
    integer(c_intptr_t), intent(in) :: address
    type(run_t), pointer :: run

    run => run_at(address)
    deallocate (run)
  end subroutine run_close

  ! Advances all members; see drive.
  subroutine run_drive(address) bind(c)
    !f2py threadsafe
    integer(c_intptr_t), intent(in) :: address

    call drive(run_at(address))
  end subroutine run_drive

  ! Copies the rows that the last call of run_drive has stored of steps, interpolants or events.
  subroutine run_rows(address, stored, n, used, rows) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: stored, n, used         ! stored: a Stored; used: number of rows
    real(wp), intent(inout) :: rows(n, used)
    type(run_t), pointer :: run

    run => run_at(address)
    if (stored == steps_stored) rows = run%output%steps(:, :used)
    if (stored == interpolants_stored) rows = run%output%interpolants(:, :used)
    if (stored == events_stored) rows = run%output%events(:, :used)
  end subroutine run_rows

  ! Lets trajectories continue to the ends of segments in the record, or requests the interpolants
  ! of their last steps, which run_drive stores; not of members ended by terminal events.
  subroutine run_continue(address, interpolating) bind(c)
    integer(c_intptr_t), intent(in) :: address
    logical(c_bool), intent(in) :: interpolating
    type(run_t), pointer :: run
    integer :: i

    run => run_at(address)
    run%stops = reals(run%record%stops, run%record%segments)
    call wake(run)
    do i = 1, size(run%lanes)
      if (run%busy(i)) call continue_trajectory(run%lanes(i), logical(interpolating))
    end do
  end subroutine run_continue

  ! Starts trajectories from other points or another time, with the data in the record.
  subroutine run_restart(address, n, members, t, y, first_step, stopped) bind(c)
    integer(c_intptr_t), intent(in) :: address
    integer, intent(in) :: n, members
    real(wp), intent(in) :: t, y(n, members), first_step   ! first_step: see set_start
    integer(int8), intent(in) :: stopped(members)      ! 1 for those that a terminal event has ended
    type(run_t), pointer :: run
    integer :: i

    run => run_at(address)
    call read_functions(run)
    do i = 1, members
      if (stopped(i) == 0_int8) call set_start(t, y(:, i), first_step, run%lanes(i))
      if (stopped(i) /= 0_int8) run%lanes(i)%status = terminal_event
      call store_lane(run, i)
    end do
    call wake(run)
  end subroutine run_restart

  ! Copies the states of trajectories to bytes, or restores them.
  subroutine run_state(address, restores, count, members, bytes) bind(c)
    integer(c_intptr_t), intent(in) :: address
    logical(c_bool), intent(in) :: restores
    integer, intent(in) :: count, members
    integer(int8), intent(inout) :: bytes(count, members)  ! see exchange_state
    type(run_t), pointer :: run
    integer :: i
    integer(int64) :: used

    run => run_at(address)
    do i = 1, members
      call exchange_state(run%lanes(i), logical(restores), bytes(:, i), used)
      if (.not. restores) cycle
      call factor_again(run%lanes(i))
      call store_lane(run, i)
    end do
    if (restores) call wake(run)
  end subroutine run_state

  ! Evaluates stored interpolants at fractions of their steps.
  subroutine plan_interpolate(address, context, count, steps, n, m, step, theta, rows, y, &
                              alloc_status) bind(c)
    !f2py threadsafe
    integer(c_intptr_t), intent(in) :: address, context
    integer, intent(in) :: count, steps, n, m, step(count)     ! step: the row of each point, from 0
    real(wp), intent(in) :: theta(count), rows(m, steps)  ! rows: interpolants of output_t
    real(wp), intent(inout) :: y(n, count)
    integer, intent(out) :: alloc_status     ! nonzero if there isn't enough memory
    type(plan_t), pointer :: plan
    type(frame_t) :: frame                   ! with this call's context
    type(callback_t), target :: python

    plan => plan_at(address)
    if (context == 0) then
      call evaluate_stored(plan%frame, plan%method%scheme, rows, step, theta, y, alloc_status)
      return
    end if
    frame = plan%frame
    python%context = transfer(context, c_null_ptr)
    frame%callback => python
    call evaluate_stored(frame, plan%method%scheme, rows, step, theta, y, alloc_status)
  end subroutine plan_interpolate

end module api_run_m
