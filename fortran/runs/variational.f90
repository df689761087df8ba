! The right-hand side of a solution together with its derivatives X, as VariationalEquation in
! cg/integration/derivatives/variational_equation.py has it, which evaluates the same in Python for
! functions of many members: X' = A X + (0, df/dp, C A^T + Q), A xi = df/dy xi + [f, xi].
!
! Along chosen directions X has a column for each, to which df/dp adds by the part of the direction
! in parameters. Then a column costs one difference of f, along itself. The functions are in C.
module variational_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_pointer, c_f_procpointer, c_int, c_int64_t, &
                                         c_intptr_t, c_null_funptr, c_null_ptr, c_ptr
  use free_motion_m, only: complete_forces
  use coordinates_m, only: coordinate_sizes
  use derivatives_m, only: coefficients_of
  use frames_m, only: apply_flows
  use kinds, only: wp
  use run_m, only: plan_at, plan_t
  use shared_numbers, only: df_dp_failed, f_failed, jac_failed, max_length_ratio, no_stop, &
                            noise_failed, products_failed, raised, raised_in_python, variation_t
  use inputs_m, only: rhs_i
  use vectors_m, only: finite, nan
  implicit none
  private
  public :: variational_rhs

  ! One evaluation of a right-hand side with derivatives
  type :: evaluation_t
    type(variation_t), pointer :: record => null()
    type(plan_t), pointer :: plan => null()            ! with a frame, and no method
    type(c_ptr) :: parameters = c_null_ptr             ! parameters of a member
    real(wp) :: t = 0.0_wp
    integer(c_int) :: code = 0                         ! what the last function returned
  end type evaluation_t

contains

  ! A function of the type rhs_i. The data are the parameters and inputs of a member; the eight
  ! bytes before them are the address of the record.
  function variational_rhs(t, y, f, user_data) bind(c) result(code)
    real(c_double), value, intent(in) :: t
    real(c_double), intent(in) :: y(*)
    real(c_double), intent(inout) :: f(*)
    type(c_ptr), value, intent(in) :: user_data
    integer(c_int) :: code
    type(evaluation_t) :: self
    integer :: columns
    integer(c_intptr_t), pointer :: address

    call c_f_pointer(transfer(transfer(user_data, 0_c_intptr_t) - 8, c_null_ptr), address)
    call c_f_pointer(transfer(address, c_null_ptr), self%record)
    self = evaluation_t(self%record, plan_at(self%record%frame), user_data, t)
    associate (record => self%record, n => int(self%record%dimension))
      columns = n + int(record%parameters + record%noises)
      if (record%directions > 0) columns = int(record%directions)
      call evaluate_with_derivatives(self, n, columns, y, y(record%width + 1), f, f(n + 1))
    end associate
    code = self%code
  end function variational_rhs

  ! Evaluates f and X'. Matrices are stored row by row, so that columns here are their rows. What
  ! isn't given is found by differences, along directions by those along each.
  subroutine evaluate_with_derivatives(self, n, columns, y, x, f, slope)
    type(evaluation_t), intent(inout) :: self
    integer, intent(in) :: n, columns                  ! dimension, and columns of X
    real(wp), intent(in) :: y(self%record%width), x(columns, n)
    real(wp), intent(inout) :: f(n), slope(columns, n)
    real(wp) :: a(n, n), d(self%record%parameters, n)  ! A, df/dp
    real(wp) :: changes(columns, n)                    ! differences along directions, in Python
    real(wp), pointer, contiguous :: p(:, :)           ! (parameters, columns) of directions
    logical :: given(2)                                ! whether df/dy and df/dp are

    f = nan
    if (.not. (finite(size(y), y) .and. finite(size(x), x))) return
    associate (record => self%record, k => size(d, 1), first => n + size(d, 1) + 1, &
               along => self%record%directions > 0)
      call call_f(self, y, f)
      record%failed_function = f_failed
      if (self%code /= 0 .or. .not. finite(n, f)) return
      given = [record%jac /= 0, record%df_dp /= 0]
      a = 0.0_wp
      d = 0.0_wp
      if (given(1)) call call_checked(self, record%jac, record%jac_data, y, jac_failed, a)
      if (given(2) .and. self%code == 0) &
        call call_checked(self, record%df_dp, record%df_dp_data, y, df_dp_failed, d)
      if (.not. along .and. self%code == 0) call add_differences(self, given, y, f, a, d)
      if (self%code /= 0) return
      call add_bracket_matrix(record, n, f, a)
      slope = matmul(x, a)
      if (along) then
        call c_f_pointer(transfer(record%by_parameters, c_null_ptr), p, [k, columns])
        if (given(2)) slope = slope + matmul(transpose(p), d)
        if (record%along /= 0) then
          call call_checked(self, record%along, record%along_data, [y, x], f_failed, changes)
          slope = slope + changes
        else
          call add_along_directions(self, given, y, f, x, p, slope)
        end if
      else
        slope(n + 1:n + k, :) = slope(n + 1:n + k, :) + d
      end if
      if (self%code == 0 .and. record%noises > 0) &
        call add_noise(self, y, a, x(first:, :), slope(first:, :))
      if (self%code /= 0) return
      if (any(int(record%failed_function) == [df_dp_failed, noise_failed])) return
      if (finite(n, f) .and. finite(size(a), a) .and. .not. finite(size(slope), slope)) &
        record%failed_function = products_failed
    end associate
  end subroutine evaluate_with_derivatives

  ! Adds differences of f(i) along field j to a(j, i), by parameter j to d(j, i), unless given.
  subroutine add_differences(self, given, y, f, a, d)
    type(evaluation_t), intent(inout) :: self
    logical, intent(in) :: given(2)
    real(wp), contiguous, intent(in) :: y(:), f(:)
    real(wp), intent(inout) :: a(:, :), d(:, :)
    real(wp) :: lengths(size(f) + size(d, 1)), unit(size(lengths))
    integer :: j

    lengths = self%record%step * difference_sizes(self, given, y, size(f), size(d, 1))
    unit = 0.0_wp
    associate (n => size(f), forces => self%plan%frame%forces)
      do j = merge(n + 1, 1, given(1)), merge(n, size(unit), given(2))
        if (self%record%forces_alone .and. j > forces .and. j <= n) cycle
        unit(j) = 1.0_wp
        if (j <= n) call add_difference(self, y, f, lengths(j), unit(:n), unit(:0), a(j, :))
        if (j > n) call add_difference(self, y, f, lengths(j), unit(:0), unit(n + 1:), d(j - n, :))
        if (self%code /= 0) return
        unit(j) = 0.0_wp
      end do
    end associate
  end subroutine add_differences

  ! Adds differences of f along each direction: along the fields and by parameters at once, unless
  ! one part is so much smaller than the other that it would be lost.
  subroutine add_along_directions(self, given, y, f, x, p, slope)
    type(evaluation_t), intent(inout) :: self
    logical, intent(in) :: given(2)
    real(wp), contiguous, intent(in) :: y(:), f(:), x(:, :), p(:, :)
    real(wp), intent(inout) :: slope(:, :)             ! (columns, dimension)
    real(wp) :: lengths(2), sizes(size(f) + size(p, 1))
    integer :: j

    sizes = difference_sizes(self, given, y, size(f), size(p, 1))
    associate (step => self%record%step, n => size(f))
      do j = 1, size(slope, 1)
        lengths = [maxval(abs(x(j, :)) / sizes(:n)), maxval([0.0_wp, abs(p(:, j)) / sizes(n + 1:)])]
        where (given) lengths = 0.0_wp
        if (minval(lengths) * max_length_ratio > maxval(lengths)) then
          call add_difference(self, y, f, step / maxval(lengths), x(j, :), p(:, j), slope(j, :))
        else
          if (lengths(1) > 0) &
            call add_difference(self, y, f, step / lengths(1), x(j, :), p(:0, j), slope(j, :))
          if (lengths(2) > 0 .and. self%code == 0) &
            call add_difference(self, y, f, step / lengths(2), x(j, :0), p(:, j), slope(j, :))
        end if
        if (self%code /= 0) return
      end do
    end associate
  end subroutine add_along_directions

  ! The sizes of coordinates and of parameters for differences
  function difference_sizes(self, given, y, n, k) result(sizes)
    type(evaluation_t), intent(in) :: self
    logical, intent(in) :: given(2)          ! without df/dy, sizes of coordinates are needed
    real(wp), contiguous, intent(in) :: y(:)
    integer, intent(in) :: n, k
    real(wp) :: sizes(n + k)
    real(wp), pointer, contiguous :: parameters(:), min_sizes(:)

    sizes(:n) = 1.0_wp
    if (.not. given(1)) call coordinate_sizes(self%plan%frame, y, sizes(:n))
    sizes(:n) = max(sizes(:n), 1.0_wp)
    call c_f_pointer(self%parameters, parameters, [k])
    call c_f_pointer(transfer(self%record%scales, c_null_ptr), min_sizes, [k])
    sizes(n + 1:) = max(abs(parameters), min_sizes)
    where (.not. sizes > sqrt(tiny(1.0_wp))) sizes = 1.0_wp
  end function difference_sizes

  ! Adds the difference of f along v or by a change of parameters: a central one, or from f at the
  ! point. Parameters are changed in place, since functions of Python hold a view of them.
  subroutine add_difference(self, y, f, step, v, change, row)
    type(evaluation_t), intent(inout) :: self
    real(wp), contiguous, intent(in) :: y(:), f(:), v(:), change(:)
    real(wp), intent(in) :: step
    real(wp), intent(inout) :: row(:)                  ! (dimension)
    real(wp), pointer, contiguous :: parameters(:)
    real(wp) :: point(size(y)), before(size(change)), ahead
    real(wp) :: values(size(f), 2)                     ! ahead and behind
    integer :: side, sides

    call c_f_pointer(self%parameters, parameters, [size(change)])
    before = parameters
    sides = merge(1, 2, self%record%one_sided)
    values(:, 2) = f
    do side = 1, sides
      ahead = merge(step, -step, side == 1)
      point = y
      if (size(v) > 0) call apply_flows(self%plan%frame, 1, ahead * v, point)
      parameters = before + ahead * change
      values(:, side) = nan
      call call_f(self, point, values(:, side))
      parameters = before
      if (self%code /= 0) return
    end do
    row = row + (values(:, 1) - values(:, 2)) / (real(sides, wp) * step)
  end subroutine add_difference

  ! Adds C A^T + Q, where c(:, i) is row i of C.
  subroutine add_noise(self, y, a, c, slope)
    type(evaluation_t), intent(inout) :: self
    real(wp), intent(in) :: y(:), a(:, :), c(:, :)
    real(wp), intent(inout) :: slope(:, :)
    real(wp), pointer, contiguous :: constant(:, :)
    real(wp) :: q(size(a, 1), size(a, 1))

    if (self%record%noise == 0) then
      call c_f_pointer(transfer(self%record%noise_data, c_null_ptr), constant, shape(q))
      q = constant
    else
      call call_checked(self, self%record%noise, self%record%noise_data, y, noise_failed, q)
    end if
    slope = slope + matmul(transpose(a), c) + q
  end subroutine add_noise

  ! Calls a function other than f and records whether it fails.
  subroutine call_checked(self, address, own_data, y, failure, values)
    type(evaluation_t), intent(inout) :: self
    integer(c_intptr_t), intent(in) :: address, own_data
    real(wp), intent(in) :: y(:)
    integer, intent(in) :: failure                     ! a FailedFunction
    real(wp), contiguous, intent(out) :: values(:, :)

    values = nan
    call call_function(self, address, own_data, y, values)
    if (self%code /= 0 .or. .not. finite(size(values), values)) &
      self%record%failed_function = int(failure, c_int64_t)
  end subroutine call_checked

  ! Calls f, and completes what it gives to coefficients.
  subroutine call_f(self, y, f)
    type(evaluation_t), intent(inout) :: self
    real(wp), contiguous, intent(in) :: y(:)
    real(wp), contiguous, intent(inout) :: f(:)        ! (dimension)
    real(wp) :: slope(merge(size(y), 0, self%plan%frame%derivatives))
    integer :: status

    associate (record => self%record, frame => self%plan%frame)
      if (frame%derivatives) then
        slope = nan
        call call_function(self, record%f, record%f_data, y, slope)
        if (self%code == 0) call coefficients_of(frame, self%t, y, slope, f)
        return
      end if
      call call_function(self, record%f, record%f_data, y, f)
      if (self%code /= 0 .or. frame%forces == 0) return
      call complete_forces(frame, y, logical(record%forces_alone), &
                           .not. logical(record%forces_alone), f, status)
      if (status == raised) self%code = raised_in_python
      if (status /= no_stop) f = nan
    end associate
  end subroutine call_f

  ! Calls a function, which may write into the point that it is given. Its data are its own, or
  ! the parameters of the member, or those of f.
  subroutine call_function(self, address, own_data, y, values)
    type(evaluation_t), intent(inout) :: self
    integer(c_intptr_t), intent(in) :: address, own_data
    real(wp), intent(in) :: y(:)
    real(wp), intent(inout) :: values(*)
    procedure(rhs_i), pointer :: rhs
    real(wp) :: point(size(y))
    type(c_ptr) :: data

    data = transfer(merge(own_data, self%record%data, own_data /= 0), data)
    if (own_data == 0 .and. self%record%parameters + self%record%inputs > 0) data = self%parameters
    point = y
    call c_f_procpointer(transfer(address, c_null_funptr), rhs)
    self%code = rhs(self%t, point, values, data)
  end subroutine call_function

  ! Adds the matrix of brackets xi -> [f, xi], by structure constants.
  subroutine add_bracket_matrix(record, n, f, a)
    type(variation_t), intent(in) :: record
    integer, intent(in) :: n
    real(wp), intent(in) :: f(n)
    real(wp), intent(inout) :: a(n, n)
    integer, pointer, contiguous :: index(:, :)        ! (3, constants) i, j, k
    real(wp), pointer, contiguous :: constant(:)       ! (constants)
    integer :: c, count

    count = int(record%constants)
    call c_f_pointer(transfer(record%index, c_null_ptr), index, [3, count])
    call c_f_pointer(transfer(record%constant, c_null_ptr), constant, [count])
    do c = 1, count
      a(index(2, c), index(3, c)) = a(index(2, c), index(3, c)) + constant(c) * f(index(1, c))
    end do
  end subroutine add_bracket_matrix

end module variational_m
