! Right-hand sides with their inputs, and grids of times. Right-hand sides are functions in C,
!   int rhs(double t, const double *y, double *f, void *user_data)
! which give the coefficients f of the field sum_i f_i(t, y) E_i(y) at one point. Inputs of compiled
! ones, values of piecewise polynomials, are written behind the parameters of a member. Times of
! equal steps are those of a grid, whose last step may be shorter.
module inputs_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_pointer, c_int, c_intptr_t, c_null_ptr, c_ptr
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  use shared_numbers, only: input_record_t
  use vectors_m, only: nan
  implicit none
  private
  public :: call_python_rhs, data_at, evaluate_rhs, grid_t, make_grid, max_step_at, &
            member_data_t, rhs_i, rhs_t

  type :: grid_t
    real(wp) :: start = 0.0_wp, step = 0.0_wp          ! step: negative to go backward
    real(wp) :: last = 0.0_wp, stop = 0.0_wp           ! last: size of the last step
    integer(int64) :: steps = 0, done = 0              ! done: those that have been taken
  end type grid_t

  ! The data of members, which functions in C get
  type :: member_data_t
    integer(c_intptr_t) :: address = 0       ! address of the first member's data, 0 for none
    integer(c_intptr_t) :: stride = 0        ! bytes from one member's to the next
    type(input_record_t), pointer, contiguous :: inputs(:) => null()   ! are written into the data
  end type member_data_t

  abstract interface
    function rhs_i(t, y, f, user_data) bind(c) result(code)
      import :: c_double, c_int, c_ptr
      real(c_double), value, intent(in) :: t
      real(c_double), intent(in) :: y(*)
      real(c_double), intent(inout) :: f(*)
      type(c_ptr), value, intent(in) :: user_data
      integer(c_int) :: code
    end function rhs_i
  end interface

  procedure(rhs_i), bind(c) :: call_python_rhs         ! in python_rhs.c: functions of Python

  type :: rhs_t
    procedure(rhs_i), pointer, nopass :: function => null()
    integer :: member = 1                    ! the member that the point belongs to
    type(member_data_t) :: data
  end type rhs_t

contains

  ! Makes the grid. If h divides the span up to the rounding of its ends and of h, all steps are
  ! equal; otherwise the last one is the rest of the span. Each end carries half a unit of its
  ! rounding, the span from which an end was computed another, and each step half a unit of h.
  pure subroutine make_grid(start, stop, h, grid)
    real(wp), intent(in) :: start, stop, h               ! h: positive
    type(grid_t), intent(out) :: grid
    real(wp) :: span, slack, ratio, count

    grid%start = start
    grid%stop = stop
    grid%step = sign(h, stop - start)
    grid%last = grid%step
    span = abs(stop - start)
    if (.not. span > 0) return
    ratio = span / h
    slack = max(unit(max(abs(start), abs(stop))), unit(span)) + ratio * unit(h) / 2
    count = max(anint(ratio), 1.0_wp)
    if (abs(span - count * h) > slack) then
      count = aint(ratio) + merge(1.0_wp, 0.0_wp, aint(ratio) < ratio)
      grid%last = sign(span - (count - 1) * h, stop - start)
    end if
    grid%steps = int(count, int64)
  end subroutine make_grid

  ! The distance to the next number
  pure real(wp) function unit(x)
    real(wp), intent(in) :: x

    unit = nearest(x, 1.0_wp) - x
  end function unit

  ! The address of the data of a member, into which inputs at a time have been written
  integer(c_intptr_t) function data_at(self, t, member) result(data)
    type(member_data_t), intent(in) :: self
    real(wp), intent(in) :: t
    integer, intent(in) :: member            ! from 1

    data = self%address + int(member - 1, c_intptr_t) * self%stride
    if (associated(self%inputs)) call write_inputs(self, t, member, data)
  end function data_at

  ! Writes inputs at a time into the data of a member. It is apart so that data_at is inlined.
  subroutine write_inputs(self, t, member, data)
    type(member_data_t), intent(in) :: self
    real(wp), intent(in) :: t
    integer, intent(in) :: member            ! from 1
    integer(c_intptr_t), intent(in) :: data
    real(wp), pointer, contiguous :: starts(:), coefficients(:, :, :), values(:)
    real(wp) :: s
    integer :: i, j, k, piece

    do i = 1, size(self%inputs)
      associate (input => self%inputs(i))
        call c_f_pointer(transfer(input%starts, c_null_ptr), starts, [input%pieces])
        call c_f_pointer( &
          transfer(input%coefficients + int(member - 1, c_intptr_t) * input%stride, c_null_ptr), &
          coefficients, [input%width, input%pieces, input%powers])
        call c_f_pointer(transfer(data + 8 * input%offset, c_null_ptr), values, [input%width])
        piece = last_before(starts, t)
        s = t - starts(piece)
        do j = 1, int(input%width)           ! whole arrays, pointers, would be copied
          values(j) = coefficients(j, piece, int(input%powers))
          do k = int(input%powers) - 1, 1, -1
            values(j) = coefficients(j, piece, k) + s * values(j)
          end do
        end do
      end associate
    end do
  end subroutine write_inputs

  ! The last of increasing times that isn't after t, the first one if all are
  pure integer function last_before(times, t) result(low)
    real(wp), intent(in) :: times(:), t
    integer :: high, middle

    low = 1
    high = size(times) + 1
    do while (high - low > 1)
      middle = (low + high) / 2
      if (times(middle) <= t) then
        low = middle
      else
        high = middle
      end if
    end do
  end function last_before

  ! The longest step in a direction that ends, at latest, where steps must be shorter than it
  pure real(wp) function max_step_at(limits, t, direction)
    real(wp), intent(in) :: limits(:, :)     ! (2, n) a time t, and the largest step from t on
    real(wp), intent(in) :: t, direction
    real(wp) :: ahead                        ! to the end of the times of the same limit
    integer :: i, next

    max_step_at = huge(max_step_at)
    if (size(limits, 2) == 0) return
    associate (begins => limits(1, :), largest => limits(2, :))
      i = last_before(begins, t)
      if (direction < 0 .and. i > 1 .and. .not. begins(i) < t) i = i - 1
      max_step_at = largest(i)
      do
        next = i + merge(1, -1, direction > 0)
        if (next < 1 .or. next > size(begins)) return
        ahead = abs(begins(max(i, next)) - t)
        if (ahead >= max_step_at) return
        max_step_at = min(max_step_at, max(largest(next), ahead))
        i = next
      end do
    end associate
  end function max_step_at

  ! Evaluates a right-hand side. What it doesn't write is NaN. Shapes are explicit, for speed.
  subroutine evaluate_rhs(self, n, m, t, y, f, code)
    type(rhs_t), intent(in) :: self
    integer, intent(in) :: n, m                    ! point_size, dimension
    real(wp), intent(in) :: t, y(n)
    real(wp), intent(out) :: f(m)
    integer, intent(out) :: code                   ! nonzero stops the integration

    f = nan
    code = self%function(t, y, f, transfer(data_at(self%data, t, self%member), c_null_ptr))
  end subroutine evaluate_rhs

end module inputs_m
