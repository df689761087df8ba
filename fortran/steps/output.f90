! The output of trajectories: views of the caller's arrays, and how many entries are used. When an
! array may not have room for another step, the trajectories pause and the caller empties it.
module output_m
  use iso_fortran_env, only: int64
  use kinds, only: wp
  use interpolant_m, only: interpolant_t
  use events_m, only: observer_t
  use shared_numbers, only: record_t
  implicit none
  private
  public :: output_t, has_room, store_interpolant, store_event, store_point, store_step

  type :: output_t
    type(record_t), pointer :: record => null()        ! capacities, and how much of them is used
    ! points at output times
    integer :: outputs = 0
    real(wp), pointer, contiguous :: times(:) => null()        ! (outputs)
    ! (point_size, members, outputs), (observations, members, outputs), null to store none
    real(wp), pointer, contiguous :: y(:, :, :) => null(), observed(:, :, :) => null()
    type(observer_t), pointer :: observer => null()
    logical :: failed = .false.              ! whether the observer has failed
    ! ends of steps, for a single trajectory
    real(wp), pointer, contiguous :: step_t(:) => null()       ! (capacity)
    ! (point_size, capacity), (observations, capacity)
    real(wp), pointer, contiguous :: step_y(:, :) => null(), step_observed(:, :) => null()
    ! interpolants of steps
    logical :: dense = .false.               ! whether all are stored
    integer(int64), pointer, contiguous :: dense_member(:) => null()
    ! (4, capacity) start, size, end, 1 on an algebra
    real(wp), pointer, contiguous :: dense_t(:, :) => null()
    real(wp), pointer, contiguous :: dense_y(:, :, :) => null()        ! (point_size, 2, capacity)
    ! (dimension, columns, capacity)
    real(wp), pointer, contiguous :: dense_field(:, :, :) => null()
    ! events
    integer(int64), pointer, contiguous :: event_of(:, :) => null()    ! (2, capacity) member, event
    real(wp), pointer, contiguous :: event_t(:) => null()
    real(wp), pointer, contiguous :: event_y(:, :, :) => null()        ! (point_size, 2, capacity)
  end type output_t

contains

  ! Whether there is room for the output of one step of all trajectories
  pure logical function has_room(output)
    type(output_t), intent(in) :: output

    associate (record => output%record, lanes => output%record%lanes)
      has_room = (record%step_capacity == 0 .or. record%steps < record%step_capacity) &
                 .and. (.not. output%dense &
                        .or. record%interpolants + lanes <= record%dense_capacity) &
                 .and. record%events + record%event_functions * lanes <= record%event_capacity
    end associate
  end function has_room

  ! Stores the point at an output time.
  subroutine store_point(output, member, number, y)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member, number              ! from 1
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)

    if (associated(output%y)) output%y(:, member, number) = y
    if (associated(output%observed)) call output%observer%observe(member, output%times(number), y, &
                                   output%observed(:, member, number), output%failed)
  end subroutine store_point

  ! Stores the end of a step.
  subroutine store_step(output, number, t, y, last)
    type(output_t), intent(inout) :: output
    integer(int64), intent(in) :: number               ! the step's, from 1
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    logical, intent(in) :: last                        ! whether to store it in any case

    if (output%record%step_capacity == 0) return
    if (.not. (last .or. mod(number, output%record%every) == 0)) return
    associate (k => output%record%steps)
      k = k + 1
      output%step_t(k) = t
      if (associated(output%step_y)) output%step_y(:, k) = y
      if (associated(output%step_observed)) &
        call output%observer%observe(1, t, y, output%step_observed(:, k), output%failed)
    end associate
  end subroutine store_step

  ! Stores an interpolant.
  pure subroutine store_interpolant(output, member, t_end, interpolant)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member                      ! from 1
    ! end of its validity, before t0 + h after an event
    real(wp), intent(in) :: t_end
    type(interpolant_t), intent(in) :: interpolant

    output%record%interpolants = output%record%interpolants + 1
    associate (k => output%record%interpolants)
      output%dense_member(k) = int(member, int64)
      output%dense_t(:, k) = [interpolant%t0, interpolant%h, t_end, &
                              merge(1.0_wp, 0.0_wp, interpolant%on_algebra)]
      output%dense_y(:, 1, k) = interpolant%y0
      output%dense_y(:, 2, k) = interpolant%y1
      output%dense_field(:, :, k) = interpolant%field
    end associate
  end subroutine store_interpolant

  ! Stores an event.
  pure subroutine store_event(output, member, event, t, before, after)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member, event
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: before(:), after(:)    ! (point_size)

    output%record%events = output%record%events + 1
    associate (k => output%record%events)
      output%event_of(:, k) = int([member, event], int64)
      output%event_t(k) = t
      output%event_y(:, 1, k) = before
      output%event_y(:, 2, k) = after
    end associate
  end subroutine store_event

end module output_m
