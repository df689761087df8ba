! One trajectory: what it needs to go on, and how it asks for coefficients. Where the problem has a
! field, it is called; else the loop returns with the request, and is called again with what came of
! it. So the same loop serves a function of one point and one of many, whose trajectories then wait
! for each other.
module trajectory_m
  use kinds, only: wp
  use controller_m, only: rejected_size
  use error_norm_m, only: tolerances_t, width
  use frames_m, only: flow_sequence_t, frame_t
  use interpolant_m, only: interpolant_t, reserve_interpolant, scheme_t
  use method_m, only: method_t
  use time_grid_m, only: grid_t
  use vector_field_m, only: vector_field_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: field_not_finite, finished, needs_field, needs_maximum, paused, &
                            raised, raised_in_python, stage_not_finite, stopped_by_field
  implicit none
  private
  public :: events_t, problem_t, trajectory_t, copy, evaluate_events, fail, finite, follow_grid, go_on, load_state, &
            reject_stage, request, judge_reply, save_state, set_start, start, begin_segment, &
            guess_first, choose_step, take_stage, finish_step, judge_step, accept_step, ask_end, &
            take_node, record_step, known_start, known_curvature, known_stage, known_end, &
            known_node, shared_guess, shared_size, ended

  ! Functions whose zeros are looked for
  type, abstract :: events_t
    integer :: count = 0
    integer, allocatable :: direction(:)     ! (count) sign of the slope at zeros that count, 0 for any
    integer(int64), allocatable :: most(:)   ! (count) how often until the end
    logical, allocatable :: jumps(:)         ! (count) whether the solution jumps there
  contains
    procedure(event_value_i), deferred :: value
    procedure(event_jump_i), deferred :: jump
  end type events_t

  abstract interface

    subroutine event_value_i(self, member, event, t, y, g, flag)
      import :: events_t, wp
      class(events_t), intent(in) :: self
      integer, intent(in) :: member, event             ! from 1
      real(wp), intent(in) :: t
      real(wp), contiguous, intent(in) :: y(:)         ! (point_size)
      real(wp), intent(out) :: g
      logical, intent(out) :: flag                     ! true if there is no value
    end subroutine event_value_i

    subroutine event_jump_i(self, member, event, t, y, after, flag)
      import :: events_t, wp
      class(events_t), intent(in) :: self
      integer, intent(in) :: member, event
      real(wp), intent(in) :: t
      real(wp), contiguous, intent(in) :: y(:)         ! (point_size) before
      real(wp), contiguous, intent(out) :: after(:)    ! (point_size)
      logical, intent(out) :: flag
    end subroutine event_jump_i

  end interface

  type :: problem_t
    type(frame_t), pointer :: frame => null()
    type(method_t), pointer :: method => null()
    type(scheme_t), pointer :: scheme => null()        ! of the interpolant
    logical :: free = .false.                ! whether flows of different coefficients differ
    class(events_t), pointer :: events => null()
    class(vector_field_t), pointer :: field => null()  ! none if coefficients come from outside
    logical :: adaptive = .false.
    logical :: common = .false.              ! whether all trajectories take the same steps
    real(wp) :: h = 0.0_wp                   ! size of equal steps, positive
    type(tolerances_t) :: tolerances         ! of chosen ones
    integer(int64) :: max_steps = huge(1_int64)        ! chosen ones, rejected ones included
    real(wp), allocatable :: stops(:)        ! ends of the segments
    real(wp) :: first_step = 0.0_wp          ! zero to choose it
  end type problem_t

  ! Phases, named after what comes next
  integer, parameter :: begin_segment = 1, guess_first = 2, choose_step = 3, take_stage = 4, &
                        finish_step = 5, judge_step = 6, accept_step = 7, ask_end = 8, &
                        take_node = 9, record_step = 10, known_start = 11, known_curvature = 12, &
                        known_stage = 13, known_end = 14, known_node = 15, shared_guess = 16, &
                        shared_size = 17, ended = 18

  type :: trajectory_t
    ! where it has got to
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: y(:, :)         ! (point_size, 0:paths) points of the step, 0: its start
    real(wp), allocatable :: slope(:)        ! (dimension) the coefficients at the start
    logical :: known = .false.               ! if they are known
    integer :: segment = 1
    type(grid_t) :: grid                     ! of equal steps in the segment
    integer(int64) :: done = 0               ! of its steps
    real(wp) :: size = 0.0_wp                ! of the next step; zero if it has to be chosen
    real(wp) :: last_error = 1.0_wp
    logical :: after_rejection = .false.
    ! the request, and what came of it
    integer :: status = paused
    real(wp) :: want_t = 0.0_wp
    real(wp), allocatable :: want(:)         ! (point_size) which the field may write into
    real(wp), allocatable :: got(:)          ! (dimension)
    integer :: flag = 0                      ! what the field returned
    real(wp) :: shared = 0.0_wp              ! to be compared with other trajectories'
    real(wp) :: failed_at = 0.0_wp
    ! what it took, and what it may take until the next pause
    integer(int64) :: nfev = 0, nexp = 0, njev = 0, nlu = 0, steps = 0, rejected = 0
    integer(int64) :: attempts = 0           ! of chosen steps
    ! the step
    integer :: member = 1
    integer :: phase = begin_segment
    integer :: stage = 1
    integer :: paths = 0                     ! that have been followed
    integer :: path_of_u = 0                 ! whose coordinates u are
    integer :: result = 0                    ! where y has the result
    logical :: shortened = .false.           ! to end at the end of the segment
    real(wp) :: wanted_size = 0.0_wp         ! which it would have had otherwise
    real(wp) :: end = 0.0_wp                 ! its end
    real(wp) :: h = 0.0_wp                   ! its signed size
    real(wp) :: error = 0.0_wp
    type(flow_sequence_t) :: flows           ! those of the method, with weights times the step
    real(wp) :: weighted_by = 0.0_wp         ! the step size that these weights belong to
    ! (dimension, stages) coefficients at the stages; of a method of two registers their combination Z
    real(wp), allocatable :: f(:, :)
    real(wp), allocatable :: end_slope(:)    ! (dimension) coefficients at the end
    logical :: end_known = .false.
    real(wp), allocatable :: u(:)            ! (dimension) coordinates of a stage in the algebra
    real(wp), allocatable :: v(:), scale(:), spare(:)  ! (width) workspace of errors
    real(wp) :: norms(3) = 0.0_wp            ! of point, slope and curvature, for the first size
    real(wp) :: guess = 0.0_wp
    ! output
    type(interpolant_t) :: interpolant
    logical :: within = .false.              ! whether the interpolant is wanted
    logical :: crossed = .false.             ! whether an event happened
    logical :: alone = .false.               ! whether only the last step's interpolant is wanted
    integer :: used = 0                      ! of the wanted times
    real(wp), allocatable :: value(:), value_after(:)  ! (events) at both ends of the step
    integer(int64), allocatable :: count(:)  ! (events) how often each happened
    integer :: stuck = 0                     ! jumps without progress
    integer :: jumped = 0                    ! event whose jump the step starts from, 0 for none
    real(wp) :: jumped_from = 0.0_wp         ! its function there
    ! the last step, of which an interpolant may be asked for
    logical :: keep_last = .false.
    real(wp) :: t_old = 0.0_wp, h_old = 0.0_wp
    real(wp), allocatable :: y_old(:), slope_old(:)
  end type trajectory_t

contains

  ! Memory for trajectories of a problem
  subroutine start(problem, within, keep_last, trajectory, memory)
    type(problem_t), intent(in) :: problem
    logical, intent(in) :: within            ! whether the solution within steps is wanted
    logical, intent(in) :: keep_last         ! whether that within the last one may be asked for
    type(trajectory_t), intent(out) :: trajectory
    integer, intent(out) :: memory           ! nonzero if there isn't enough
    integer :: n

    associate (frame => problem%frame, method => problem%method)
      trajectory%result = merge(1, method%result, method%two_registers)
      allocate (trajectory%y(frame%point_size, 0:merge(1, size(method%origin), method%two_registers)), &
                trajectory%f(frame%dimension, merge(1, size(method%c), method%two_registers)), &
                trajectory%want(frame%point_size), &
                trajectory%got(frame%dimension), trajectory%slope(frame%dimension), &
                trajectory%end_slope(frame%dimension), trajectory%u(frame%dimension), &
                stat=memory)
      if (memory /= 0) return
      trajectory%flows = method%flows
      n = 0
      if (problem%adaptive) n = width(frame, problem%tolerances)
      allocate (trajectory%v(n), trajectory%scale(n), trajectory%spare(n), stat=memory)
      if (memory /= 0) return
      n = 0
      if (associated(problem%events)) n = problem%events%count
      allocate (trajectory%value(n), trajectory%value_after(n), trajectory%count(n), stat=memory)
      if (memory /= 0) return
      if (within) call reserve_interpolant(frame, problem%scheme, trajectory%interpolant, memory)
      if (memory /= 0 .or. .not. keep_last) return
      trajectory%keep_last = .true.
      allocate (trajectory%y_old(frame%point_size), trajectory%slope_old(frame%dimension), &
                stat=memory)
    end associate
  end subroutine start

  ! A trajectory begins, or goes on from another point.
  pure subroutine set_start(t, y, first_step, trajectory)
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(in) :: first_step                 ! zero to choose it
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%t = t
    trajectory%y(:, 0) = y
    trajectory%known = .false.
    trajectory%end_known = .false.
    trajectory%size = first_step
    trajectory%last_error = 1.0_wp
    trajectory%after_rejection = .false.
    trajectory%phase = begin_segment
    trajectory%status = paused
    trajectory%segment = 1
    trajectory%alone = .false.
    trajectory%stuck = 0
    trajectory%jumped = 0
    trajectory%weighted_by = 0.0_wp
    trajectory%value = 0.0_wp
    trajectory%count = 0
  end subroutine set_start

  ! The rest of a grid of equal steps, some of which have been taken
  pure subroutine follow_grid(grid, done, trajectory)
    type(grid_t), intent(in) :: grid
    integer(int64), intent(in) :: done
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%grid = grid
    trajectory%done = done
    trajectory%phase = choose_step
    if (done == grid%steps) trajectory%phase = ended
  end subroutine follow_grid

  ! A trajectory that has ended goes on, to other ends of segments.
  pure subroutine go_on(trajectory)
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%status = paused
    trajectory%segment = 1
    trajectory%phase = begin_segment
  end subroutine go_on

  ! What a trajectory needs between steps to go on bit for bit
  pure subroutine save_state(trajectory, reals, integers, points, slopes)
    type(trajectory_t), intent(in) :: trajectory
    real(wp), intent(out) :: reals(6)
    integer(int64), intent(out) :: integers(9)
    ! (point_size, 2), (dimension, 2 + columns of f)
    real(wp), intent(out) :: points(:, :), slopes(:, :)

    associate (x => trajectory)
      reals = [x%t, x%size, x%last_error, x%t_old, x%h_old, x%h]
      integers = [merge(1_int64, 0_int64, x%known), merge(1_int64, 0_int64, x%after_rejection), &
                  x%nfev, x%nexp, x%njev, x%nlu, x%steps, x%rejected, x%attempts]
      points(:, 1) = x%y(:, 0)
      slopes(:, 1) = x%slope
      points(:, 2) = x%y(:, 0)
      slopes(:, 2) = x%slope
      slopes(:, 3:) = x%f
      if (allocated(x%y_old)) points(:, 2) = x%y_old
      if (allocated(x%slope_old)) slopes(:, 2) = x%slope_old
    end associate
  end subroutine save_state

  pure subroutine load_state(trajectory, reals, integers, points, slopes)
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: reals(6)
    integer(int64), intent(in) :: integers(9)
    real(wp), intent(in) :: points(:, :), slopes(:, :)

    associate (x => trajectory)
      x%t = reals(1)
      x%size = reals(2)
      x%last_error = reals(3)
      x%t_old = reals(4)
      x%h_old = reals(5)
      x%h = reals(6)
      x%known = integers(1) == 1
      x%after_rejection = integers(2) == 1
      x%nfev = integers(3)
      x%nexp = integers(4)
      x%njev = integers(5)
      x%nlu = integers(6)
      x%steps = integers(7)
      x%rejected = integers(8)
      x%attempts = integers(9)
      x%y(:, 0) = points(:, 1)
      x%slope = slopes(:, 1)
      x%y_old = points(:, 2)
      x%slope_old = slopes(:, 2)
      x%f = slopes(:, 3:)
      x%weighted_by = 0.0_wp
    end associate
    call go_on(trajectory)
  end subroutine load_state

  ! Asks for the coefficients at a point. A step up to a breakpoint doesn't see what comes after it.
  subroutine request(problem, trajectory, t, y, next)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    integer, intent(in) :: next                        ! phase

    trajectory%want_t = t
    if (trajectory%segment < size(problem%stops) .and. next /= known_start) then
      associate (stop => problem%stops(trajectory%segment))
        if ((t - stop) * sign(1.0_wp, trajectory%h) >= 0) then
          trajectory%want_t = nearest(stop, -trajectory%h)
        end if
      end associate
    end if
    trajectory%phase = next
    trajectory%status = needs_field
    trajectory%nfev = trajectory%nfev + 1
    trajectory%want(:) = y
    if (.not. associated(problem%field)) return
    problem%field%member = trajectory%member
    call problem%field%coefficients(problem%frame%point_size, problem%frame%dimension, &
                                    trajectory%want_t, trajectory%want, trajectory%got, &
                                    trajectory%flag)
    call judge_reply(problem, trajectory, y)
  end subroutine request

  ! What the field gave: a failure, or numbers that the next phase takes
  subroutine judge_reply(problem, trajectory, y)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) where it was

    if (trajectory%flag == 0) then
      if (finite(trajectory%got)) then
        trajectory%status = finished
        return
      end if
    end if
    if (trajectory%flag == raised_in_python) then
      call fail(trajectory, raised, trajectory%want_t)
    else if (.not. finite(y)) then
      call reject_stage(problem, trajectory, stage_not_finite, trajectory%want_t)
    else if (trajectory%flag /= 0) then
      call fail(trajectory, stopped_by_field, trajectory%want_t)
    else
      call fail(trajectory, field_not_finite, trajectory%want_t)
    end if
  end subroutine judge_reply

  ! A step with a stage that doesn't exist is tried again where sizes are chosen.
  subroutine reject_stage(problem, trajectory, status, t)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    if (.not. problem%adaptive) then
      call fail(trajectory, status, t)
      return
    end if
    select case (trajectory%phase)
    case (known_curvature)
      trajectory%got = huge(1.0_wp)                    ! choose_size keeps the guess
    case (known_stage, take_stage, finish_step)
      trajectory%error = huge(1.0_wp)
      trajectory%shared = trajectory%error
      trajectory%status = finished
      trajectory%phase = judge_step
      if (problem%common) trajectory%status = needs_maximum
    case (known_node)
      ! a step that is right, but too long for the solution within it
      if (trajectory%alone .or. problem%common) then
        call fail(trajectory, status, t)
        return
      end if
      trajectory%steps = trajectory%steps - 1
      trajectory%rejected = trajectory%rejected + 1
      trajectory%after_rejection = .true.
      trajectory%size = rejected_size(abs(trajectory%h), huge(1.0_wp), problem%tolerances%exponent)
      trajectory%status = finished
      trajectory%phase = choose_step
    case default
      call fail(trajectory, status, t)
    end select
  end subroutine reject_stage

  ! The functions whose zeros are events, at a point; the trajectory fails if one has no value.
  subroutine evaluate_events(problem, trajectory, t, y, values, stopped)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(inout) :: values(:)               ! (events)
    logical, intent(out) :: stopped
    integer :: i

    stopped = .false.
    do i = 1, size(values)
      call problem%events%value(trajectory%member, i, t, y, values(i), stopped)
      if (.not. stopped) cycle
      call fail(trajectory, raised, t)
      return
    end do
  end subroutine evaluate_events

  subroutine fail(trajectory, status, t)
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    trajectory%status = status
    trajectory%failed_at = t
  end subroutine fail

  ! ieee_is_finite would make every procedure that sees its module save and restore the state of
  ! the processor.
  pure logical function finite(x)
    real(wp), contiguous, intent(in) :: x(:)

    finite = all(abs(x) <= huge(x))
  end function finite

  ! A procedure, since the compiler doesn't know two columns of an array apart
  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)

    to = from
  end subroutine copy

end module trajectory_m
