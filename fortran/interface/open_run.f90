! Opens a run: makes a problem, lanes and views of the caller's memory from the record of the run, a
! structure of numbers and addresses that Python fills (RECORD in cg/support/shared_records.py).
module open_run_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_f_procpointer, c_int, c_intptr_t, &
                                         c_null_funptr, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int64
  use events_m, only: observer_t
  use coordinates_m, only: tolerances_t
  use free_motion_m, only: make_bodies
  use kinds, only: wp
  use method_m, only: reals
  use run_m, only: plan_t, run_t
  use shared_numbers
  use trajectory_m, only: reserve_trajectory
  implicit none
  private
  public :: open_run, set_inputs, set_output

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
    call set_lanes(run, memory)
    if (memory /= 0) return
    if (run%record%observations > 0) then
      call set_observer(run, int(run%record%observations), run%record%observers, &
                        run%record%observer_table, run%record%observer, run%record%observer_data, &
                        run%record%observer_stride, run%observer)
      run%output%observer => run%observer
    end if
    if (run%record%step_functions > 0 .or. run%record%step_function /= 0) then
      call set_observer(run, 1, run%record%step_functions, run%record%step_function_table, &
                        run%record%step_function, run%record%step_function_data, &
                        run%record%step_function_stride, run%step_function)
      run%problem%step_function => run%step_function
    end if
  end subroutine open_run

  ! Sets the frame, the method and the right-hand side of a problem.
  subroutine set_problem(plan, run)
    type(plan_t), target, intent(in) :: plan
    type(run_t), target, intent(inout) :: run

    associate (problem => run%problem, record => run%record, field => run%field)
      run%frame = plan%frame
      run%python%context = transfer(record%context, c_null_ptr)
      if (record%context /= 0) run%frame%callback => run%python
      run%frame%dropped => run%record%dropped
      run%frame%dropped_at => run%record%dropped_at
      call c_f_procpointer(transfer(record%function, c_null_funptr), field%rhs)
      field%data_address = record%data
      field%data_stride = record%data_stride
      call set_inputs(run)
      problem%frame => run%frame
      problem%inner => run%inner
      if (record%vectorized == 0) problem%field => run%field
      problem%method => plan%method
      problem%scheme => plan%scheme
      problem%common = record%common /= 0
      problem%goes_on = record%goes_on /= 0
      problem%of_time = record%of_time /= 0
      problem%record => run%record
      problem%jacobian_is_matrix = record%jacobian /= sparse_jacobian
    end associate
  end subroutine set_problem

  ! Sets the sizes of steps and their tolerances, of which those in the record may be fewer.
  subroutine set_tolerances(run)
    type(run_t), intent(inout) :: run
    real(wp), pointer, contiguous :: rtols(:), atol(:)
    integer :: i, n

    associate (problem => run%problem, record => run%record)
      problem%stops = reals(record%stops, record%segments)
      problem%adaptive = .not. record%h > 0
      n = merge(run%frame%dimension, run%frame%point_size, record%in_coordinates /= 0)
      call c_f_pointer(transfer(record%atol, c_null_ptr), atol, [int(record%tolerance_count)])
      call c_f_pointer(transfer(record%rtols, c_null_ptr), rtols, [int(record%tolerance_count)])
      problem%tolerances = tolerances_t(atol=[(atol(1 + (i - 1) / (n / size(atol))), i = 1, n)], &
        rtols=[(rtols(1 + (i - 1) / (n / size(rtols))), i = 1, n)], rtol=record%rtol, &
        in_coordinates=record%in_coordinates /= 0, parts=int(record%parts), &
        exponent=record%exponent, max_step=record%max_step)
      if (problem%adaptive) then
        run%frame%blocks%action%rtol = record%rtol
        run%frame%blocks%action%atol = minval(atol)
        problem%duration = abs(problem%stops(size(problem%stops)) - record%t0)
      end if
    end associate
  end subroutine set_tolerances

  ! Makes the lanes, and the views of what is stored of each member.
  subroutine set_lanes(run, memory)
    type(run_t), target, intent(inout) :: run
    integer, intent(out) :: memory           ! nonzero if there isn't enough
    logical :: within
    integer :: i, lanes, members

    associate (record => run%record, n => run%frame%point_size)
      members = int(record%members)
      lanes = int(record%lanes)
      call c_f_pointer(transfer(record%states, c_null_ptr), run%states, [n + 2, members])
      call c_f_pointer(transfer(record%counters, c_null_ptr), run%counters, [members])
      run%states(n + 1:, :) = record%t0
      run%counters(:) = counters_t(status=paused)
      within = run%problem%scheme%columns > 0 .and. (record%dense /= 0 .or. record%outputs > 0 &
                      .or. associated(run%problem%events))
      allocate (run%busy(lanes), run%asks(lanes), source=.false., stat=memory)
      if (memory == 0) allocate (run%lanes(lanes), stat=memory)
      if (memory /= 0) return
      do i = 1, size(run%lanes)
        call reserve_trajectory(run%problem, within, record%keep_last /= 0, run%lanes(i), memory)
        if (memory /= 0) return
        run%lanes(i)%member = i
      end do
    end associate
  end subroutine set_lanes

  ! Sets the inputs of functions, and the limits of steps due to them, from the record.
  subroutine set_inputs(run)
    type(run_t), intent(inout) :: run

    run%problem%limits = reshape(reals(run%record%limits, 2 * run%record%limited), &
                                 [2_int64, run%record%limited])
    if (run%record%curves == 0) return
    call c_f_pointer(transfer(run%record%inputs, c_null_ptr), run%field%inputs, &
                     [7, int(run%record%curves)])
    run%events%inputs => run%field%inputs
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
    run%events%member_data = run%record%data
    run%events%stride = run%record%data_stride
    run%events%callback = run%python
    run%problem%events => run%events
  end subroutine set_events

  ! Sets a function along the solution: one in Python, or some in C whose table is given.
  subroutine set_observer(run, count, functions, table_address, function, data, stride, observer)
    type(run_t), intent(in) :: run
    integer, intent(in) :: count
    integer(int64), intent(in) :: functions, stride
    integer(c_intptr_t), intent(in) :: table_address, function, data
    type(observer_t), intent(inout) :: observer

    observer%count = count
    if (functions > 0) then
      observer%functions%count = int(functions)
      call c_f_pointer(transfer(table_address, c_null_ptr), observer%functions%table, [functions])
      observer%functions%member_data = data
      observer%functions%stride = int(stride, c_intptr_t)
      observer%functions%inputs => run%field%inputs
    else
      call c_f_procpointer(transfer(function, c_null_funptr), observer%field%rhs)
      observer%field%data_address = data
      observer%field%data_stride = int(stride, c_intptr_t)
    end if
  end subroutine set_observer

  ! Makes the views of the caller's output arrays, which may have changed.
  subroutine set_output(run)
    type(run_t), target, intent(inout) :: run

    associate (record => run%record, output => run%output, n => int(run%frame%point_size, int64), &
               columns => int([run%frame%dimension, run%problem%scheme%columns], int64), &
               outputs => run%record%outputs, members => run%record%members, &
               observations => run%record%observations, steps => run%record%step_capacity, &
               dense => run%record%dense_capacity, events => run%record%event_capacity)
      output%outputs = int(outputs)
      call c_f_pointer(transfer(record%times, c_null_ptr), output%times, [outputs])
      if (record%y /= 0) &
        call c_f_pointer(transfer(record%y, c_null_ptr), output%y, [n, members, outputs])
      if (record%observed /= 0) &
        call c_f_pointer(transfer(record%observed, c_null_ptr), output%observed, &
                         [observations, members, outputs])
      output%record => record
      call c_f_pointer(transfer(record%step_t, c_null_ptr), output%step_t, [steps])
      if (record%step_y /= 0) &
        call c_f_pointer(transfer(record%step_y, c_null_ptr), output%step_y, [n, steps])
      if (record%step_observed /= 0) &
        call c_f_pointer(transfer(record%step_observed, c_null_ptr), output%step_observed, &
                         [observations, steps])
      output%dense = record%dense /= 0
      call c_f_pointer(transfer(record%dense_member, c_null_ptr), output%dense_member, [dense])
      call c_f_pointer(transfer(record%dense_t, c_null_ptr), output%dense_t, [4_int64, dense])
      call c_f_pointer(transfer(record%dense_y, c_null_ptr), output%dense_y, [n, 2_int64, dense])
      call c_f_pointer(transfer(record%dense_field, c_null_ptr), output%dense_field, &
                       [columns, dense])
      call c_f_pointer(transfer(record%event_of, c_null_ptr), output%event_of, [2_int64, events])
      call c_f_pointer(transfer(record%event_t, c_null_ptr), output%event_t, [events])
      call c_f_pointer(transfer(record%event_y, c_null_ptr), output%event_y, [n, 2_int64, events])
    end associate
  end subroutine set_output

end module open_run_m
