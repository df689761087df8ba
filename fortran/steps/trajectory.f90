! The problem that a trajectory solves, and the state of the trajectory. Modules of the loop call a
! trajectory x; in run_m it is a lane, for one member after another.
module trajectory_m
  use kinds, only: wp
  use coordinates_m, only: tolerances_t
  use events_m, only: events_t, observer_t
  use frames_m, only: frame_t
  use interpolant_m, only: evaluate_interpolant, interpolant_t, reserve_interpolant
  use joints_m, only: constraints_t
  use linear_action_m, only: inner_points_t
  use method_m, only: method_t
  use inputs_m, only: grid_t, rhs_t
  use phases_m, only: phase_begin_segment, phase_request_ends, phase_store_output
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_loc, c_ptr
  use, intrinsic :: iso_fortran_env, only: int64, int8
  use shared_numbers, only: collocation_kind, counters_t, implicit_kind, outside_jacobian, &
                            parts_of_series_estimate, paused, proposed_for_point, record_t, &
                            registers_kind, splitting_kind, terminal_event
  implicit none
  private
  public :: event_state_t, last_step_times_t, problem_t, trajectory_t, zero_t, &
            continue_trajectory, exchange_state, fail, forget_step, point_at, reserve_trajectory, &
            set_start, time_at

  ! Rows of queries_t: the event, or 0 for all, fraction of the step, time, and member from 0
  integer, parameter, public :: query_event = 1, query_theta = 2, query_time = 3, &
    query_member = 4, query_numbers = 4

  type :: problem_t
    type(record_t), pointer :: record => null()        ! numbers and addresses from Python
    type(frame_t) :: frame                   ! the frame of the plan, with the callback of this run
    type(method_t), pointer :: method => null()
    type(events_t) :: events
    type(rhs_t) :: rhs                       ! unless it is vectorized
    type(observer_t) :: step_function        ! how steps vary, see step_size_m
    logical :: adaptive = .false.
    type(tolerances_t) :: tolerances         ! for adaptive steps
    real(wp), allocatable :: stops(:)        ! ends of the segments
    real(wp) :: duration = 0.0_wp            ! of the integration, with adaptive steps
    real(wp), allocatable :: step_limits(:, :)         ! (2, n) a time t, the largest step from t on
    ! Points at output times within a step along polynomials, of the trajectory that owns it. All
    ! trajectories share this memory, and compute lost points again.
    type(inner_points_t) :: inner
  end type problem_t

  ! Numbers that collocation_m keeps between steps
  type :: newton_state_t
    logical :: has_jacobian = .false., fresh = .false. ! fresh: the Jacobian is at the present point
    logical :: replaced = .false.            ! whether the caller has replaced the last step's end
    real(wp) :: factored_h = 0.0_wp          ! step size of the factors, 0 if there are none
    real(wp) :: rate_factor = 1.0_wp         ! rate / (1 - rate) of the last iteration
    real(wp) :: h_before = 0.0_wp            ! the last step, 0 if the solution jumped after it
  end type newton_state_t

  ! The state of collocation_m: coordinates z of the stages in the Lie algebra, and what solves them
  type, extends(newton_state_t) :: collocation_t
    integer :: column = 0                    ! the column of the Jacobian that comes next
    integer :: iteration = 0                 ! 0 before the first one of an attempt
    real(wp) :: correction = 0.0_wp          ! norm of the last correction of z
    real(wp) :: rate = 0.0_wp                ! factor by which corrections have decreased
    real(wp), allocatable :: slopes_before(:, :)       ! (dimension, 3) F_j of the last step
    ! (dimension, 3); while the Jacobian is evaluated, displacements of differences in column 1
    real(wp), allocatable :: z(:, :)
    real(wp), allocatable :: jacobian(:, :)  ! (dimension, dimension), or no column if it is sparse
    real(wp), allocatable :: lu(:, :)                  ! factors of gamma / h - J
    complex(wp), allocatable :: complex_lu(:, :)       ! factors of mu / h - J
    integer, allocatable :: pivot(:), complex_pivot(:)
  end type collocation_t

  ! The state of implicit_m
  type :: implicit_t
    logical :: fixed_point = .false.         ! whether no Jacobian is used
    integer :: first_stage = 0, last_stage = 0         ! of the block, 0 before the first block
    integer :: iteration = 0
    integer :: column = 0                    ! the column of the Jacobian that comes next, or 0
    real(wp) :: undisplaced = 0.0_wp, displacement = 0.0_wp    ! of the unknown of this column
    real(wp) :: correction = 0.0_wp          ! the last one, relative
    real(wp) :: residual = 0.0_wp, min_residual = 0.0_wp       ! the last and the smallest one
    real(wp), allocatable :: value(:, :)     ! (dimension, stages) coefficients at the stages
    real(wp), allocatable :: factored_h(:)   ! (blocks) step sizes of the factors, or 0
    real(wp), allocatable :: lu(:, :, :)     ! (unknowns, unknowns, blocks) Jacobian or factors
    integer, allocatable :: pivot(:, :)      ! (unknowns, blocks)
  end type implicit_t

  ! A request for coefficients and its answer
  type :: request_t
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: y(:)            ! (point_size) a copy
    real(wp), allocatable :: answer(:)       ! (dimension) coefficients
    real(wp), allocatable :: slope(:)        ! (point_size) a derivative
    integer :: detail = 0                    ! what the right-hand side returned, or see `fail`
    real(wp) :: shared = 0.0_wp              ! the number of `share`, in requests_m
  end type request_t

  ! The state of the step size control
  type :: control_t
    real(wp) :: step_size = 0.0_wp           ! of the next step; zero if it has to be chosen
    real(wp) :: last_error = 1.0_wp          ! of the last accepted step, in tolerances
    logical :: after_rejection = .false.
    integer :: suspicion = 0                 ! how likely f has jumped, see controller_m
    integer(int64) :: attempts = 0           ! steps of chosen size, rejected ones included
    logical :: shortened = .false.           ! whether a stop or `step_limits` shorten the step
    real(wp) :: unshortened_size = 0.0_wp    ! size that it would have had otherwise
    real(wp) :: point_norm = 0.0_wp, slope_norm = 0.0_wp       ! in tolerances, for the first size
    real(wp) :: guessed_size = 0.0_wp        ! of the first step, before the curvature is known
  end type control_t

  ! Errors as norms in tolerances. From phase to phase only `scale` stays, from guess_size to
  ! choose_first_size; request_error reads the displacement that estimate_error has left.
  type :: norms_t
    real(wp), allocatable :: scale(:)        ! (width) the tolerances
    real(wp), allocatable :: difference(:)   ! (width) of two points
    real(wp), allocatable :: displacement(:) ! (dimension) an error as coefficients of a field
    real(wp), allocatable :: change(:)       ! (width) of a point by the displacement
  end type norms_t

  ! The error of a step, and from which it is estimated besides stages and results
  type :: estimate_t
    real(wp) :: error = 0.0_wp               ! in tolerances
    real(wp), allocatable :: added(:, :)     ! (dimension, summands) what dexp^-1 has added to f
    real(wp), allocatable :: f_before(:, :)  ! f of the step before, of a Magnus method
    real(wp) :: h_before = 0.0_wp            ! signed size of that step, 0 without one
  end type estimate_t

  ! A zero of the function of an event within a step
  type :: zero_t
    real(wp) :: theta = 0.0_wp               ! fraction of the step
    integer :: event = 0, sign_before = 0    ! sign_before: of the function before the zero
    logical :: stored = .false.
  end type zero_t

  ! An event of a trajectory
  type :: event_state_t
    real(wp) :: at_start = 0.0_wp, at_end = 0.0_wp     ! values of its function in the step
    integer(int64) :: count = 0              ! how often it happened
    real(wp) :: time = 0.0_wp                ! when it happened last
    ! sign of the function before an event at the start of the step or just before it, 0 if none
    integer :: sign_before = 0
    real(wp) :: residual = 0.0_wp            ! the function at that event, its rounding error there
    real(wp) :: zero_tolerance = 0.0_wp      ! values up to it count as zero after events
  end type event_state_t

  ! Values of events that are requested, or known by an answer
  type :: queries_t
    integer :: count = 0, answered = 0       ! columns in use, and those with an answer
    ! (query_numbers + point_size + events, capacity) numbers, the point, and values as the answer
    real(wp), allocatable :: columns(:, :)
  end type queries_t

  type :: last_step_times_t
    logical :: cut = .false.                 ! by an event; its interpolant is complete
    real(wp) :: t = 0.0_wp, start = 0.0_wp, h = 0.0_wp ! start: t, or just after a breakpoint at t
  end type last_step_times_t

  ! The step before, whose interpolant may be requested
  type, extends(last_step_times_t) :: last_step_t
    logical :: requested = .false.           ! whether its interpolant is to be stored, and no step
    real(wp), allocatable :: y(:), slope(:)  ! point and coefficients at its start
  end type last_step_t

  ! The joints of a splitting method's frame
  type :: joints_t
    type(constraints_t) :: constraints       ! at `configuration`, with the factor
    type(constraints_t) :: trial             ! at the end of a trial drift
    real(wp), allocatable :: configuration(:)
    real(wp), allocatable :: impulse(:, :, :)          ! (dimension, 2, paths) in the last two steps
  end type joints_t

  ! Numbers that a trajectory needs between steps
  type :: state_t
    integer :: status = paused               ! a LoopStatus
    real(wp) :: failed_at = 0.0_wp
    type(counters_t) :: counts
    ! the present point
    real(wp) :: t = 0.0_wp
    logical :: slope_known = .false., end_known = .false.
    type(grid_t) :: grid                     ! equal steps in the segment
    type(control_t) :: control
    real(wp) :: h = 0.0_wp                   ! signed size of the step
    logical :: events_known = .false.        ! whether events have values at the start of the step
    integer :: jumps_in_place = 0            ! consecutive jumps without progress in time
  end type state_t

  ! Members are grouped by the modules that compute them; what starts a step, or tries it again,
  ! resets them. Arrays that only some methods or callers need have no column for others.
  type, extends(state_t) :: trajectory_t
    ! what doesn't change along a trajectory; parts of the problem, which are read most often
    type(problem_t), pointer :: problem => null()
    type(frame_t), pointer :: frame => null()
    type(method_t), pointer :: method => null()
    type(tolerances_t), pointer :: tolerances => null()
    integer :: member = 1
    integer :: result = 0                    ! column of y with the result of a step
    ! all phases: the next one, and the request whose answer it needs
    integer :: phase = phase_begin_segment
    type(request_t) :: request
    ! step_size_m, which starts a step
    integer :: segment = 1
    real(wp) :: t_end = 0.0_wp               ! the end of the step
    real(wp), allocatable :: weight(:)       ! (terms) of the method's flows, times h
    ! paths_m, implicit_m and collocation_m, each for the stages of some kinds of methods
    integer :: stage = 1, paths_followed = 0
    real(wp), allocatable :: y(:, :)         ! (point_size, 0:paths) ends of paths; 0 is the start
    real(wp), allocatable :: v(:, :)         ! (dimension, flows) the flows followed last
    ! (dimension, summands) see method_t; of a two-register method the register Z
    real(wp), allocatable :: f(:, :)
    type(joints_t) :: joints                 ! paths_m alone
    type(implicit_t) :: implicit             ! implicit_m alone
    type(collocation_t) :: collocation       ! collocation_m alone
    ! error_estimate_m; errors also step_m, norms also step_size_m and collocation_m
    type(estimate_t) :: estimate
    type(norms_t) :: norms
    ! paths_m, if a stage is there, or accepted_step_m; step_size_m for the start
    real(wp), allocatable :: slope(:), end_slope(:)    ! (dimension) coefficients at start and end
    ! accepted_step_m, which goes on from an accepted step
    type(interpolant_t) :: interpolant
    integer :: outputs_passed = 0            ! output times passed
    type(last_step_t) :: last
    ! step_events_m, and requests_m, which evaluates functions of events
    type(event_state_t), allocatable :: events(:)
    type(zero_t), allocatable :: zeros(:)    ! within the step, once they are known
    type(queries_t) :: queries
    ! any phase: workspace for a point within the step
    real(wp), allocatable :: point(:)        ! (point_size)
  end type trajectory_t

contains

  ! Allocates the arrays of a trajectory: those of all methods, then those of some.
  subroutine reserve_trajectory(problem, x, alloc_status)
    type(problem_t), target, intent(in) :: problem
    type(trajectory_t), intent(out) :: x
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed
    integer :: paths, summands, width

    x%problem => problem
    x%frame => problem%frame
    x%method => problem%method
    x%tolerances => problem%tolerances
    associate (frame => problem%frame, method => problem%method, record => problem%record, &
               n => problem%frame%point_size, m => problem%frame%dimension, &
               first => problem%method%path_first, events => problem%events%count)
      paths = merge(1, size(method%origin), method%kind == registers_kind)
      summands = merge(1, size(method%error, 1), method%kind == registers_kind)
      x%result = merge(1, method%result, method%kind == registers_kind)
      width = merge(size(problem%tolerances%atol), 0, problem%adaptive)
      allocate (x%request%y(n), x%request%slope(merge(n, 0, frame%derivatives)), &
                x%request%answer(m), x%weight(size(method%flows%weight)), &
                x%v(m, maxval([1, first(2:) - first(:size(first) - 1)])), x%f(m, summands), &
                x%slope(m), x%end_slope(m), x%events(events), &
                x%queries%columns(query_numbers + n + events, 0), x%norms%scale(width), &
                x%norms%difference(width), x%norms%change(width), x%norms%displacement(m), &
                x%point(n), stat=alloc_status)
      if (alloc_status /= 0) return
      allocate (x%y(n, 0:paths), x%last%y(merge(n, 0, record%keep_last)), &
                x%last%slope(merge(m, 0, record%keep_last)), &
                x%estimate%f_before(m, merge(summands, 0, method%uses_last_nodes)), &
                x%estimate%added(m, merge(summands, 0, problem%adaptive .and. &
                                          method%estimate == parts_of_series_estimate)), &
                x%joints%impulse(m, 2, merge(paths, 0, frame%jointed &
                                             .and. method%kind == splitting_kind)), &
                source=0.0_wp, stat=alloc_status)
      if (alloc_status == 0) call reserve_implicit(x, alloc_status)
      if (alloc_status == 0 .and. (record%dense .or. record%outputs > 0 .or. events > 0 &
                             .or. record%keep_last)) &
        call reserve_interpolant(frame, method%scheme, x%interpolant, alloc_status)
    end associate
  end subroutine reserve_trajectory

  ! Allocates arrays for the equations of implicit stages, empty ones for other methods.
  subroutine reserve_implicit(x, alloc_status)
    type(trajectory_t), intent(inout) :: x
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed
    integer :: blocks, k, n, summands, unknowns

    blocks = merge(x%method%blocks, 0, x%method%kind == implicit_kind)
    summands = merge(size(x%f, 2), 0, blocks > 0)
    unknowns = size(x%f, 1) * summands / max(1, blocks)
    k = merge(size(x%f, 1), 0, x%method%kind == collocation_kind)
    n = k
    if (x%problem%record%jacobian == outside_jacobian) then      ! no matrix is stored here
      x%implicit%fixed_point = .true.
      unknowns = 0
      n = 0
    end if
    associate (newton => x%collocation, solver => x%implicit)
      allocate (newton%slopes_before(k, 3), newton%z(k, 3), newton%jacobian(k, n), &
                newton%lu(n, n), newton%complex_lu(n, n), newton%pivot(n), &
                newton%complex_pivot(n), solver%value(size(x%f, 1), summands), &
                solver%factored_h(blocks), solver%lu(unknowns, unknowns, blocks), &
                solver%pivot(unknowns, blocks), stat=alloc_status)
    end associate
  end subroutine reserve_implicit

  ! Starts a trajectory at a point, without memory of earlier steps.
  pure subroutine set_start(t, y, first_step, x)
    real(wp), intent(in) :: t
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), intent(in) :: first_step     ! zero to choose it, or proposed_for_point or _for_f
    type(trajectory_t), intent(inout) :: x
    ! smaller moves, relative to the last step, leave its polynomial and Jacobian valid
    real(wp), parameter :: small_move = 0.1_wp
    logical :: same                          ! whether the trajectory was at this point already
    logical :: near                          ! whether the last step led near to it

    same = x%t == t .and. all(x%y(:, 0) == y)
    near = first_step < 0 .and. first_step >= proposed_for_point .and. size(x%last%y) > 0 &
           .and. x%t == t
    if (near) near = maxval(abs(y - x%y(:, 0))) <= small_move * maxval(abs(x%y(:, 0) - x%last%y))
    x%state_t = state_t(failed_at=x%failed_at, counts=x%counts, t=t, h=x%h, &
      control=control_t(step_size=x%control%step_size, attempts=x%control%attempts))
    x%last%cut = .false.
    x%y(:, 0) = y
    x%joints%constraints%factored = .false.            ! members may have inertia of their own
    if (first_step >= 0) then
      x%control%step_size = first_step
    else if (.not. x%control%step_size > 0) then
      x%control%step_size = x%problem%record%first_step
    end if
    call forget_step(x, near)
    x%events%at_start = 0.0_wp
    x%events%count = 0
    call continue_trajectory(x, .false.)
    if (same) return
    x%events%time = huge(1.0_wp)
    x%events%sign_before = 0
  end subroutine set_start

  ! Forgets the step before, where the right-hand side or the solution may jump.
  pure subroutine forget_step(x, near)
    type(trajectory_t), intent(inout) :: x
    logical, intent(in) :: near              ! whether polynomial and Jacobian may still serve

    x%estimate%h_before = 0.0_wp
    x%joints%impulse = 0.0_wp
    x%implicit%factored_h = 0.0_wp
    x%collocation%fresh = .false.
    x%collocation%replaced = near
    if (near) return
    x%collocation%newton_state_t = newton_state_t(factored_h=x%collocation%factored_h)
  end subroutine forget_step

  ! Lets a trajectory continue after its end, or requests the interpolant of its last step alone.
  pure subroutine continue_trajectory(x, interpolating)
    type(trajectory_t), intent(inout) :: x
    logical, intent(in) :: interpolating

    x%status = paused
    x%segment = 1
    x%last%requested = interpolating
    x%phase = phase_begin_segment
    if (interpolating) x%phase = merge(phase_store_output, phase_request_ends, x%last%cut)
    if (allocated(x%zeros)) deallocate (x%zeros)
    x%queries%count = 0
    x%queries%answered = 0
  end subroutine continue_trajectory

  ! Copies or restores the state of a trajectory between steps, with which it continues bit for bit.
  subroutine exchange_state(x, restores, bytes, used)
    type(trajectory_t), target, intent(inout) :: x
    logical, intent(in) :: restores
    integer(int8), intent(inout) :: bytes(:) ! as many as are used, or none to count them
    integer(int64), intent(out) :: used
    integer :: status

    used = 0
    call move(c_loc(x%state_t), storage_size(x%state_t), 1)
    call move(c_loc(x%collocation%newton_state_t), storage_size(x%collocation%newton_state_t), 1)
    call move(c_loc(x%last%last_step_times_t), storage_size(x%last%last_step_times_t), 1)
    call move(c_loc(x%estimate%h_before), storage_size(x%estimate%h_before), 1)
    if (size(x%events) > 0) call move(c_loc(x%events), storage_size(x%events), size(x%events))
    call move_numbers(size(x%y, 1), x%y)
    call move_numbers(size(x%slope), x%slope)
    call move_numbers(size(x%end_slope), x%end_slope)
    call move_numbers(size(x%f), x%f)
    call move_numbers(size(x%last%y), x%last%y)
    call move_numbers(size(x%last%slope), x%last%slope)
    call move_numbers(size(x%estimate%f_before), x%estimate%f_before)
    call move_numbers(size(x%joints%impulse), x%joints%impulse)
    call move_numbers(size(x%collocation%slopes_before), x%collocation%slopes_before)
    call move_numbers(size(x%collocation%jacobian), x%collocation%jacobian)
    call move_numbers(size(x%implicit%factored_h), x%implicit%factored_h)
    call move_numbers(size(x%implicit%lu), x%implicit%lu)
    if (size(x%implicit%pivot) > 0) &
      call move(c_loc(x%implicit%pivot), storage_size(x%implicit%pivot), size(x%implicit%pivot))
    if (.not. restores) return
    x%last%cut = .false.                     ! the interpolant isn't saved
    status = x%status
    call continue_trajectory(x, .false.)
    if (status == terminal_event) x%status = status

  contains

    ! Copies items at an address to the next bytes, or from there. Large matrices have many bytes.
    subroutine move(address, bits, items)
      type(c_ptr), intent(in) :: address
      integer, intent(in) :: bits, items
      integer(int8), pointer, contiguous :: part(:)
      integer(int64) :: count

      count = int(bits / 8, int64) * int(items, int64)
      call c_f_pointer(address, part, [count])
      used = used + count
      if (used > size(bytes, kind=int64)) return
      if (restores) part = bytes(used - count + 1:used)
      if (.not. restores) bytes(used - count + 1:used) = part
    end subroutine move

    ! Copies numbers to the next bytes, or from there. An empty array has no address.
    subroutine move_numbers(count, numbers)
      integer, intent(in) :: count
      real(wp), target, intent(inout) :: numbers(count)

      if (count > 0) call move(c_loc(numbers), storage_size(numbers), count)
    end subroutine move_numbers
  end subroutine exchange_state

  ! Evaluates the solution at a fraction theta of the step.
  subroutine point_at(x, theta, y)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: theta
    real(wp), contiguous, intent(out) :: y(:)

    if (.not. theta < 1) then
      y = x%y(:, x%result)
    else if (.not. theta > 0) then
      y = x%y(:, 0)
    else
      call evaluate_interpolant(x%interpolant, theta, y)
    end if
  end subroutine point_at

  ! The time at a fraction of the step. Only the fraction 0 has the time of the start: a later event
  ! whose time rounds to it gets the next number, so that times increase.
  pure real(wp) function time_at(x, theta)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: theta

    time_at = x%t_end
    if (theta < 1) time_at = x%t + theta * (x%t_end - x%t)
    if (theta > 0 .and. time_at == x%t) time_at = nearest(x%t, x%t_end - x%t)
  end function time_at

  ! Ends a trajectory, with the reason and the time for the message to the user.
  subroutine fail(x, status, t, detail)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: status                      ! a LoopStatus
    real(wp), intent(in) :: t
    integer, optional, intent(in) :: detail            ! iterations, an event or a function

    x%status = status
    x%failed_at = t
    if (present(detail)) x%request%detail = detail
  end subroutine fail

end module trajectory_m
