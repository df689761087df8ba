! The state of one trajectory, and how it requests coefficients of the right-hand side. If the
! problem has a field, `request` calls it at once; otherwise the loop returns with the request and
! is called again with the answer, so that one call can answer many trajectories.
module trajectory_m
  use kinds, only: wp
  use controller_m, only: rejected_size
  use error_norm_m, only: tolerances_t, width
  use frames_m, only: flow_sequence_t, frame_t
  use interpolant_m, only: interpolant_t, reserve_interpolant, scheme_t
  use method_m, only: method_t
  use newton_m, only: newton_t, reserve
  use time_grid_m, only: grid_t
  use vector_field_m, only: vector_field_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: field_not_finite, finished, needs_field, needs_maximum, paused, &
                            raised, raised_in_python, stage_not_finite, stopped_by_field
  implicit none
  private
  public :: events_t, problem_t, trajectory_t, before_stop, copy, evaluate_events, fail, finite, &
            follow_grid, continue_run, forget_step, load_state, &
            reject_stage, request, check_coefficients, save_state, &
            set_start, start, phase_begin_segment, phase_guess_size, phase_choose_step, &
            phase_next_stage, phase_finish_step, phase_decide_step, phase_accepted, &
            phase_request_end, phase_next_node, phase_record_step, phase_start_received, &
            phase_curvature_received, phase_stage_received, phase_end_received, &
            phase_node_received, phase_guess_shared, phase_size_shared, phase_ended, &
            phase_column_received, phase_error_received

  ! Functions whose zeros along the solution are events
  type, abstract :: events_t
    integer :: count = 0
    integer, allocatable :: direction(:)     ! (count) sign of the slope at an event, 0 for any
    integer(int64), allocatable :: most(:)   ! (count) the last event ends the trajectory
    logical, allocatable :: jumps(:)         ! (count) whether the solution jumps at an event
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
      logical, intent(out) :: flag                     ! whether the function failed
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
    logical :: free = .false.                ! whether small coefficients determine the flow's end
    class(events_t), pointer :: events => null()
    class(vector_field_t), pointer :: field => null()  ! null if the caller answers requests
    logical :: adaptive = .false.
    logical :: common = .false.              ! whether all trajectories take the same steps
    real(wp) :: h = 0.0_wp                   ! size of equal steps, positive
    type(tolerances_t) :: tolerances         ! of adaptive steps
    integer(int64) :: max_steps = huge(1_int64)        ! rejected ones included
    real(wp), allocatable :: stops(:)        ! ends of the segments
    real(wp) :: first_step = 0.0_wp          ! zero to choose it
    logical :: has_jacobian = .false.        ! whether Python evaluates it
    logical :: sparse = .false.              ! whether Python keeps it and factors it
  end type problem_t

  ! The phases of a trajectory. Each is named after what `resume` does next, or after the
  ! coefficients or the shared number that it has received.
  enum, bind(c)
    enumerator :: phase_begin_segment = 1, phase_guess_size, phase_guess_shared, &
                  phase_curvature_received, phase_size_shared, phase_choose_step, &
                  phase_start_received, phase_next_stage, phase_stage_received, &
                  phase_finish_step, phase_decide_step, phase_accepted, phase_request_end, &
                  phase_end_received, phase_next_node, phase_node_received, phase_record_step, &
                  phase_column_received, phase_error_received, phase_ended
  end enum

  type :: trajectory_t
    ! the present point
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: y(:, :)         ! (point_size, 0:paths) ends of paths; 0 is the start
    real(wp), allocatable :: slope(:)        ! (dimension) the coefficients at the start
    logical :: slope_known = .false.
    integer :: segment = 1
    type(grid_t) :: grid                     ! of equal steps in the segment
    integer(int64) :: grid_done = 0          ! steps of the grid that have been taken
    real(wp) :: step_size = 0.0_wp           ! of the next step; zero if it has to be chosen
    real(wp) :: last_error = 1.0_wp
    logical :: after_rejection = .false.
    ! the request and its answer
    integer :: status = paused               ! a Stop
    real(wp) :: request_t = 0.0_wp
    real(wp), allocatable :: request_y(:)    ! (point_size) the field may overwrite it
    real(wp), allocatable :: received(:)     ! (dimension) coefficients
    integer :: flag = 0                      ! returned by the field
    real(wp) :: shared = 0.0_wp              ! to be compared with those of other trajectories
    real(wp) :: failed_at = 0.0_wp
    ! counts
    integer(int64) :: nfev = 0, nexp = 0, njev = 0, nlu = 0, steps = 0, rejected = 0
    integer(int64) :: attempts = 0           ! steps of chosen size, rejected ones included
    ! the step
    integer :: member = 1
    integer :: phase = phase_begin_segment
    integer :: stage = 1
    integer :: paths = 0                     ! number of paths that have been followed
    integer :: path_of_u = 0                 ! path that u has the coordinates of
    integer :: result = 0                    ! column of y with the result
    logical :: shortened = .false.           ! whether it ends at the end of the segment
    real(wp) :: unshortened_size = 0.0_wp    ! size that it would have had otherwise
    real(wp) :: t_end = 0.0_wp
    real(wp) :: h = 0.0_wp                   ! signed size
    real(wp) :: error = 0.0_wp               ! in tolerances
    type(flow_sequence_t) :: flows           ! of the method, with weights times the step size
    real(wp) :: weighted_by = 0.0_wp         ! step size that these weights are multiplied by
    ! (dimension, stages) coefficients at the stages; of a two-register method the register Z
    real(wp), allocatable :: f(:, :)
    real(wp), allocatable :: end_slope(:)    ! (dimension) coefficients at the end
    logical :: end_known = .false.
    type(newton_t) :: newton                 ! of a collocation method
    real(wp), allocatable :: u(:)            ! (dimension) coordinates of a stage in the algebra
    real(wp), allocatable :: v(:), scale(:), work(:)   ! (width) workspace for error norms
    real(wp) :: norms(3) = 0.0_wp            ! of point, slope and curvature, for the first size
    real(wp) :: guessed_size = 0.0_wp
    ! output
    type(interpolant_t) :: interpolant
    logical :: needs_interpolant = .false.
    logical :: event_found = .false.
    logical :: interpolate_only = .false.    ! the interpolant of the last step, and no step
    integer :: outputs_done = 0              ! output times passed
    real(wp), allocatable :: event_before(:), event_after(:)   ! (events) values at both ends
    integer(int64), allocatable :: event_count(:)      ! (events) how often each happened
    integer :: jumps_in_place = 0            ! consecutive jumps without progress in time
    integer :: jump_event = 0                ! event whose jump the step starts from, 0 for none
    real(wp) :: value_after_jump = 0.0_wp    ! of its function
    ! the step before, whose interpolant may be requested
    logical :: keep_last = .false.
    real(wp) :: t_old = 0.0_wp, h_old = 0.0_wp
    real(wp), allocatable :: y_old(:), slope_old(:)
  end type trajectory_t

contains

  ! Allocates the memory of a trajectory.
  subroutine start(problem, within, keep_last, trajectory, memory)
    type(problem_t), intent(in) :: problem
    logical, intent(in) :: within            ! whether interpolants are needed
    logical, intent(in) :: keep_last         ! whether that of the last step may be requested
    type(trajectory_t), intent(out) :: trajectory
    integer, intent(out) :: memory           ! nonzero if an allocation failed
    integer :: n

    associate (frame => problem%frame, method => problem%method)
      trajectory%result = merge(1, method%result, method%two_registers)
      allocate (trajectory%y(frame%point_size, 0:merge(1, size(method%origin), &
                                                       method%two_registers)), &
                trajectory%f(frame%dimension, merge(1, size(method%c), method%two_registers)), &
                trajectory%request_y(frame%point_size), &
                trajectory%received(frame%dimension), trajectory%slope(frame%dimension), &
                trajectory%end_slope(frame%dimension), trajectory%u(frame%dimension), &
                stat=memory)
      if (memory /= 0) return
      trajectory%flows = method%flows
      if (method%collocation) then
        call reserve(frame%dimension, problem%sparse, trajectory%newton, memory)
      end if
      if (memory /= 0) return
      n = 0
      if (problem%adaptive) n = width(frame, problem%tolerances)
      allocate (trajectory%v(n), trajectory%scale(n), trajectory%work(n), stat=memory)
      if (memory /= 0) return
      n = 0
      if (associated(problem%events)) n = problem%events%count
      allocate (trajectory%event_before(n), trajectory%event_after(n), &
                trajectory%event_count(n), stat=memory)
      if (memory /= 0) return
      if (within) call reserve_interpolant(frame, problem%scheme, trajectory%interpolant, memory)
      if (memory /= 0 .or. .not. keep_last) return
      trajectory%keep_last = .true.
      allocate (trajectory%y_old(frame%point_size), trajectory%slope_old(frame%dimension), &
                stat=memory)
    end associate
  end subroutine start

  ! Starts a trajectory at a point, without memory of earlier steps.
  pure subroutine set_start(t, y, first_step, trajectory)
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(in) :: first_step                 ! zero to choose it
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%t = t
    trajectory%y(:, 0) = y
    trajectory%slope_known = .false.
    trajectory%end_known = .false.
    trajectory%step_size = first_step
    trajectory%last_error = 1.0_wp
    trajectory%after_rejection = .false.
    trajectory%phase = phase_begin_segment
    trajectory%status = paused
    trajectory%segment = 1
    trajectory%interpolate_only = .false.
    trajectory%jumps_in_place = 0
    trajectory%jump_event = 0
    trajectory%weighted_by = 0.0_wp
    call forget_step(trajectory)
    trajectory%event_before = 0.0_wp
    trajectory%event_count = 0
  end subroutine set_start

  ! Forgets the polynomial and the Jacobian of the step before, where the right-hand side or the
  ! solution may jump.
  pure subroutine forget_step(trajectory)
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%newton%has_jacobian = .false.
    trajectory%newton%fresh = .false.
    trajectory%newton%last_h = 0.0_wp
    trajectory%newton%rate_factor = 1.0_wp
  end subroutine forget_step

  ! Makes a trajectory continue a grid of equal steps.
  pure subroutine follow_grid(grid, done, trajectory)
    type(grid_t), intent(in) :: grid
    integer(int64), intent(in) :: done
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%grid = grid
    trajectory%grid_done = done
    trajectory%phase = phase_choose_step
    if (done == grid%steps) trajectory%phase = phase_ended
  end subroutine follow_grid

  ! Lets a trajectory that has ended continue, with other ends of segments.
  pure subroutine continue_run(trajectory)
    type(trajectory_t), intent(inout) :: trajectory

    trajectory%status = paused
    trajectory%segment = 1
    trajectory%phase = phase_begin_segment
  end subroutine continue_run

  ! Copies the state that a trajectory needs between steps to continue bit for bit.
  pure subroutine save_state(trajectory, reals, integers, points, slopes)
    type(trajectory_t), intent(in) :: trajectory
    real(wp), intent(out) :: reals(9)
    integer(int64), intent(out) :: integers(11)
    ! (point_size, 2), (dimension, 2 + columns of f, then last and jacobian of newton_t)
    real(wp), intent(out) :: points(:, :), slopes(:, :)

    associate (x => trajectory)
      reals = [x%t, x%step_size, x%last_error, x%t_old, x%h_old, x%h, x%newton%last_h, &
               x%newton%rate_factor, x%newton%factored_h]
      integers = [merge(1_int64, 0_int64, x%slope_known), merge(1_int64, 0_int64, &
                                                                x%after_rejection), &
                  x%nfev, x%nexp, x%njev, x%nlu, x%steps, x%rejected, x%attempts, &
                  merge(1_int64, 0_int64, x%newton%has_jacobian), &
                  merge(1_int64, 0_int64, x%newton%fresh)]
      points(:, 1) = x%y(:, 0)
      slopes(:, 1) = x%slope
      points(:, 2) = x%y(:, 0)
      slopes(:, 2) = x%slope
      slopes(:, 3:2 + size(x%f, 2)) = x%f
      if (allocated(x%newton%last)) then
        associate (n => 2 + size(x%f, 2), m => size(x%newton%last, 2))
          slopes(:, n + 1:n + m) = x%newton%last
          slopes(:, n + m + 1:) = x%newton%jacobian
        end associate
      end if
      if (allocated(x%y_old)) points(:, 2) = x%y_old
      if (allocated(x%slope_old)) slopes(:, 2) = x%slope_old
    end associate
  end subroutine save_state

  ! Restores what save_state has copied.
  pure subroutine load_state(trajectory, reals, integers, points, slopes)
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: reals(9)
    integer(int64), intent(in) :: integers(11)
    real(wp), intent(in) :: points(:, :), slopes(:, :)

    associate (x => trajectory)
      x%t = reals(1)
      x%step_size = reals(2)
      x%last_error = reals(3)
      x%t_old = reals(4)
      x%h_old = reals(5)
      x%h = reals(6)
      x%newton%last_h = reals(7)
      x%newton%rate_factor = reals(8)
      x%slope_known = integers(1) == 1
      x%after_rejection = integers(2) == 1
      x%nfev = integers(3)
      x%nexp = integers(4)
      x%njev = integers(5)
      x%nlu = integers(6)
      x%steps = integers(7)
      x%rejected = integers(8)
      x%attempts = integers(9)
      x%newton%has_jacobian = integers(10) == 1
      x%newton%fresh = integers(11) == 1
      x%y(:, 0) = points(:, 1)
      x%slope = slopes(:, 1)
      x%y_old = points(:, 2)
      x%slope_old = slopes(:, 2)
      x%f = slopes(:, 3:2 + size(x%f, 2))
      x%newton%factored_h = reals(9)
      if (allocated(x%newton%last)) then
        associate (n => 2 + size(x%f, 2), m => size(x%newton%last, 2))
          x%newton%last = slopes(:, n + 1:n + m)
          x%newton%jacobian = slopes(:, n + m + 1:)
        end associate
      end if
      x%weighted_by = 0.0_wp
    end associate
    call continue_run(trajectory)
  end subroutine load_state

  ! The time at which the right-hand side is evaluated in place of t. In a step that ends at a
  ! breakpoint times are kept before it, since the right-hand side may change there.
  pure elemental real(wp) function before_stop(problem, trajectory, t)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(in) :: trajectory
    real(wp), intent(in) :: t

    before_stop = t
    if (trajectory%segment == size(problem%stops)) return
    associate (stop => problem%stops(trajectory%segment))
      if ((t - stop) * sign(1.0_wp, trajectory%h) >= 0) before_stop = nearest(stop, -trajectory%h)
    end associate
  end function before_stop

  ! Requests the coefficients at a point, for the phase `next`.
  subroutine request(problem, trajectory, t, y, next)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    integer, intent(in) :: next                        ! phase

    trajectory%request_t = t
    if (next /= phase_start_received) trajectory%request_t = before_stop(problem, trajectory, t)
    trajectory%phase = next
    trajectory%status = needs_field
    trajectory%nfev = trajectory%nfev + 1
    trajectory%request_y(:) = y
    if (.not. associated(problem%field)) return
    problem%field%member = trajectory%member
    call problem%field%coefficients(problem%frame%point_size, problem%frame%dimension, &
                                    trajectory%request_t, trajectory%request_y, &
                                      trajectory%received, trajectory%flag)
    call check_coefficients(problem, trajectory, y)
  end subroutine request

  ! Checks the answer to a request: finite coefficients go to the next phase, others are a failure.
  subroutine check_coefficients(problem, trajectory, y)
    type(problem_t), intent(in) :: problem
    type(trajectory_t), intent(inout) :: trajectory
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) where f was evaluated

    if (trajectory%flag == 0) then
      if (finite(trajectory%received)) then
        trajectory%status = finished
        return
      end if
    end if
    if (trajectory%flag == raised_in_python) then
      call fail(trajectory, raised, trajectory%request_t)
    else if (.not. finite(y)) then
      call reject_stage(problem, trajectory, stage_not_finite, trajectory%request_t)
    else if (trajectory%flag /= 0) then
      call fail(trajectory, stopped_by_field, trajectory%request_t)
    else
      call fail(trajectory, field_not_finite, trajectory%request_t)
    end if
  end subroutine check_coefficients

  ! Tries a step again with a smaller size after a stage that doesn't exist; equal steps fail.
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
    case (phase_curvature_received)
      trajectory%received = huge(1.0_wp)               ! choose_first_size keeps the guess
    case (phase_stage_received, phase_next_stage, phase_finish_step, phase_error_received)
      trajectory%error = huge(1.0_wp)
      trajectory%shared = trajectory%error
      trajectory%status = finished
      trajectory%phase = phase_decide_step
      if (problem%common) trajectory%status = needs_maximum
    case (phase_node_received)
      ! the step is accurate, but too long for its interpolant
      if (trajectory%interpolate_only .or. problem%common) then
        call fail(trajectory, status, t)
        return
      end if
      trajectory%steps = trajectory%steps - 1
      trajectory%rejected = trajectory%rejected + 1
      trajectory%after_rejection = .true.
      trajectory%step_size = rejected_size(abs(trajectory%h), huge(1.0_wp), &
                                           problem%tolerances%exponent)
      trajectory%status = finished
      trajectory%phase = phase_choose_step
    case default
      call fail(trajectory, status, t)
    end select
  end subroutine reject_stage

  ! Evaluates the functions of all events at a point; the trajectory fails if one of them does.
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

  ! Ends a trajectory with an error.
  subroutine fail(trajectory, status, t)
    type(trajectory_t), intent(inout) :: trajectory
    integer, intent(in) :: status
    real(wp), intent(in) :: t

    trajectory%status = status
    trajectory%failed_at = t
  end subroutine fail

  ! Tells whether all numbers are finite. With ieee_is_finite every procedure that uses its module
  ! would save and restore the floating-point state.
  pure logical function finite(x)
    real(wp), contiguous, intent(in) :: x(:)

    finite = all(abs(x) <= huge(x))
  end function finite

  ! Copies a vector. In a procedure of its own the compiler knows that two columns of an array don't
  ! overlap.
  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)

    to = from
  end subroutine copy

end module trajectory_m
