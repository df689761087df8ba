! The interpolant of a step of a trajectory.
! Its nodes are requested one after the other, until it is complete.
module within_step_m
  use kinds, only: wp
  use free_motion_m, only: add_constraint_forces
  use blocks_m, only: combine_flows
  use interpolant_m, only: add_node, begin_interpolant, evaluate_interpolant, &
       flows_of_evaluation, make_cubic, next_node, reserve_interpolant
  use requests_m, only: reject_accepted_step, request
  use method_m, only: registers_kind, splitting_kind
  use phases_m
  use trajectory_m, only: fail, trajectory_t
  use iso_fortran_env, only: int64
  use shared_numbers, only: callback_block, finished, out_of_memory, paused, step_too_long
  use vectors_m, only: finite
  implicit none
  private
  public :: store_begin, store_node, interpolate, store_end, point_at, request_ends, &
            request_node, request_interpolant

contains

  ! Requests the interpolant of the last step, and no further step.
  subroutine request_interpolant(x)
    type(trajectory_t), intent(inout) :: x
    integer :: memory

    x%interpolate_only = .true.
    x%status = paused
    x%phase = merge(phase_store_output, phase_request_ends, x%last%cut)
    call reserve_interpolant(x%frame, x%problem%scheme, x%interpolant, memory)
    if (memory /= 0 .and. .not. x%last%cut) call fail(x, out_of_memory, x%t)
  end subroutine request_interpolant

  ! Requests the coefficients at the ends of a step, the present one or the one before, that aren't
  ! known; then its interpolant starts.
  subroutine request_ends(x)
    type(trajectory_t), intent(inout) :: x

    if (x%interpolate_only) then
      if (.not. finite(size(x%last%slope), x%last%slope)) then
        call request(x, x%last%t, x%last%y, phase_begin_received)
      else if (.not. x%slope_known) then
        call request(x, x%t, x%y(:, 0), phase_end_received)
      else
        call interpolate(x)
      end if
    else if (.not. x%slope_known) then
      call request(x, x%t, x%y(:, 0), phase_begin_received)
    else if (.not. x%end_known) then
      call request(x, x%t_end, x%y(:, x%result), phase_end_received)
    else
      call interpolate(x)
    end if
  end subroutine request_ends

  ! Stores the coefficients at the start of a step.
  subroutine store_begin(x)
    type(trajectory_t), intent(inout) :: x

    if (x%interpolate_only) then
      x%last%slope(:) = x%request%answer
    else
      x%slope(:) = x%request%answer
      x%slope_known = .true.
    end if
    call request_ends(x)
  end subroutine store_begin

  ! Stores the coefficients at the end of a step, and starts its interpolant.
  subroutine store_end(x)
    type(trajectory_t), intent(inout) :: x

    if (x%interpolate_only) then
      x%slope(:) = x%request%answer
      x%slope_known = x%t == x%request%t
    else
      x%end_slope(:) = x%request%answer
      x%end_known = .true.
    end if
    call interpolate(x)
  end subroutine store_end

  ! Starts the interpolant of the present step, or of the one before. If only events may need it,
  ! they are sought first along what is known of it from the ends of the step.
  subroutine interpolate(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists
    integer :: status

    associate (self => x%interpolant)
      self%noisy = x%problem%record%heated /= 0
      if (x%interpolate_only) then
        self%t0 = x%last%t
        self%h = x%last%h
        self%y0(:) = x%last%y
        self%y1(:) = x%y(:, 0)
        self%field(:, 1) = x%last%slope
        self%field(:, 2) = x%slope
      else
        self%t0 = x%t
        self%h = x%t_end - x%t
        self%y0(:) = x%y(:, 0)
        self%y1(:) = x%y(:, x%result)
        self%field(:, 1) = x%slope
        self%field(:, 2) = x%end_slope
      end if
    end associate
    if (allocated(x%joints%impulse)) then            ! slopes are forces alone
      call add_constraint_forces(x%frame, x%interpolant%y0, .true., x%interpolant%field(:, 1), &
                                 status)
      if (status == finished) call add_constraint_forces(x%frame, x%interpolant%y1, &
                                                         .true., x%interpolant%field(:, 2), status)
      if (status /= finished) then
        call fail(x, status, x%interpolant%t0)
        return
      end if
    end if
    x%interpolant%path = flows_of_step(x, x%interpolant%h)
    call begin_interpolant(x%problem%record%unique_flows /= 0, x%f, x%interpolant, exists)
    if (x%needs_interpolant .or. x%interpolate_only .or. x%interpolant%complete) then
      call advance_interpolant(x, exists)
    else
      call make_cubic(exists, x%interpolant)
      x%phase = phase_detect_events
    end if
  end subroutine interpolate

  ! The flows of a step of a frame in Python; none of a method that doesn't keep what they combine
  function flows_of_step(x, h) result(flows)
    type(trajectory_t), intent(in) :: x
    real(wp), intent(in) :: h
    real(wp), allocatable :: flows(:)
    integer :: path

    allocate (flows(0))
    if (.not. any(x%frame%blocks%kind == callback_block) .or. &
        x%method%kind == registers_kind .or. x%method%kind == splitting_kind) return
    path = x%method%result
    do while (path > 0)
      associate (first => x%method%path_first(path), last => x%method%path_first(path + 1) - 1)
        block
          real(wp) :: v(size(x%f, 1), first:last)
          call combine_flows(x%method%flows, h * x%method%flows%weight, first, last, size(v, 1), &
                             x%f, v)
          flows = [reshape(v, [size(v)]), flows]
        end block
      end associate
      path = x%method%origin(path)
    end do
  end function flows_of_step

  ! Chooses the phase after a node of the interpolant.
  subroutine advance_interpolant(x, exists)
    type(trajectory_t), intent(inout) :: x
    logical, intent(in) :: exists

    x%counts%nexp = x%counts%nexp + int(x%interpolant%nexp, int64)
    x%interpolant%nexp = 0
    if (.not. exists) then
      call reject_accepted_step(x, step_too_long, x%interpolant%t0)
    else
      x%phase = merge(phase_complete_step, phase_next_node, x%interpolant%complete)
    end if
  end subroutine advance_interpolant

  ! Moves to the next node and requests the coefficients there.
  subroutine request_node(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: theta

    call next_node(x%interpolant, theta)
    x%counts%nexp = x%counts%nexp + int(flows_of_evaluation(x%interpolant), int64)
    call request(x, x%interpolant%t0 + theta * x%interpolant%h, &
                 x%interpolant%y, phase_node_received)
  end subroutine request_node

  ! Stores the coefficients at a node.
  subroutine store_node(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    call add_node(x%request%answer, x%interpolant, exists)
    call advance_interpolant(x, exists)
  end subroutine store_node

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

end module within_step_m
