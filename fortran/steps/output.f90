! The output of trajectories: points at output times in the caller's arrays, and rows of numbers for
! steps, interpolants and events, which the caller collects after each call.
module output_m
  use iso_fortran_env, only: int64
  use kinds, only: wp
  use events_m, only: observer_t
  use frames_m, only: frame_t
  use interpolant_m, only: evaluate_inner, evaluate_interpolant, interpolant_t, reserve_interpolant
  use linear_action_m, only: inner_points_t
  use method_m, only: scheme_t
  use shared_numbers, only: interpolant_columns, interpolant_on_algebra, interpolant_size, &
                            no_stop, out_of_memory, record_t
  use vectors_m, only: add_columns
  implicit none
  private
  public :: evaluate_stored, output_t, store_interpolant, store_event, store_point, store_step

  type :: output_t
    type(record_t), pointer :: record => null()        ! which output is stored, numbers of rows
    ! points at output times
    integer :: outputs = 0
    real(wp), pointer, contiguous :: times(:) => null()        ! (outputs)
    ! (point_size, members, outputs), (observations, members, outputs), null to store none
    real(wp), pointer, contiguous :: y(:, :, :) => null(), observed(:, :, :) => null()
    type(observer_t) :: observer
    integer :: status = no_stop             ! raised if the observer has failed, or out_of_memory
    ! rows of the caller are columns here
    real(wp), allocatable :: steps(:, :)     ! time, point and observations, of a single trajectory
    real(wp), allocatable :: interpolants(:, :)        ! InterpolantColumn, points, coefficients
    real(wp), allocatable :: events(:, :)              ! EventColumn, points
  end type output_t

contains

  ! Adds a row, which is yet to be written.
  subroutine add_row(output, rows, used)
    type(output_t), intent(inout) :: output
    real(wp), allocatable, intent(inout) :: rows(:, :)
    integer(int64), intent(inout) :: used
    integer, parameter :: first_capacity = 64
    integer :: alloc_status

    if (used == size(rows, 2, int64)) call add_columns(rows, first_capacity, alloc_status)
    if (used == size(rows, 2, int64)) output%status = out_of_memory
    if (output%status == no_stop) used = used + 1
  end subroutine add_row

  ! Stores a point at an output time, and what is observed there.
  subroutine store_point(output, member, number, y)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member, number              ! from 1
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)

    if (associated(output%y)) output%y(:, member, number) = y
    if (associated(output%observed)) call output%observer%observe( &
      member, output%times(number), y, output%observed(:, member, number), output%status)
  end subroutine store_point

  ! Stores the end of a step in a row, of every n-th step and of the last one.
  subroutine store_step(output, number, t, y, last)
    type(output_t), intent(inout) :: output
    integer(int64), intent(in) :: number               ! of the step, from 1
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    logical, intent(in) :: last                        ! whether to store it in any case

    if (output%record%every == 0) return
    if (.not. (last .or. mod(number, output%record%every) == 0)) return
    call add_row(output, output%steps, output%record%steps)
    if (output%status /= no_stop) return
    associate (row => output%steps(:, output%record%steps), &
               n => merge(size(y), 0, output%record%keeps_points))
      row(1) = t
      row(2:n + 1) = y(:n)
      if (output%observer%count > 0) &
        call output%observer%observe(1, t, y, row(n + 2:), output%status)
    end associate
  end subroutine store_step

  ! Stores an interpolant in a row, which read_interpolant reads.
  subroutine store_interpolant(output, member, t_end, interpolant)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member                      ! from 1
    real(wp), intent(in) :: t_end                      ! of its validity: t0 + h, or at an event
    type(interpolant_t), intent(in) :: interpolant

    call add_row(output, output%interpolants, output%record%interpolants)
    if (output%status == no_stop) output%interpolants(:, output%record%interpolants) = &
      [real(member, wp), interpolant%t0, interpolant%h, t_end, merge(1.0_wp, 0.0_wp, &
       interpolant%on_algebra), interpolant%y0, interpolant%y1, interpolant%vectors]
  end subroutine store_interpolant

  ! Reads an interpolant from its row, as far as it is evaluated.
  subroutine read_interpolant(row, interpolant)
    real(wp), intent(in) :: row(:)
    type(interpolant_t), intent(inout) :: interpolant

    associate (n => size(interpolant%y0), points => row(interpolant_columns + 1:))
      interpolant%h = row(interpolant_size)
      interpolant%on_algebra = row(interpolant_on_algebra) > 0
      interpolant%y0(:) = points(:n)
      interpolant%y1(:) = points(n + 1:2 * n)
      interpolant%vectors(:, :) = reshape(points(2 * n + 1:), shape(interpolant%vectors))
    end associate
  end subroutine read_interpolant

  ! Evaluates stored interpolants, each at some fractions.
  subroutine evaluate_stored(frame, scheme, rows, step, theta, y, alloc_status)
    type(frame_t), target, intent(in) :: frame
    type(scheme_t), target, intent(in) :: scheme
    real(wp), intent(in) :: rows(:, :)       ! interpolants of output_t
    integer, intent(in) :: step(:)           ! (points) the row of each, from 0
    real(wp), intent(in) :: theta(:)         ! (points) fractions of the steps
    real(wp), intent(inout) :: y(:, :)       ! (point_size, points)
    integer, intent(out) :: alloc_status     ! nonzero if there isn't enough memory
    integer, parameter :: max_inner = 32     ! points that one flow along a polynomial computes
    type(interpolant_t) :: interpolant
    type(inner_points_t) :: inner
    integer :: i, k, last

    call reserve_interpolant(frame, scheme, interpolant, alloc_status)
    if (alloc_status /= 0) return
    interpolant%known = scheme%nodes
    i = 1
    k = 0
    do while (i <= size(step))
      if (k /= step(i) + 1) then
        k = step(i) + 1
        call read_interpolant(rows(:, k), interpolant)
      end if
      last = i
      if (.not. theta(i) > 0) then
        y(:, i) = interpolant%y0
      else if (.not. theta(i) < 1) then
        y(:, i) = interpolant%y1
      else if (scheme%at_stages) then
        last = min(size(step), i + max_inner - 1)
        last = i - 2 + findloc([step(i:last) == step(i) .and. theta(i:last) < 1, .false.], &
                               .false., 1)
        call evaluate_inner(interpolant, inner, theta(i:last), y(:, i:last))
      else
        call evaluate_interpolant(interpolant, theta(i), y(:, i))
      end if
      i = last + 1
    end do
  end subroutine evaluate_stored

  ! Stores an event in a row, with the points before and after its jump.
  subroutine store_event(output, member, event, t, before, after)
    type(output_t), intent(inout) :: output
    integer, intent(in) :: member, event
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: before(:), after(:)    ! (point_size)

    call add_row(output, output%events, output%record%events)
    if (output%status == no_stop) output%events(:, output%record%events) = &
      [real(member, wp), real(event, wp), t, before, after]
  end subroutine store_event

end module output_m
