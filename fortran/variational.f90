! A solution and its derivatives X = (transition, sensitivity) as one right-hand side of functions in C:
!
!   X' = A X + (0, df/dp),   A xi = df/dy xi + [f, xi],
!
! with df/dy along the frame's fields. In Python it is cg/integration/variational/field.py.
module variational_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_pointer, c_int, c_int64_t, c_intptr_t, &
                                         c_null_ptr, c_ptr
  use coordinates_m, only: sizes
  use external_field_m, only: field_at, rhs_i
  use frames_m, only: flow_along
  use kinds, only: wp
  use run_m, only: plan_at, plan_t
  use shared_numbers, only: variation_t
  implicit none
  private
  public :: variational_field

contains

  ! The data are the parameters of a member; the number before them is the address of the record.
  function variational_field(t, y, f, user_data) bind(c) result(code)
    real(c_double), value, intent(in) :: t
    real(c_double), intent(in) :: y(*)
    real(c_double), intent(inout) :: f(*)
    type(c_ptr), value, intent(in) :: user_data
    integer(c_int) :: code
    type(variation_t), pointer :: record
    integer(c_intptr_t), pointer :: address

    call c_f_pointer(transfer(transfer(user_data, 0_c_intptr_t) - 8, c_null_ptr), address)
    call c_f_pointer(transfer(address, c_null_ptr), record)
    associate (n => int(record%dimension), k => int(record%parameters), width => int(record%width))
      call evaluate(record, user_data, n, k, width, t, y, y(width + 1), f, f(n + 1), code)
    end associate
  end function variational_field

  ! Matrices are stored row by row, so that here their columns are their rows.
  subroutine evaluate(record, parameters, n, k, width, t, y, x, f, slope, code)
    type(variation_t), intent(inout) :: record
    type(c_ptr), intent(in) :: parameters
    integer, intent(in) :: n, k, width
    real(wp), intent(in) :: t, y(width)
    real(wp), intent(in) :: x(n + k, n)
    real(wp), intent(inout) :: f(n), slope(n + k, n)
    integer(c_int), intent(out) :: code
    procedure(rhs_i), pointer :: field, function
    real(wp) :: a(n, n)
    integer :: i, j

    code = 0
    f = record%nan
    if (.not. (finite(width, y) .and. finite((n + k) * n, x))) return
    field => field_at(record%f)
    code = call_at(field, data_of(record, record%f_data, parameters), t, width, y, f)
    record%failed = 0
    if (code /= 0) return
    if (record%jac == 0) then
      call differences_along_fields(record, parameters, field, n, width, t, y, a, code)
    else
      a = record%nan
      function => field_at(record%jac)
      code = call_at(function, data_of(record, record%jac_data, parameters), t, width, y, a)
      call note_failure(record, 1, n * n, code, a)
    end if
    if (code /= 0) return
    call add_brackets(record, n, f, a)
    do i = 1, n
      slope(:, i) = a(1, i) * x(:, 1)
      do j = 2, n
        slope(:, i) = slope(:, i) + a(j, i) * x(:, j)
      end do
    end do
    if (k > 0) then
      call add_parameters(record, parameters, field, n, k, width, t, y, slope, code)
    end if
    if (code == 0 .and. finite(n, f) .and. finite(n * n, a)) then
      if (record%failed /= 2 .and. .not. finite((n + k) * n, slope)) record%failed = 3
    end if
  end subroutine evaluate

  subroutine add_parameters(record, parameters, field, n, k, width, t, y, slope, code)
    type(variation_t), intent(inout) :: record
    type(c_ptr), intent(in) :: parameters
    procedure(rhs_i), pointer, intent(in) :: field
    integer, intent(in) :: n, k, width
    real(wp), intent(in) :: t, y(width)
    real(wp), intent(inout) :: slope(n + k, n)
    integer(c_int), intent(out) :: code
    procedure(rhs_i), pointer :: function
    real(wp) :: d(k, n)

    if (record%df_dp == 0) then
      call differences_of_parameters(record, parameters, field, n, k, width, t, y, d, code)
    else
      d = record%nan
      function => field_at(record%df_dp)
      code = call_at(function, data_of(record, record%df_dp_data, parameters), t, width, y, d)
      call note_failure(record, 2, n * k, code, d)
    end if
    slope(n + 1:, :) = slope(n + 1:, :) + d
  end subroutine add_parameters

  ! Tells, for a message, which function failed.
  subroutine note_failure(record, which, numbers, code, values)
    type(variation_t), intent(inout) :: record
    integer, intent(in) :: which, numbers
    integer(c_int), intent(in) :: code
    real(wp), intent(in) :: values(numbers)

    if (code /= 0 .or. .not. finite(numbers, values)) record%failed = int(which, c_int64_t)
  end subroutine note_failure

  pure logical function finite(numbers, x)
    integer, intent(in) :: numbers
    real(wp), intent(in) :: x(numbers)

    finite = all(abs(x) <= huge(1.0_wp))
  end function finite

  ! Functions may write into the point that they are given.
  integer(c_int) function call_at(function, data, t, width, y, f) result(code)
    procedure(rhs_i), pointer, intent(in) :: function
    type(c_ptr), intent(in) :: data
    integer, intent(in) :: width
    real(wp), intent(in) :: t, y(width)
    real(wp), intent(inout) :: f(*)
    real(wp) :: point(width)

    point = y
    code = function(t, point, f, data)
  end function call_at

  ! A function has data of its own, or the parameters of the member, or those of f.
  type(c_ptr) function data_of(record, own, parameters) result(data)
    type(variation_t), intent(in) :: record
    integer(c_intptr_t), intent(in) :: own
    type(c_ptr), intent(in) :: parameters

    data = transfer(merge(own, record%data, own /= 0), data)
    if (own == 0 .and. record%parameters > 0) data = parameters
  end function data_of

  ! a(j, i) is the derivative of f(i) along field j.
  subroutine differences_along_fields(record, parameters, field, n, width, t, y, a, code)
    type(variation_t), intent(in) :: record
    type(c_ptr), intent(in) :: parameters
    procedure(rhs_i), pointer, intent(in) :: field
    integer, intent(in) :: n, width
    real(wp), intent(in) :: t, y(width)
    real(wp), intent(out) :: a(n, n)
    integer(c_int), intent(out) :: code
    type(plan_t), pointer :: plan
    type(c_ptr) :: data
    real(wp) :: size_of(n), v(n), point(width), ahead(n), behind(n)
    integer :: j

    plan => plan_at(record%frame)
    data = data_of(record, record%f_data, parameters)
    code = 0
    a = 0.0_wp
    call sizes(plan%frame, y, size_of)
    size_of = record%step * max(size_of, 1.0_wp)
    do j = 1, n
      v = 0.0_wp
      v(j) = size_of(j)
      point = y
      call flow_along(plan%frame, v, point)
      ahead = record%nan
      code = call_at(field, data, t, width, point, ahead)
      if (code /= 0) return
      point = y
      v(j) = -size_of(j)
      call flow_along(plan%frame, v, point)
      behind = record%nan
      code = call_at(field, data, t, width, point, behind)
      if (code /= 0) return
      a(j, :) = (ahead - behind) / (2 * size_of(j))
    end do
  end subroutine differences_along_fields

  ! d(j, i) is the derivative of f(i) by parameter j. Parameters are moved where they are, since functions
  ! of Python know them by their place.
  subroutine differences_of_parameters(record, parameters, field, n, k, width, t, y, d, code)
    type(variation_t), intent(in) :: record
    type(c_ptr), intent(in) :: parameters
    procedure(rhs_i), pointer, intent(in) :: field
    integer, intent(in) :: n, k, width
    real(wp), intent(in) :: t, y(width)
    real(wp), intent(out) :: d(k, n)
    integer(c_int), intent(out) :: code
    real(wp), pointer, contiguous :: given(:)
    type(c_ptr) :: data
    real(wp) :: ahead(n), behind(n), step, before
    integer :: j

    call c_f_pointer(parameters, given, [k])
    data = data_of(record, record%f_data, parameters)
    d = 0.0_wp
    do j = 1, k
      before = given(j)
      step = record%step * merge(abs(before), 1.0_wp, abs(before) > 0)
      ahead = record%nan
      behind = record%nan
      given(j) = before + step
      code = call_at(field, data, t, width, y, ahead)
      given(j) = before - step
      if (code == 0) code = call_at(field, data, t, width, y, behind)
      given(j) = before
      if (code /= 0) return
      d(j, :) = (ahead - behind) / (2 * step)
    end do
  end subroutine differences_of_parameters

  ! Adds the matrix of brackets with f.
  subroutine add_brackets(record, n, f, a)
    type(variation_t), intent(in) :: record
    integer, intent(in) :: n
    real(wp), intent(in) :: f(n)
    real(wp), intent(inout) :: a(n, n)
    integer, pointer, contiguous :: index(:, :)        ! (3, constants)
    real(wp), pointer, contiguous :: constant(:)       ! (constants)
    integer :: c, count

    count = int(record%constants)
    call c_f_pointer(transfer(record%index, c_null_ptr), index, [3, count])
    call c_f_pointer(transfer(record%constant, c_null_ptr), constant, [count])
    do c = 1, count
      associate (i => index(1, c), j => index(2, c), k => index(3, c))
        a(j, k) = a(j, k) + constant(c) * f(i)
      end associate
    end do
  end subroutine add_brackets

end module variational_m
