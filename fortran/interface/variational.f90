! The right-hand side of a solution together with its derivatives X = (transition, sensitivity, C),
! where C is the covariance of noise with the spectral density Q, if there is any:
!
!   X' = A X + (0, df/dp, C A^T + Q),   A xi = df/dy xi + [f, xi],
!
! where df/dy is the derivative of f along the fields of the frame. The functions are in C; for
! functions of many members cg/integration/variational/field.py evaluates the same in Python.
module variational_m
  use, intrinsic :: iso_c_binding, only: c_double, c_f_pointer, c_int, c_int64_t, c_intptr_t, &
                                         c_null_ptr, c_ptr
  use coordinates_m, only: sizes
  use free_motion_m, only: add_free_motion, take_forces
  use frames_m, only: apply_flows
  use kinds, only: wp
  use run_m, only: plan_at, plan_t
  use shared_numbers, only: variation_t
  use vector_field_m, only: field_at, rhs_i
  use vectors_m, only: nan
  implicit none
  private
  public :: variational_field

contains

  ! A function of the type rhs_i. The data are the parameters and inputs of a member; the eight
  ! bytes before them are the address of the record.
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
    associate (n => int(record%dimension), width => int(record%width))
      call evaluate(record, user_data, t, y, y(width + 1), f, f(n + 1), code)
    end associate
  end function variational_field

  ! Evaluates f and X'. Matrices are stored row by row, so that columns here are their rows.
  subroutine evaluate(record, parameters, t, y, x, f, slope, code)
    type(variation_t), intent(inout) :: record
    type(c_ptr), intent(in) :: parameters
    real(wp), intent(in) :: t, y(record%width), x(columns(record), record%dimension)
    real(wp), intent(inout) :: f(record%dimension), slope(columns(record), record%dimension)
    integer(c_int), intent(out) :: code
    real(wp) :: a(record%dimension, record%dimension)        ! A, then
    real(wp) :: d(record%parameters, record%dimension)       ! df/dp
    integer :: i, j, n, k

    n = int(record%dimension)
    k = int(record%parameters)
    code = 0
    f = nan
    if (.not. (all(abs(y) <= huge(1.0_wp)) .and. all(abs(x) <= huge(1.0_wp)))) return
    call evaluate_at(record%f, record%f_data, y, f)
    record%failed_function = 0
    if (code /= 0) return
    a = nan
    if (record%jac == 0) then
      call difference_along_fields()
    else
      call evaluate_at(record%jac, record%jac_data, y, a)
      if (code /= 0 .or. .not. all(abs(a) <= huge(1.0_wp))) record%failed_function = 1
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
      d = nan
      if (record%df_dp == 0) then
        call difference_by_parameters()
      else
        call evaluate_at(record%df_dp, record%df_dp_data, y, d)
        if (code /= 0 .or. .not. all(abs(d) <= huge(1.0_wp))) record%failed_function = 2
      end if
      slope(n + 1:n + k, :) = slope(n + 1:n + k, :) + d
    end if
    if (record%noises > 0 .and. code == 0) then
      j = columns(record) - int(record%noises) + 1
      call add_noise(x(j:, :), slope(j:, :))
    end if
    if (code == 0 .and. all(abs(f) <= huge(1.0_wp)) .and. all(abs(a) <= huge(1.0_wp))) then
      if (all(record%failed_function /= [2_c_int64_t, 4_c_int64_t]) .and. &
          .not. all(abs(slope) <= huge(1.0_wp))) record%failed_function = 3
    end if

  contains

    ! Adds C A^T + Q, where c(:, i) is row i of C.
    subroutine add_noise(c, slope)
      real(wp), intent(in) :: c(:, :)
      real(wp), intent(inout) :: slope(:, :)
      real(wp), pointer, contiguous :: constant(:, :)
      real(wp) :: q(record%dimension, record%dimension)

      if (record%noise == 0) then
        call c_f_pointer(transfer(record%noise_data, c_null_ptr), constant, [n, n])
        q = constant
      else
        q = nan
        call evaluate_at(record%noise, record%noise_data, y, q)
        if (code /= 0 .or. .not. all(abs(q) <= huge(1.0_wp))) record%failed_function = 4
      end if
      slope = slope + matmul(transpose(a), c) + q
    end subroutine add_noise

    ! Calls a function, which may write into the point that it is given. Its data are its own, or
    ! the parameters of the member, or those of f.
    subroutine evaluate_at(address, own_data, y, values)
      integer(c_intptr_t), intent(in) :: address, own_data
      real(wp), intent(in) :: y(record%width)
      real(wp), intent(inout) :: values(*)
      procedure(rhs_i), pointer :: rhs
      real(wp) :: point(record%width)
      type(plan_t), pointer :: plan
      type(c_ptr) :: data

      data = transfer(merge(own_data, record%data, own_data /= 0), data)
      if (own_data == 0 .and. record%parameters + record%inputs > 0) data = parameters
      point = y
      rhs => field_at(address)
      code = rhs(t, point, values, data)
      plan => plan_at(record%frame)
      if (code /= 0 .or. plan%frame%forces == 0) return
      call take_forces(plan%frame, y, values)
      call add_free_motion(plan%frame, y, values)
    end subroutine evaluate_at

    ! a(j, i) becomes the difference of f(i) along field j.
    subroutine difference_along_fields()
      type(plan_t), pointer :: plan
      real(wp) :: step(record%dimension), v(record%dimension), point(record%width)
      real(wp) :: values(record%dimension, 2)          ! ahead and behind
      integer :: side, sides

      plan => plan_at(record%frame)
      a = 0.0_wp
      call sizes(plan%frame, y, step)
      step = record%step * max(step, 1.0_wp)
      sides = merge(1, 2, record%one_sided /= 0)
      values(:, 2) = f
      do j = 1, n
        v = 0.0_wp
        do side = 1, sides
          v(j) = merge(step(j), -step(j), side == 1)
          point = y
          call apply_flows(plan%frame, 1, v, point)
          values(:, side) = nan
          call evaluate_at(record%f, record%f_data, point, values(:, side))
          if (code /= 0) return
        end do
        a(j, :) = (values(:, 1) - values(:, 2)) / (real(sides, wp) * step(j))
      end do
    end subroutine difference_along_fields

    ! d(j, i) becomes the difference of f(i) by parameter j. Parameters are changed in
    ! place, since functions of Python hold a view of them.
    subroutine difference_by_parameters()
      real(wp), pointer, contiguous :: values(:), scales(:)
      real(wp) :: step, before, f_at(record%dimension, 2)      ! f_at: ahead and behind
      integer :: side, sides

      call c_f_pointer(parameters, values, [k])
      call c_f_pointer(transfer(record%scales, c_null_ptr), scales, [k])
      d = 0.0_wp
      sides = merge(1, 2, record%one_sided /= 0)
      f_at(:, 2) = f
      do j = 1, k
        before = values(j)
        step = max(abs(before), scales(j))
        step = record%step * merge(step, 1.0_wp, step > sqrt(tiny(1.0_wp)))
        do side = 1, sides
          values(j) = before + merge(step, -step, side == 1)
          f_at(:, side) = nan
          call evaluate_at(record%f, record%f_data, y, f_at(:, side))
          values(j) = before
          if (code /= 0) return
        end do
        d(j, :) = (f_at(:, 1) - f_at(:, 2)) / (real(sides, wp) * step)
      end do
    end subroutine difference_by_parameters

  end subroutine evaluate

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

  ! The number of columns of X
  pure integer function columns(record)
    type(variation_t), intent(in) :: record

    columns = int(record%dimension + record%parameters + record%noises)
  end function columns

end module variational_m
