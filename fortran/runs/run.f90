! Runs of any number of trajectories. A run has lanes, each of which integrates one member at a time
! and takes the next one when it has ended: one lane for functions of one point; one for each member
! with common steps or for a Stepper; many lanes for a vectorized function, which is called once for
! all lanes that need coefficients, or values of an event. A run is opened from its record, a
! structure of numbers and addresses that Python fills (RUN in cg/support/shared_records.py).
module run_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_f_procpointer, c_int, c_int64_t, &
                                         c_intptr_t, c_null_funptr, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int8, int64
  use blocks_m, only: body_t
  use callback_m, only: callback_t
  use coordinates_m, only: tolerances_t
  use derivatives_m, only: coefficients_of
  use events_m, only: observer_t
  use frames_m, only: distance_bound, frame_t
  use free_motion_m, only: make_bodies
  use inputs_m, only: member_data_t
  use kinds, only: wp
  use loop_m, only: resume
  use method_m, only: method_t, reals
  use output_m, only: output_t, store_point, store_step
  use requests_m, only: check_coefficients
  use shared_numbers, only: counters_t, event_columns, events_operation, finished, &
                            interpolant_columns, needs_events, needs_maximum, needs_rhs, no_stop, &
                            observer_failed, observer_record_t, out_of_memory, paused, &
                            polynomial_kind, raised, raised_in_python, rhs_operation, &
                            state_columns, terminal_event
  use step_m, only: get_times, receive_answers, times_asked
  use trajectory_m, only: exchange_state, fail, problem_t, query_event, query_member, &
                          query_numbers, query_time, reserve_trajectory, set_start, trajectory_t
  implicit none
  private
  public :: plan_t, run_t, drive, open_run, plan_at, run_at, read_functions, store_lane, wake

  ! A frame and a method, prepared for any number of runs
  type :: plan_t
    type(frame_t) :: frame
    type(method_t) :: method
  end type plan_t

  type, extends(problem_t) :: run_t
    type(body_t), allocatable :: bodies(:, :)          ! (bodies, members) where they differ
    type(callback_t) :: python
    type(trajectory_t), allocatable :: lanes(:)
    logical, allocatable :: busy(:)          ! (lanes)
    integer :: next = 1                      ! the member that starts next
    ! views of the caller's memory
    type(output_t) :: output
    real(wp), pointer, contiguous :: states(:, :) => null()            ! see STATE
    type(counters_t), pointer, contiguous :: counters(:) => null()      ! (members)
  end type run_t

contains

  function plan_at(address) result(plan)
    integer(c_intptr_t), intent(in) :: address
    type(plan_t), pointer :: plan

    call c_f_pointer(transfer(address, c_null_ptr), plan)
  end function plan_at

  function run_at(address) result(run)
    integer(c_intptr_t), intent(in) :: address
    type(run_t), pointer :: run

    call c_f_pointer(transfer(address, c_null_ptr), run)
  end function run_at

  ! Makes a run from its record, for a plan.
  subroutine open_run(plan, run, alloc_status)
    type(plan_t), target, intent(in) :: plan
    type(run_t), target, intent(inout) :: run
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed

    call set_problem(plan, run)
    call set_observer(run, run%record%observer, run%output%observer)
    call set_output(run)
    call set_lanes(run, alloc_status)
    if (alloc_status == 0 .and. run%record%bodies /= 0) call set_bodies(run, alloc_status)
  end subroutine open_run

  ! Takes the problem that all trajectories solve from the plan and the record.
  subroutine set_problem(plan, run)
    type(plan_t), target, intent(in) :: plan
    type(run_t), target, intent(inout) :: run
    integer(int64) :: n

    associate (record => run%record)
      run%frame = plan%frame
      run%python%context = transfer(record%context, c_null_ptr)
      if (record%context /= 0) run%frame%callback => run%python
      run%frame%dropped => run%record%dropped
      run%frame%dropped_at => run%record%dropped_at
      run%method => plan%method
      call c_f_procpointer(transfer(record%function, c_null_funptr), run%rhs%function)
      call read_functions(run)
      if (record%event_functions > 0) call c_f_pointer(transfer(record%event_table, c_null_ptr), &
                                                       run%events%table, [record%event_functions])
      run%events%count = int(record%event_functions)
      run%events%width = int(record%event_width)
      run%events%callback = run%python
      if (run%events%count > 0) &
        run%events%vectorized = any(run%events%table%vectorized /= 0) .and. record%lanes > 1
      run%stops = reals(record%stops, record%segments)
      run%adaptive = .not. record%h > 0
      n = int(merge(run%frame%dimension, run%frame%point_size, record%in_coordinates), int64)
      run%tolerances = tolerances_t(atol=spread(record%atol, 1, int(n)), &
        rtols=spread(record%rtol, 1, int(n)), rtol=record%rtol, &
        in_coordinates=logical(record%in_coordinates), exponent=record%exponent, &
        reals_per_entry=int(record%reals_per_entry), max_step=record%max_step)
      if (record%tolerances /= 0) then
        run%tolerances%rtols = reals(record%tolerances, n)
        run%tolerances%atol = reals(record%tolerances + 8 * n, n)
      end if
      if (run%adaptive) then
        run%frame%blocks%action%rtol = record%rtol
        run%frame%blocks%action%atol = minval(run%tolerances%atol)
        run%duration = abs(run%stops(size(run%stops)) - record%t0)
      end if
    end associate
  end subroutine set_problem

  ! Makes the lanes, and the views of what is stored of each member.
  subroutine set_lanes(run, alloc_status)
    type(run_t), target, intent(inout) :: run
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed
    integer, parameter :: max_inner = 64, max_inner_numbers = 2**22
    integer :: i, members, points            ! points: that one flow along a polynomial computes
    integer(int8) :: none(0)

    associate (record => run%record, n => run%frame%point_size)
      members = int(record%members)
      call c_f_pointer(transfer(record%states, c_null_ptr), run%states, &
                       [n + state_columns, members])
      call c_f_pointer(transfer(record%counters, c_null_ptr), run%counters, [members])
      run%states(n + 1:, :) = record%t0
      run%counters(:) = counters_t(status=paused)
      points = merge(run%output%outputs, 0, run%method%kind == polynomial_kind)
      points = min(points, max_inner, max(1, max_inner_numbers / n))
      allocate (run%busy(record%lanes), source=.false., stat=alloc_status)
      if (alloc_status == 0) allocate (run%lanes(record%lanes), run%inner%theta(points), &
                                       run%inner%y(n, points), stat=alloc_status)
      if (alloc_status /= 0) return
      do i = 1, size(run%lanes)
        call reserve_trajectory(run%problem_t, run%lanes(i), alloc_status)
        if (alloc_status /= 0) return
        run%lanes(i)%member = i
      end do
      call exchange_state(run%lanes(1), .false., none, record%state_size)
    end associate
  end subroutine set_lanes

  ! Sets the inputs of functions, the limits of steps due to them, and the function of step sizes.
  subroutine read_functions(run)
    type(run_t), intent(inout) :: run

    run%step_limits = reshape(reals(run%record%limits, 2 * run%record%limited), &
                              [2_int64, run%record%limited])
    run%rhs%data = member_data_t(run%record%data, int(run%record%data_stride, c_intptr_t))
    if (run%record%curves > 0) call c_f_pointer(transfer(run%record%inputs, c_null_ptr), &
                                                run%rhs%data%inputs, [run%record%curves])
    run%events%data = run%rhs%data
    call set_observer(run, run%record%step_function, run%step_function)
  end subroutine read_functions

  ! Makes the bodies of members with inertia of their own.
  subroutine set_bodies(run, alloc_status)
    type(run_t), intent(inout) :: run
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed
    integer(c_int), pointer, contiguous :: columns(:, :)
    real(wp), pointer, contiguous :: numbers(:, :)
    integer :: bodies, i, members

    bodies = size(run%frame%bodies)
    members = int(run%record%members)
    call c_f_pointer(transfer(run%record%bodies, c_null_ptr), columns, [bodies, members])
    call c_f_pointer(transfer(run%record%body_constants, c_null_ptr), numbers, &
                     [int(run%record%constants_per_member), members])
    allocate (run%bodies(bodies, members), stat=alloc_status)
    do i = 1, members
      if (alloc_status /= 0) return
      call make_bodies(columns(:, i), numbers(:, i), run%frame, run%bodies(:, i), alloc_status)
    end do
  end subroutine set_bodies

  ! Sets a function along the solution from the record at an address, if there is one.
  subroutine set_observer(run, address, observer)
    type(run_t), intent(in) :: run
    integer(c_intptr_t), intent(in) :: address
    type(observer_t), intent(inout) :: observer
    type(observer_record_t), pointer :: record

    if (address == 0) return
    call c_f_pointer(transfer(address, c_null_ptr), record)
    observer%count = int(record%count)
    observer%rhs%data = member_data_t(record%data, int(record%stride, c_intptr_t))
    if (record%functions > 0) then
      observer%functions%count = int(record%functions)
      call c_f_pointer(transfer(record%table, c_null_ptr), observer%functions%table, &
                       [record%functions])
      observer%functions%data = observer%rhs%data
      observer%functions%data%inputs => run%rhs%data%inputs
    else
      call c_f_procpointer(transfer(record%function, c_null_funptr), observer%rhs%function)
    end if
  end subroutine set_observer

  ! Makes the views of the caller's output arrays, and rows of what is stored of steps.
  subroutine set_output(run)
    type(run_t), target, intent(inout) :: run

    associate (record => run%record, output => run%output, n => int(run%frame%point_size, int64), &
               m => int(run%frame%dimension * run%method%scheme%vectors, int64), &
               observations => int(run%output%observer%count, int64))
      output%record => record
      output%outputs = int(record%outputs)
      call c_f_pointer(transfer(record%times, c_null_ptr), output%times, [record%outputs])
      if (record%y /= 0) call c_f_pointer(transfer(record%y, c_null_ptr), output%y, &
                                          [n, record%members, record%outputs])
      if (record%observed /= 0) call c_f_pointer(transfer(record%observed, c_null_ptr), &
        output%observed, [observations, record%members, record%outputs])
      allocate (output%steps(1 + merge(n, 0_int64, record%keeps_points) + observations, 0), &
                output%interpolants(interpolant_columns + 2 * n + m, 0), &
                output%events(event_columns + 2 * n, 0))
    end associate
  end subroutine set_output

  ! Lets all lanes go on with their members, but for those that a terminal event has ended.
  subroutine wake(run)
    type(run_t), intent(inout) :: run

    run%busy = run%record%goes_on .or. run%lanes%status /= terminal_event
    run%next = size(run%lanes) + 1
    run%record%ended = count(.not. run%busy, kind=c_int64_t)
    run%record%failed = 0
    run%record%raised = .false.
  end subroutine wake

  ! Advances all lanes until all members have ended, or the budget of steps is used up. Lanes with
  ! common steps have equal shares of it, so that none is ahead of the others. Other lanes of a
  ! vectorized function advance in rounds, up to where all of them wait for coefficients or values;
  ! the budget ends a call between rounds, so that calls of functions don't depend on it. Values of
  ! events are answered first, so that lanes wait for coefficients together.
  subroutine drive(run)
    type(run_t), target, intent(inout) :: run
    integer(int64) :: budget, share(size(run%lanes))
    integer :: i, status
    logical :: any_waits, any_paused         ! whether a lane waits for the maximum, or has paused
    logical :: in_rounds

    budget = run%record%budget
    in_rounds = size(run%lanes) > 1 .and. .not. run%record%common &
               .and. (run%record%vectorized .or. run%events%vectorized)
    share = (budget + size(share, kind=int64) - 1) / size(share, kind=int64)
    if (in_rounds) share = huge(share) / (2 * size(share, kind=int64))
    run%record%steps = 0
    run%record%interpolants = 0
    run%record%events = 0
    run%output%status = no_stop
    drive_all: do
      any_waits = .false.
      any_paused = .false.
      do i = 1, size(run%lanes)
        if (any(run%lanes(i)%status == [needs_rhs, needs_events])) cycle
        if (.not. (run%record%common .or. in_rounds)) share(i) = budget
        budget = budget - share(i)
        status = advance_lane(run, i, share(i))
        budget = budget + share(i)
        if (status == raised) exit drive_all
        any_waits = any_waits .or. status == needs_maximum
        any_paused = any_paused .or. status == paused
      end do
      if (in_rounds .and. (any_paused .or. budget <= 0)) then
        exit
      else if (any(run%lanes%status == needs_events)) then
        call answer_events(run)
      else if (any(run%lanes%status == needs_rhs)) then
        call answer_rhs(run)
      else if (any_waits .and. .not. any_paused) then  ! all lanes wait for the maximum
        run%lanes%request%shared = maxval(run%lanes%request%shared, run%busy)
        where (run%busy) run%lanes%status = paused
      else
        exit
      end if
    end do drive_all
    call store_counters(run, budget)
  end subroutine drive

  ! Advances one lane, through several members if they end, until it needs something. The result is
  ! its status, `raised` after an exception in Python, `finished` without more members.
  integer function advance_lane(run, i, budget) result(status)
    type(run_t), target, intent(inout) :: run
    integer, intent(in) :: i
    integer(int64), intent(inout) :: budget

    associate (lane => run%lanes(i), record => run%record)
      do
        status = finished
        if (.not. run%busy(i)) call start_member(run, i)
        if (.not. run%busy(i)) return
        status = lane%status
        if (status == needs_maximum) return
        ! the frame, which all lanes share, has the inertia of the member that is advanced
        if (allocated(run%bodies)) run%frame%bodies => run%bodies(:, lane%member)
        if (status /= out_of_memory) call resume(lane, run%output, budget)
        if (record%raised) lane%status = raised
        status = lane%status
        if (any(status == [needs_rhs, needs_events, needs_maximum, paused])) return
        call store_lane(run, i)
        record%distance = max(record%distance, distance_bound(run%frame, lane%y(:, 0)))
        run%busy(i) = .false.
        record%ended = record%ended + 1
        if (all(status /= [finished, terminal_event])) record%failed = record%failed + 1
        if (status == raised) record%raised = .true.
        if (status == raised) return
      end do
    end associate
  end function advance_lane

  ! Starts the next member, if there is one, in a lane, and stores its initial point.
  subroutine start_member(run, i)
    type(run_t), target, intent(inout) :: run
    integer, intent(in) :: i

    if (run%next > size(run%states, 2)) return
    associate (lane => run%lanes(i), member => run%next, n => run%frame%point_size)
      lane%member = member
      lane%counts = counters_t()
      lane%control%attempts = 0
      lane%outputs_passed = 0
      call set_start(run%record%t0, run%states(:n, member), run%record%first_step, lane)
      call store_step(run%output, 0_int64, run%record%t0, lane%y(:, 0), .true.)
      if (run%output%outputs > 0) then
        if (run%output%times(1) == run%record%t0) then
          call store_point(run%output, member, 1, lane%y(:, 0))
          lane%outputs_passed = 1
        end if
      end if
      if (run%output%status /= no_stop) &
        call fail(lane, run%output%status, run%record%t0, observer_failed)
      run%busy(i) = .true.
      run%next = run%next + 1
    end associate
  end subroutine start_member

  ! Stores the point and the counts of the member of a lane.
  subroutine store_lane(run, i)
    type(run_t), intent(inout) :: run
    integer, intent(in) :: i

    associate (lane => run%lanes(i), n => run%frame%point_size)
      run%states(:n, lane%member) = lane%y(:, 0)
      run%states(n + 1:, lane%member) = [lane%t, lane%failed_at, lane%last%t, &
                                         lane%control%step_size]
      run%counters(lane%member) = lane%counts
      run%counters(lane%member)%status = int(lane%status, c_int64_t)
      run%counters(lane%member)%detail = int(lane%request%detail, c_int64_t)
    end associate
  end subroutine store_lane

  ! Stores the results of a call in the record.
  subroutine store_counters(run, budget)
    type(run_t), intent(inout) :: run
    integer(int64), intent(in) :: budget               ! steps left of it, negative if exceeded
    integer :: i

    do i = 1, size(run%lanes)
      if (run%busy(i)) call store_lane(run, i)
    end do
    run%record%budget = budget
    i = max(1, findloc(run%lanes%status /= terminal_event, .true., 1))
    run%record%step_size = run%lanes(i)%h
    run%record%residual = run%lanes(1)%implicit%residual
  end subroutine store_counters

  ! Evaluates a vectorized function for all lanes that need coefficients.
  subroutine answer_rhs(run)
    type(run_t), target, intent(inout) :: run
    integer, allocatable :: requests(:)                ! lanes that need coefficients
    integer, allocatable :: asked(:)                   ! the number of times of each lane
    real(wp), allocatable :: times(:), members(:), points(:), answers(:)
    logical :: failed
    integer :: i, k, m, alloc_status, n

    requests = pack([(i, i=1, size(run%lanes))], run%lanes%status == needs_rhs)
    m = run%frame%dimension
    if (run%frame%forces > 0 .and. run%frame%tangents == 0) m = run%frame%forces
    n = run%frame%point_size
    if (run%frame%derivatives) m = n
    asked = [(times_asked(run%lanes(requests(i))), i=1, size(requests))]
    k = sum(asked)
    allocate (times(k), members(k), points(n * size(requests)), answers(m * k), stat=alloc_status)
    if (alloc_status /= 0) run%lanes(requests)%status = out_of_memory
    if (alloc_status /= 0) return
    k = 0
    do i = 1, size(requests)
      associate (lane => run%lanes(requests(i)))
        call get_times(lane, times(k + 1:k + asked(i)))
        members(k + 1:k + asked(i)) = real(lane%member - 1, wp)
        points((i - 1) * n + 1:i * n) = lane%request%y
      end associate
      k = k + asked(i)
    end do
    call run%python%apply(rhs_operation, [times, members], points, answers, failed)
    k = 0
    do i = 1, size(requests)
      associate (lane => run%lanes(requests(i)), answer => answers(m * k + 1:m * (k + asked(i))))
        lane%request%detail = merge(raised_in_python, 0, failed)
        if (run%frame%derivatives) then
          call coefficients_of(run%frame, lane%request%t, lane%request%y, answer, &
                               lane%request%answer)
        else
          call receive_answers(lane, m, asked(i), answer)
        end if
        if (allocated(run%bodies)) run%frame%bodies => run%bodies(:, lane%member)
        if (lane%status == needs_rhs) call check_coefficients(lane, lane%request%y)
      end associate
      k = k + asked(i)
    end do
  end subroutine answer_rhs

  ! Evaluates the functions of events that lanes wait for, vectorized ones at all points at once.
  subroutine answer_events(run)
    type(run_t), intent(inout) :: run
    integer, allocatable :: waiting(:), counts(:)      ! lanes, and how many queries each has
    real(wp), allocatable :: query(:, :)     ! all queries, as in queries_t
    real(wp), allocatable :: values(:)       ! of one event
    integer :: event, i, j, alloc_status, total
    logical :: failed

    associate (lanes => run%lanes, n => run%frame%point_size)
      waiting = pack([(i, i=1, size(lanes))], lanes%status == needs_events)
      lanes(waiting)%status = no_stop
      counts = lanes(waiting)%queries%count - lanes(waiting)%queries%answered
      total = sum(counts)
      allocate (query(query_numbers + n + run%events%count, total), values(total), &
                stat=alloc_status)
      if (alloc_status /= 0) lanes(waiting)%status = out_of_memory
      if (alloc_status /= 0) return
      total = 0
      do i = 1, size(waiting)
        associate (queries => lanes(waiting(i))%queries, count => counts(i))
          query(:, total + 1:total + count) = queries%columns(:, queries%answered + 1:queries%count)
          total = total + count
        end associate
      end do
      do event = 1, run%events%count
        associate (asked => pack([(j, j=1, total)], nint(query(query_event, :)) == 0 &
                                 .or. nint(query(query_event, :)) == event), &
                   members => query(query_member, :), times => query(query_time, :), &
                   points => query(query_numbers + 1:query_numbers + n, :))
          if (size(asked) > 0 .and. run%events%table(event)%vectorized /= 0) then
            call run%python%apply(events_operation, [real(event - 1, wp), times(asked), &
                                  members(asked)], [points(:, asked)], values(:size(asked)))
          else
            do j = 1, size(asked)
              call run%events%value(nint(members(asked(j))) + 1, event, times(asked(j)), &
                                    points(:, asked(j)), values(j), failed)
            end do
          end if
          query(query_numbers + n + event, asked) = values(:size(asked))
        end associate
      end do
      total = 0
      do i = 1, size(waiting)
        associate (queries => lanes(waiting(i))%queries, count => counts(i))
          queries%columns(:, queries%answered + 1:queries%count) = query(:, total + 1:total + count)
          queries%answered = queries%count
          total = total + count
        end associate
      end do
    end associate
  end subroutine answer_events

end module run_m
