! Opens a run: makes a problem, lanes and views of the caller's memory from the record of the run, a
! structure of numbers and addresses that Python fills (RECORD in cg/support/shared_records.py).
module open_run_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_f_procpointer, c_int, c_intptr_t, &
                                         c_null_funptr, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int8, int64
  use events_m, only: observer_t
  use coordinates_m, only: tolerances_t
  use free_motion_m, only: make_bodies
  use kinds, only: wp
  use method_m, only: reals
  use run_m, only: plan_t, run_t
  use shared_numbers
  use trajectory_m, only: exchange_state, reserve_trajectory
  use inputs_m, only: member_data_t
  implicit none
  private
  public :: open_run, set_inputs

contains

  ! Opens the run of a plan whose record is set.
  subroutine open_run(plan, run, memory)
    type(plan_t), target, intent(in) :: plan
    type(run_t), target, intent(inout) :: run
    integer, intent(out) :: memory           ! nonzero if there isn't enough

    call set_problem(plan, run)
    call set_tolerances(run)
    if (run%record%body_numbers > 0) call set_bodies(run)
    if (run%record%event_functions > 0) call set_events(run)
    call set_observer(run, run%record%observer, run%output%observer)
    call set_observer(run, run%record%step_function, run%step_function)
    call set_output(run)
    call set_lanes(run, memory)
  end subroutine open_run

  ! Sets the frame, the method and the right-hand side of a problem.
  subroutine set_problem(plan, run)
    type(plan_t), target, intent(in) :: plan
    type(run_t), target, intent(inout) :: run

    associate (record => run%record)
      run%frame = plan%frame
      run%python%context = transfer(record%context, c_null_ptr)
      if (record%context /= 0) run%frame%callback => run%python
      run%frame%dropped => record%dropped
      run%frame%dropped_at => record%dropped_at
      run%method => plan%method
      call c_f_procpointer(transfer(record%function, c_null_funptr), run%field%rhs)
      call set_inputs(run)
    end associate
  end subroutine set_problem

  ! Sets the ends of segments and the tolerances.
  subroutine set_tolerances(run)
    type(run_t), intent(inout) :: run
    integer(int64) :: n

    associate (record => run%record)
      run%stops = reals(record%stops, record%segments)
      run%adaptive = .not. record%h > 0
      n = merge(run%frame%dimension, run%frame%point_size, record%in_coordinates)
      run%tolerances = tolerances_t(atol=reals(record%atol, n), rtols=reals(record%rtols, n), &
        rtol=record%rtol, in_coordinates=logical(record%in_coordinates), parts=int(record%parts), &
        exponent=record%exponent, max_step=record%max_step)
      if (run%adaptive) then
        run%frame%blocks%action%rtol = record%rtol
        run%frame%blocks%action%atol = minval(run%tolerances%atol)
        run%duration = abs(run%stops(size(run%stops)) - record%t0)
      end if
    end associate
  end subroutine set_tolerances

  ! Makes the lanes, and the views of what is stored of each member.
  subroutine set_lanes(run, memory)
    type(run_t), target, intent(inout) :: run
    integer, intent(out) :: memory           ! nonzero if there isn't enough
    logical :: within
    integer :: i, lanes, members
    integer(int8) :: none(0)

    associate (record => run%record, n => run%frame%point_size)
      members = int(record%members)
      lanes = int(record%lanes)
      call c_f_pointer(transfer(record%states, c_null_ptr), run%states, [n + 4, members])
      call c_f_pointer(transfer(record%counters, c_null_ptr), run%counters, [members])
      run%states(n + 1:, :) = record%t0
      run%counters(:) = counters_t(status=paused)
      within = record%dense .or. record%outputs > 0 .or. run%events%count > 0
      allocate (run%busy(lanes), source=.false., stat=memory)
      if (memory == 0) allocate (run%lanes(lanes), stat=memory)
      if (memory /= 0) return
      do i = 1, size(run%lanes)
        call reserve_trajectory(run%problem_t, within, logical(record%keep_last), run%lanes(i), memory)
        if (memory /= 0) return
        run%lanes(i)%member = i
      end do
      call exchange_state(run%lanes(1), .false., none, i)
      record%state_size = i
    end associate
  end subroutine set_lanes

  ! Sets the inputs of functions, and the limits of steps due to them, from the record.
  subroutine set_inputs(run)
    type(run_t), intent(inout) :: run

    run%limits = reshape(reals(run%record%limits, 2 * run%record%limited), &
                         [2_int64, run%record%limited])
    run%field%data = member_data_t(run%record%data, int(run%record%data_stride, c_intptr_t))
    if (run%record%curves > 0) call c_f_pointer(transfer(run%record%inputs, c_null_ptr), &
                                                run%field%data%inputs, [7, int(run%record%curves)])
    run%events%data = run%field%data
  end subroutine set_inputs

  ! Sets the inertia of each member.
  subroutine set_bodies(run)
    type(run_t), intent(inout) :: run
    integer(c_int), pointer, contiguous :: columns(:, :)
    real(wp), pointer, contiguous :: numbers(:, :)
    integer :: bodies, i, members

    bodies = size(run%frame%bodies)
    members = int(run%record%members)
    call c_f_pointer(transfer(run%record%bodies, c_null_ptr), columns, [bodies, members])
    call c_f_pointer(transfer(run%record%body_constants, c_null_ptr), numbers, &
                     [int(run%record%body_numbers), members])
    allocate (run%bodies(bodies, members))
    do i = 1, members
      call make_bodies(columns(:, i), numbers(:, i), run%frame, run%bodies(:, i))
    end do
  end subroutine set_bodies

  ! Sets the events of a run from the table in the record.
  subroutine set_events(run)
    type(run_t), target, intent(inout) :: run

    run%events%count = int(run%record%event_functions)
    call c_f_pointer(transfer(run%record%event_table, c_null_ptr), run%events%table, &
                     [run%events%count])
    run%events%width = int(run%record%event_width)
    run%events%vectorized = any(run%events%table%vectorized /= 0) .and. run%record%lanes > 1
    run%events%callback = run%python
  end subroutine set_events

  ! Sets a function along the solution from the record at an address, if there is one.
  subroutine set_observer(run, address, observer)
    type(run_t), intent(in) :: run
    integer(c_intptr_t), intent(in) :: address
    type(observer_t), intent(inout) :: observer
    type(observer_record_t), pointer :: record

    if (address == 0) return
    call c_f_pointer(transfer(address, c_null_ptr), record)
    observer%count = int(record%count)
    observer%field%data = member_data_t(record%data, int(record%stride, c_intptr_t))
    if (record%functions > 0) then
      observer%functions%count = int(record%functions)
      call c_f_pointer(transfer(record%table, c_null_ptr), observer%functions%table, &
                       [record%functions])
      observer%functions%data = observer%field%data
      observer%functions%data%inputs => run%field%data%inputs
    else
      call c_f_procpointer(transfer(record%function, c_null_funptr), observer%field%rhs)
    end if
  end subroutine set_observer

  ! Makes the views of the caller's output arrays, and rows of what is stored of steps.
  subroutine set_output(run)
    type(run_t), target, intent(inout) :: run

    associate (record => run%record, output => run%output, n => int(run%frame%point_size, int64), &
               m => run%frame%dimension * run%method%scheme%columns, &
               observations => int(run%output%observer%count, int64))
      output%record => record
      output%outputs = int(record%outputs)
      call c_f_pointer(transfer(record%times, c_null_ptr), output%times, [record%outputs])
      if (record%y /= 0) call c_f_pointer(transfer(record%y, c_null_ptr), output%y, &
                                          [n, record%members, record%outputs])
      if (record%observed /= 0) &
        call c_f_pointer(transfer(record%observed, c_null_ptr), output%observed, &
                         [observations, record%members, record%outputs])
      allocate (output%steps(1 + merge(n, 0_int64, record%keeps_points) + observations, 0), &
                output%interpolants(5 + 2 * n + m, 0), output%events(3 + 2 * n, 0))
    end associate
  end subroutine set_output

end module open_run_m
