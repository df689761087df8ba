! Runs of any number of trajectories. A run has lanes, each of which integrates one member at a time
! and takes the next one when it has ended: one lane for functions of one point, many lanes for a
! vectorized function, which is called once for all lanes that need coefficients, or values of an
! event.
module run_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_int64_t, c_intptr_t, c_null_ptr
  use, intrinsic :: iso_fortran_env, only: int64
  use blocks_m, only: body_t
  use callback_m, only: callback_t
  use derivatives_m, only: coefficients_of
  use events_m, only: events_t, observer_t
  use frames_m, only: frame_t
  use interpolant_m, only: scheme_t
  use kinds, only: wp
  use linear_action_m, only: inner_points_t
  use loop_m, only: resume
  use method_m, only: method_t
  use output_m, only: output_t, store_point, store_step
  use shared_numbers
  use step_m, only: store_answers, times_of_request
  use trajectory_m, only: fail, problem_t, set_start, trajectory_t
  use inputs_m, only: vector_field_t
  implicit none
  private
  public :: plan_t, run_t, drive, plan_at, run_at, wake

  ! A frame and a method, prepared for any number of runs
  type :: plan_t
    type(frame_t) :: frame
    type(method_t) :: method
    type(scheme_t) :: scheme
  end type plan_t

  type :: run_t
    type(problem_t) :: problem
    type(frame_t) :: frame                   ! that of the plan, with the callback of this run
    type(body_t), allocatable :: bodies(:, :)          ! (bodies, members) where they differ
    type(callback_t) :: python
    type(events_t) :: events
    type(inner_points_t) :: inner
    type(observer_t) :: observer, step_function    ! step_function: s of step_size_m
    type(vector_field_t) :: field
    type(record_t), pointer :: record => null()
    type(trajectory_t), allocatable :: lanes(:)
    logical, allocatable :: busy(:)          ! (lanes)
    logical, allocatable :: asks(:)          ! (lanes) whether it waits for coefficients or values
    integer :: next = 1                      ! the member that starts next
    ! views of the caller's memory
    type(output_t) :: output
    real(wp), pointer, contiguous :: states(:, :) => null()            ! (point_size + 2, members)
    type(counters_t), pointer, contiguous :: counters(:) => null()      ! (members)
  end type run_t

contains

  ! The plan at an address
  function plan_at(address) result(plan)
    integer(c_intptr_t), intent(in) :: address
    type(plan_t), pointer :: plan

    call c_f_pointer(transfer(address, c_null_ptr), plan)
  end function plan_at

  ! The run at an address
  function run_at(address) result(run)
    integer(c_intptr_t), intent(in) :: address
    type(run_t), pointer :: run

    call c_f_pointer(transfer(address, c_null_ptr), run)
  end function run_at

  ! Lets all lanes go on with their members, but for those that a terminal event has ended.
  subroutine wake(run)
    type(run_t), intent(inout) :: run

    run%busy = run%problem%goes_on .or. run%lanes%status /= terminal_event
    run%asks = .false.
    run%next = size(run%lanes) + 1
    run%record%ended = count(.not. run%busy, kind=c_int64_t)
    run%record%failed = 0
    run%record%raised = 0
  end subroutine wake

  ! Advances all lanes until all members have ended, the budget is used up, or a buffer is full.
  ! Lanes with common steps have equal shares of the budget, so that none is ahead of the others.
  ! Others of a vectorized function advance in rounds, whatever the budget is: it ends a call where
  ! all lanes wait for coefficients or values, so that calls of functions don't depend on it. Values
  ! of events come first, so that lanes wait for coefficients together.
  subroutine drive(run)
    type(run_t), target, intent(inout) :: run
    integer(int64) :: budget, share(size(run%lanes))
    integer :: i, status
    logical :: waits, stops, in_rounds       ! in_rounds: whether lanes advance at once

    budget = run%record%budget
    in_rounds = size(run%lanes) > 1 .and. .not. run%problem%common &
               .and. (.not. associated(run%problem%field) .or. run%events%vectorized)
    share = (budget + size(share, kind=int64) - 1) / size(share, kind=int64)
    if (in_rounds) share = huge(share) / (2 * size(share, kind=int64))
    run%record%steps = 0
    run%record%interpolants = 0
    run%record%events = 0
    run%output%failed = .false.
    drive_all: do
      waits = .false.
      stops = .false.
      do i = 1, size(run%lanes)
        status = run%lanes(i)%status
        if (.not. run%asks(i)) then
          if (.not. (run%problem%common .or. in_rounds)) share(i) = budget
          budget = budget - share(i)
          status = advance_lane(run, i, share(i))
          budget = budget + share(i)
        end if
        run%asks(i) = status == needs_field .or. status == needs_events
        select case (status)
        case (needs_minimum, needs_maximum)
          waits = .true.
        case (paused, buffer_full)
          stops = .true.
        case (raised)
          exit drive_all
        end select
      end do
      if (in_rounds .and. (stops .or. budget <= 0)) then
        exit
      else if (any(run%asks .and. run%lanes%status == needs_events)) then
        call answer_events(run)
      else if (any(run%asks)) then
        call evaluate(run)
      else if (waits .and. .not. stops) then
        call exchange(run)
      else
        exit
      end if
    end do drive_all
    call store_counters(run, budget)
  end subroutine drive

  ! Advances one lane, through several members if they end, until it needs something. The result is
  ! what it needs, `raised` after an exception in Python, or `finished` if there are no more
  ! members.
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
        if (status == needs_minimum .or. status == needs_maximum) return
        if (allocated(run%bodies)) run%frame%bodies => run%bodies(:, lane%member)
        if (status /= out_of_memory) call resume(lane, run%output, budget)
        if (record%raised /= 0) lane%status = raised
        status = lane%status
        if (any(status == [needs_field, needs_events, needs_minimum, needs_maximum, paused, &
                           buffer_full])) return
        call store_lane(run, i)
        run%busy(i) = .false.
        record%ended = record%ended + 1
        if (all(status /= [finished, terminal_event])) record%failed = record%failed + 1
        if (status == raised) record%raised = 1
        if (status == raised) return
      end do
    end associate
  end function advance_lane

  ! Starts the next member in a free lane.
  subroutine start_member(run, i)
    type(run_t), target, intent(inout) :: run
    integer, intent(in) :: i

    if (run%next > size(run%states, 2)) return
    associate (lane => run%lanes(i), member => run%next, n => run%frame%point_size)
      lane%member = member
      lane%counts = counters_t()
      lane%control%attempts = 0
      lane%outputs_done = 0
      call set_start(run%record%t0, run%states(:n, member), run%record%first_step, lane)
      call store_step(run%output, 0_int64, run%record%t0, lane%y(:, 0), .true.)
      if (run%output%outputs > 0) then
        if (run%output%times(1) == run%record%t0) then
          call store_point(run%output, member, 1, lane%y(:, 0))
          lane%outputs_done = 1
        end if
      end if
      if (run%output%failed) call fail(lane, raised, run%record%t0, observer_failed)
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
      run%states(n + 1:, lane%member) = [lane%t, lane%failed_at]
      run%counters(lane%member) = lane%counts
      run%counters(lane%member)%status = int(lane%status, c_int64_t)
      run%counters(lane%member)%flag = int(lane%request%flag, c_int64_t)
    end associate
  end subroutine store_lane

  ! Stores the results of a call in the record.
  subroutine store_counters(run, budget)
    type(run_t), intent(inout) :: run
    integer(int64), intent(in) :: budget               ! what is left of it, negative if exceeded
    integer :: i

    do i = 1, size(run%lanes)
      if (run%busy(i)) call store_lane(run, i)
    end do
    run%record%budget = budget
    i = max(1, findloc(run%lanes%status /= terminal_event, .true., 1))
    run%record%step_size = run%lanes(i)%h
    run%record%residual = run%lanes(1)%solver%residual
  end subroutine store_counters

  ! Exchanges the minimum or maximum that trajectories with common steps wait for.
  subroutine exchange(run)
    type(run_t), intent(inout) :: run
    real(wp) :: shared

    if (run%lanes(findloc(run%busy, .true., 1))%status == needs_minimum) then
      shared = minval(run%lanes%request%shared, run%busy)
    else
      shared = maxval(run%lanes%request%shared, run%busy)
    end if
    run%lanes%request%shared = shared
    where (run%busy) run%lanes%status = paused
  end subroutine exchange

  ! Evaluates a vectorized function for all lanes that need coefficients.
  subroutine evaluate(run)
    type(run_t), intent(inout) :: run
    integer, allocatable :: requests(:)                ! these lanes
    integer, allocatable :: asked(:)                   ! for how many times each asks
    real(wp), allocatable :: times(:), members(:), points(:), answers(:)
    logical :: failed
    integer :: i, k, m, memory

    requests = pack([(i, i=1, size(run%lanes))], run%asks)
    run%asks = .false.
    m = run%frame%dimension
    if (run%frame%forces > 0 .and. run%frame%tangents == 0) m = run%frame%forces
    if (run%frame%derivatives) m = run%frame%point_size
    allocate (asked(size(requests)), points(run%frame%point_size * size(requests)), stat=memory)
    if (memory == 0) then
      asked = [(size(times_of_request(run%lanes(requests(i)))), i=1, size(requests))]
      k = sum(asked)
      allocate (times(k), members(k), answers(m * k), stat=memory)
    end if
    if (memory /= 0) run%lanes(requests)%status = out_of_memory
    if (memory /= 0) return
    associate (n => run%frame%point_size)
      k = 0
      do i = 1, size(requests)
        associate (lane => run%lanes(requests(i)))
          times(k + 1:k + asked(i)) = times_of_request(lane)
          members(k + 1:k + asked(i)) = real(lane%member - 1, wp)
          points((i - 1) * n + 1:i * n) = lane%request%y
        end associate
        k = k + asked(i)
      end do
    end associate
    call run%python%apply(fields_operation, [times, members], points, answers, failed)
    k = 0
    do i = 1, size(requests)
      associate (lane => run%lanes(requests(i)), own => answers(m * k + 1:m * (k + asked(i))))
        lane%request%flag = merge(raised_in_python, 0, failed)
        if (run%frame%derivatives) then
          call coefficients_of(run%frame, lane%request%t, lane%request%y, own, lane%request%answer)
        else
          call store_answers(lane, m, asked(i), own)
        end if
      end associate
      k = k + asked(i)
    end do
  end subroutine evaluate

  ! Evaluates the functions of events where lanes wait for values, vectorized ones at all points at
  ! once.
  subroutine answer_events(run)
    type(run_t), intent(inout) :: run
    integer, allocatable :: waiting(:)                 ! lanes
    integer, allocatable :: owner(:), place(:)         ! the lane of each point, and where it has it
    real(wp), allocatable :: t(:), member(:), points(:), values(:)
    integer :: event, i, j, k, memory, total
    logical :: failed

    associate (lanes => run%lanes, n => run%frame%point_size)
      waiting = pack([(i, i=1, size(lanes))], run%asks .and. lanes%status == needs_events)
      run%asks(waiting) = .false.
      total = sum(lanes(waiting)%queries)
      allocate (owner(total), place(total), t(total), member(total), points(n * total), &
                values(total), stat=memory)
      if (memory /= 0) lanes(waiting)%status = out_of_memory
      if (memory /= 0) return
      do event = 1, run%events%count
        k = 0
        do i = 1, size(waiting)
          associate (lane => lanes(waiting(i)))
            do j = lane%answered + 1, lane%queries
              if (all(nint(lane%query(1, j)) /= [0, event])) cycle
              points(k * n + 1:(k + 1) * n) = lane%query(4:n + 3, j)
              k = k + 1
              owner(k) = waiting(i)
              place(k) = j
              t(k) = lane%query(3, j)
              member(k) = real(lane%member - 1, wp)
            end do
          end associate
        end do
        if (k > 0 .and. run%events%table(event)%vectorized /= 0) then
          call run%python%apply(events_operation, [real(event - 1, wp), t(:k), member(:k)], &
                                points(:n * k), values(:k))
        else
          do j = 1, k
            call run%events%value(nint(member(j)) + 1, event, t(j), points((j - 1) * n + 1:j * n), &
                                  values(j), failed)
          end do
        end if
        do j = 1, k
          lanes(owner(j))%query(n + 3 + event, place(j)) = values(j)
        end do
      end do
    end associate
  end subroutine answer_events

end module run_m
