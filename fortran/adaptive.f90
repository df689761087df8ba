! Steps of an embedded pair whose size is chosen by the error estimate, and steps of given sizes, with
! the solution between them. The decisions are those of cg/integration/adaptive.py, which says why; a
! test compares the steps.
module adaptive
  use kinds_r64, only: wp
  use coordinates, only: difference, sizes
  use frames_r64, only: frame_t, move, restore
  use stepper_r64, only: evaluate, failure_t, finished, finite, grid_t, make_row, paused, row_t, &
                         slope_not_finite, solution_not_finite, stage_not_finite, step_too_small, &
                         vector_field_t
  implicit none
  private
  public :: run_t, output_t, make_pair, integrate_adaptive, integrate_on_grid

  real(wp), parameter :: safety = 0.9_wp
  real(wp), parameter :: smallest_factor = 0.2_wp
  real(wp), parameter :: largest_factor = 5.0_wp
  real(wp), parameter :: failure_factor = 0.25_wp     ! where there is no estimate
  real(wp), parameter :: last_power = 0.7_wp
  real(wp), parameter :: before_last_power = 0.4_wp
  real(wp), parameter :: first_error = 0.01_wp
  real(wp), parameter :: nothing = 1e-5_wp
  real(wp), parameter :: blind_fraction = 1e-6_wp
  real(wp), parameter :: smallest_step = 10.0_wp      ! in spacings of numbers at the time

  type :: run_t
    ! the pair
    type(row_t), allocatable :: rows(:)     ! (stages + 2): stages, weights, embedded weights
    real(wp), allocatable :: c(:)           ! (stages)
    ! what is asked for
    real(wp), allocatable :: atol(:)        ! (dimension)
    real(wp) :: rtol = 0.0_wp
    real(wp) :: exponent = 0.0_wp           ! of errors, in the choice of a step
    real(wp) :: stop = 0.0_wp               ! final time
    real(wp) :: max_step = 0.0_wp
    ! where the run is
    real(wp) :: t = 0.0_wp
    real(wp) :: size = 0.0_wp               ! of the next step; zero if it has to be chosen
    real(wp) :: last_error = 1.0_wp
    logical :: after_rejection = .false.
    logical :: known = .false.              ! whether f(:, 1) belongs to t and point
    real(wp), allocatable :: point(:)       ! (point_size)
    real(wp), allocatable :: f(:, :)        ! (dimension, stages)
    ! what was done in this call
    integer :: attempts = 0
    integer :: accepted = 0
    integer :: nfev = 0
    integer :: nexp = 0
  end type run_t

  ! Memory of the caller
  type :: output_t
    logical :: keep = .false.                            ! whether steps are stored
    real(wp), pointer, contiguous :: t(:) => null()      ! (attempts): ends of steps
    real(wp), pointer, contiguous :: y(:, :) => null()   ! (point_size, attempts): points there
    ! (dimension, attempts): coefficients at the beginnings of steps
    real(wp), pointer, contiguous :: f(:, :) => null()
    real(wp), pointer, contiguous :: wanted(:) => null() ! times, in the direction of integration
    real(wp), pointer, contiguous :: y_wanted(:, :) => null()    ! (point_size, wanted)
    integer :: used = 0                                  ! how many of them were reached
  end type output_t

contains

  ! The abscissae are given, since the sums of rounded coefficients may be other numbers.
  subroutine make_pair(frame, a, b, embedded, c, run)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: a(:, :)          ! (stages, stages), strictly lower triangular
    real(wp), intent(in) :: b(:)             ! (stages)
    real(wp), intent(in) :: embedded(:)      ! (stages)
    real(wp), intent(in) :: c(:)             ! (stages)
    type(run_t), intent(inout) :: run
    integer :: i

    allocate (run%rows(size(b) + 2), run%f(frame%dimension, size(b)))
    do i = 1, size(b)
      call make_row(a(i, :i - 1), 1.0_wp, run%rows(i))
    end do
    call make_row(b, 1.0_wp, run%rows(size(b) + 1))
    call make_row(embedded, 1.0_wp, run%rows(size(b) + 2))
    run%c = c
  end subroutine make_pair

  ! Takes steps until the end, a failure, or as many trial steps as budget allows.
  subroutine integrate_adaptive(field, frame, run, output, budget, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    type(output_t), intent(inout) :: output
    integer, intent(in) :: budget
    type(failure_t), intent(out) :: failure
    real(wp) :: reached(frame%point_size), sign_of_time, end, taken, error, factor, smallest

    sign_of_time = sign(1.0_wp, run%stop - run%t)
    do while (abs(run%stop - run%t) > 0)
      if (run%attempts == budget) then
        failure%status = paused
        return
      end if
      if (.not. run%size > 0) call choose_first_step(field, frame, run, failure)
      if (failure%status /= finished) return
      smallest = smallest_step * spacing_at(run%t)
      run%size = min(run%size, run%max_step)
      if (run%size < smallest) then
        failure = failure_t(status=step_too_small, t=run%t)
        return
      end if
      end = run%t + sign_of_time * run%size
      if (sign_of_time * (end - run%stop) >= 0) end = run%stop
      taken = abs(end - run%t)
      run%attempts = run%attempts + 1
      call attempt(field, frame, run, end - run%t, reached, error, failure)
      if (failure%status == stage_not_finite) then
        failure = failure_t()
        error = huge(error)
      end if
      if (failure%status /= finished) return
      if (.not. error <= 1) then
        run%after_rejection = .true.
        factor = failure_factor
        if (error < huge(error)) then
          factor = max(smallest_factor, safety * error**(-run%exponent))
        end if
        run%size = taken * factor
        cycle
      end if

      factor = largest_factor
      if (error > 0) then
        factor = error**(-last_power) * run%last_error**before_last_power
        factor = min(largest_factor, max(smallest_factor, safety * factor**run%exponent))
      end if
      if (run%after_rejection) factor = min(factor, 1.0_wp)
      run%size = taken * factor
      run%last_error = max(error, 1e-4_wp)
      run%after_rejection = .false.
      call accept(field, frame, run, end, reached, output, failure)
      if (failure%status /= finished) return
    end do
  end subroutine integrate_adaptive

  ! Takes the steps of a grid up to its pause.
  subroutine integrate_on_grid(field, frame, run, output, grid, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    type(output_t), intent(inout) :: output
    type(grid_t), intent(in) :: grid
    type(failure_t), intent(out) :: failure
    real(wp) :: reached(frame%point_size), end, h
    integer :: k

    do k = grid%done + 1, grid%pause
      h = grid%step
      end = grid%start + real(k, wp) * grid%step
      if (k == grid%steps) then
        h = grid%last
        end = run%stop
      end if
      run%attempts = run%attempts + 1
      call find_stages(field, frame, run, h, failure)
      if (failure%status /= finished) return
      reached = run%point
      call compose(frame, run, run%rows(size(run%c) + 1), h, reached)
      if (.not. finite(reached)) then
        failure = failure_t(status=solution_not_finite, t=end)
        return
      end if
      call accept(field, frame, run, end, reached, output, failure)
      if (failure%status /= finished) return
    end do
    if (grid%pause < grid%steps) failure%status = paused
  end subroutine integrate_on_grid

  ! One trial step; the error is huge if there is no estimate.
  subroutine attempt(field, frame, run, h, reached, error, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    real(wp), intent(in) :: h
    real(wp), contiguous, intent(out) :: reached(:)    ! (point_size)
    real(wp), intent(out) :: error
    type(failure_t), intent(inout) :: failure
    real(wp) :: other(frame%point_size), v(frame%dimension)
    integer :: stages

    stages = size(run%c)
    error = huge(error)
    reached = run%point
    call find_stages(field, frame, run, h, failure)
    if (failure%status /= finished) return
    call compose(frame, run, run%rows(stages + 1), h, reached)
    other = run%point
    call compose(frame, run, run%rows(stages + 2), h, other)
    if (.not. (finite(reached) .and. finite(other))) return
    call difference(frame, other, reached, v)
    error = rms(v / tolerances(frame, run, run%point, reached))
    if (.not. error < huge(error)) error = huge(error)
  end subroutine attempt

  subroutine find_stages(field, frame, run, h, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    real(wp), intent(in) :: h
    type(failure_t), intent(inout) :: failure
    real(wp) :: stage(frame%point_size)
    integer :: i

    call find_field(field, run, failure)
    do i = 2, size(run%c)
      if (failure%status /= finished) return
      stage = run%point
      call compose(frame, run, run%rows(i), h, stage)
      call evaluate(field, run%t + run%c(i) * h, stage, run%f(:, i), failure)
      run%nfev = run%nfev + 1
    end do
  end subroutine find_stages

  ! The coefficients at the beginning of the step, which a rejected step leaves known
  subroutine find_field(field, run, failure)
    class(vector_field_t), intent(inout) :: field
    type(run_t), intent(inout) :: run
    type(failure_t), intent(inout) :: failure

    if (run%known) return
    call evaluate(field, run%t, run%point, run%f(:, 1), failure)
    run%nfev = run%nfev + 1
    run%known = failure%status == finished
  end subroutine find_field

  subroutine compose(frame, run, row, h, y)
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    type(row_t), intent(in) :: row
    real(wp), intent(in) :: h
    real(wp), contiguous, intent(inout) :: y(:)        ! (point_size)

    if (size(row%weight) == 0) return
    call move(frame, h * row%weight, row%stage, run%f, y)
    call restore(frame, y)
    run%nexp = run%nexp + size(row%weight)
  end subroutine compose

  ! Goes to the end of a step, by way of the times in it at which the solution is wanted.
  subroutine accept(field, frame, run, end, reached, output, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    real(wp), intent(in) :: end
    real(wp), contiguous, intent(in) :: reached(:)     ! (point_size)
    type(output_t), intent(inout) :: output
    type(failure_t), intent(inout) :: failure
    real(wp) :: before(frame%point_size), slope(frame%dimension), t
    integer :: first, last

    t = run%t
    before = run%point
    slope = run%f(:, 1)
    run%accepted = run%accepted + 1
    if (output%keep) then
      output%t(run%accepted) = end
      output%y(:, run%accepted) = reached
      output%f(:, run%accepted) = slope
    end if
    run%t = end
    run%point = reached
    run%known = .false.
    first = output%used + 1
    do last = output%used, size(output%wanted) - 1
      if ((output%wanted(last + 1) - end) * sign(1.0_wp, end - t) > 0) exit
    end do
    output%used = last
    if (last < first) return
    if (last == first .and. .not. abs(output%wanted(last) - end) > 0) then
      output%y_wanted(:, last) = reached
      return
    end if
    call find_field(field, run, failure)
    if (failure%status /= finished) return
    call interpolate(field, frame, run, t, before, slope, output%wanted(first:last), &
                     output%y_wanted(:, first:last), failure)
  end subroutine accept

  ! Points between the ends of a step, as in cg/integration/dense.py
  subroutine interpolate(field, frame, run, t, before, slope, times, y, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run                  ! at the end of the step
    real(wp), intent(in) :: t                          ! its beginning
    real(wp), contiguous, intent(in) :: before(:)      ! (point_size)
    real(wp), contiguous, intent(in) :: slope(:)       ! (dimension)
    real(wp), contiguous, intent(in) :: times(:)       ! (n)
    real(wp), contiguous, intent(inout) :: y(:, :)     ! (point_size, n)
    type(failure_t), intent(inout) :: failure
    integer, parameter :: two(2) = [1, 2]
    real(wp) :: forth(frame%dimension, 2), back(frame%dimension, 2), v(frame%dimension, 1)
    real(wp) :: right(frame%point_size), s, h
    type(run_t) :: again
    logical :: bent
    integer :: i

    h = run%t - t
    forth(:, 1) = h * slope
    back(:, 1) = -h * run%f(:, 1)
    call bend(frame, before, run%point, forth)
    call bend(frame, run%point, before, back)
    run%nexp = run%nexp + 2
    bent = finite(forth(:, 2)) .and. finite(back(:, 2))
    do i = 1, size(times)
      if (.not. abs(times(i) - run%t) > 0) then
        y(:, i) = run%point
        cycle
      end if
      s = (times(i) - t) / h
      y(:, i) = before
      if (bent) then
        call move(frame, [s, s**2], two, forth, y(:, i))
        right = run%point
        call move(frame, [1 - s, (1 - s)**2], two, back, right)
        call difference(frame, y(:, i), right, v(:, 1))
        run%nexp = run%nexp + 5
        if (finite(v(:, 1))) then
          call move(frame, [s], [1], v, y(:, i))
          call restore(frame, y(:, i))
          cycle
        end if
        y(:, i) = before
      end if
      again = run
      again%t = t
      again%point = before
      again%f(:, 1) = slope
      again%known = .true.
      call find_stages(field, frame, again, s * h, failure)
      call compose(frame, again, again%rows(size(again%c) + 1), s * h, y(:, i))
      run%nfev = again%nfev
      run%nexp = again%nexp
      if (failure%status /= finished) return
    end do
  end subroutine interpolate

  ! What is left to y1 after the flow of path(:, 1) from y0
  subroutine bend(frame, y0, y1, path)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y0(:), y1(:)   ! (point_size)
    real(wp), contiguous, intent(inout) :: path(:, :)  ! (dimension, 2)
    real(wp) :: y(frame%point_size)

    y = y0
    call move(frame, [1.0_wp], [1], path, y)
    call restore(frame, y)
    call difference(frame, y, y1, path(:, 2))
  end subroutine bend

  subroutine choose_first_step(field, frame, run, failure)
    class(vector_field_t), intent(inout) :: field
    type(frame_t), intent(in) :: frame
    type(run_t), intent(inout) :: run
    type(failure_t), intent(inout) :: failure
    real(wp), dimension(frame%dimension) :: tolerance, relative_to, next
    real(wp) :: moved(frame%point_size), span, size, slope, curvature, rate, guess, better, smallest

    call find_field(field, run, failure)
    if (failure%status /= finished) return
    span = abs(run%stop - run%t)
    tolerance = tolerances(frame, run, run%point, run%point)
    call sizes(frame, run%point, relative_to)
    size = rms(relative_to / tolerance)
    slope = rms(run%f(:, 1) / tolerance)
    if (.not. slope <= huge(slope)) then
      failure = failure_t(status=slope_not_finite, t=run%t)
      return
    end if
    guess = blind_fraction * span
    if (size > nothing .and. slope * span > nothing) guess = 0.01_wp * size / slope
    smallest = min(spacing_at(run%t), span)
    guess = max(min(guess, span, run%max_step), smallest)
    moved = run%point
    call move(frame, [sign(guess, run%stop - run%t)], [1], run%f, moved)
    call restore(frame, moved)
    run%nexp = run%nexp + 1
    call evaluate(field, run%t + sign(guess, run%stop - run%t), moved, next, failure)
    run%nfev = run%nfev + 1
    if (failure%status == stage_not_finite) then
      failure = failure_t()
      run%size = guess
      return
    end if
    if (failure%status /= finished) return
    curvature = rms((next - run%f(:, 1)) / tolerance) / guess
    better = huge(better)
    if (slope > 0) then
      rate = curvature / slope
      if (size > 0) rate = max(rate, slope / size)
      if (rate > 0) better = (first_error * rate / slope)**run%exponent / rate
    else if (curvature > 0) then
      better = sqrt(first_error / curvature)
    end if
    run%size = max(min(100 * guess, better, span, run%max_step), smallest)
  end subroutine choose_first_step

  ! The tolerances at the larger of two points, all positive
  pure function tolerances(frame, run, x, y)
    type(frame_t), intent(in) :: frame
    type(run_t), intent(in) :: run
    real(wp), contiguous, intent(in) :: x(:), y(:)     ! (point_size)
    real(wp) :: tolerances(frame%dimension)
    real(wp) :: other(frame%dimension)

    call sizes(frame, x, tolerances)
    call sizes(frame, y, other)
    tolerances = max(run%atol + run%rtol * max(tolerances, other), tiny(1.0_wp))
  end function tolerances

  pure real(wp) function rms(v)
    real(wp), intent(in) :: v(:)

    rms = sqrt(sum(v**2) / real(size(v), wp))
  end function rms

  ! The intrinsic function spacing has a larger value at numbers near zero.
  pure real(wp) function spacing_at(t)
    real(wp), intent(in) :: t

    spacing_at = nearest(abs(t), 1.0_wp) - abs(t)
  end function spacing_at

end module adaptive
