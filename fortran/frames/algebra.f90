! Brackets [u, v] of a frame's fields, by their coefficients, and the inverse derivative of the
! exponential, dexp^-1, in their Lie algebra. For y = exp(u) y0 with y' = sum_i v_i E_i(y) it is
! u' = dexp_u^-1 v = v - [u, v] / 2 + [u, [u, v]] / 12 - ..., a series in Bernoulli numbers. On most
! blocks it has a closed form.
module algebra_m
  use kinds, only: wp
  use blocks_m, only: algebra_coefficients, algebra_matrix, as_complex, block_t, largest_own
  use frames_m, only: frame_t
  use shared_numbers
  use orthogonal_m, only: multiply_real => multiply
  use unitary_m, only: multiply
  use vectors_m, only: cross
  implicit none
  private
  public :: bracket, dexpinv

  ! |B_2k| / (2 k)! for k = 1, 2, ..., with Bernoulli's numbers
  real(wp), parameter :: beta(11) = [ &
    1 / 12.0_wp, 1 / 720.0_wp, 1 / 30240.0_wp, 1 / 1209600.0_wp, 1 / 47900160.0_wp, &
    691 / 1307674368000.0_wp, 1 / 74724249600.0_wp, 3617 / 10670622842880000.0_wp, &
    43867 / 5109094217170944000.0_wp, 174611 / 802857662698291200000.0_wp, &
    77683 / 1.4101100039391805e22_wp]
  ! Terms decrease by a factor 4 pi^2, so that the rest of the series is below rounding in double
  ! precision, which no frame exceeds.
  integer, parameter :: last_term = 11
  real(wp), parameter :: series_below = 1.0_wp             ! the largest square of an angle
  real(wp), parameter :: smallest = sqrt(tiny(1.0_wp))     ! its square doesn't underflow
  ! The radius of the series: at a full turn of rotations
  real(wp), parameter :: radius = 8 * atan(1.0_wp)
  ! relative brackets below this are rounding
  real(wp), parameter :: commute = 1024 * epsilon(1.0_wp)  ! sums of weights up to 40 in DOP853
  ! Number of powers computed; the growth of the latter half is taken for that of all.
  integer, parameter :: powers = 20

contains

  ! The sign of brackets: 1 if points are moved from the left
  pure real(wp) function side(block)
    type(block_t), intent(in) :: block

    side = merge(1.0_wp, -1.0_wp, block%space .or. block%kind == sphere_block &
                                  .or. block%kind == isospectral_block)
  end function side

  ! Computes the bracket w = [u, v] of fields of the frame: DU V - DV U as vector fields.
  subroutine bracket(frame, u, v, w)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: u(:), v(:)   ! (dimension)
    real(wp), contiguous, intent(out) :: w(:)        ! (dimension)
    integer :: i

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), first => frame%blocks(i)%v1, last => frame%blocks(i)%v2)
        if (block%kind == euclidean_block) then
          w(first:last) = 0.0_wp
        else if (block%kind == callback_block) then
          call frame%callback%apply(bracket_operation, u, v, w)
        else if (block%kind == se3_block) then
          w(first:last) = side(block) * reshape(motion_bracket( &
            reshape(u(first:last), [3, 1 + block%k]), reshape(v(first:last), [3, 1 + block%k])), &
            [block%dimension])
        else if (is_rotation(block)) then
          w(first:last) = side(block) * cross(u(first:last), v(first:last))
        else
          call bracket_matrices(block, side(block) * u(first:last), v(first:last), w(first:last))
        end if
      end associate
    end do
  end subroutine bracket

  ! Whether fields are the rotations of three dimensions. SO(3) may act on matrices, too.
  pure logical function is_rotation(block)
    type(block_t), intent(in) :: block

    is_rotation = block%dimension == 3 .and. block%n == 3 &
                  .or. all(block%kind /= [so_block, isospectral_block, su_block, u_block])
  end function is_rotation

  ! The bracket in matrices
  subroutine bracket_matrices(block, u, v, w)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: u(:), v(:)
    real(wp), intent(out) :: w(:)
    real(wp), dimension(block%point_size), target :: x, y, spare

    call make_matrix(block, u, x)
    call make_matrix(block, v, y)
    call apply_bracket(block, x, y, spare)
    call get_coefficients(block, y, w)
  end subroutine bracket_matrices

  ! Replaces v by dexp_u^-1 v.
  subroutine dexpinv(frame, order, u, v, exists)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: order                     ! the method's, where the series ends
    real(wp), contiguous, intent(in) :: u(:)         ! (dimension)
    real(wp), contiguous, intent(inout) :: v(:)      ! (dimension)
    ! whether the whole series converges; if not, v is undefined
    logical, intent(out) :: exists
    real(wp) :: sign
    integer :: i

    exists = .true.
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), first => frame%blocks(i)%v1, last => frame%blocks(i)%v2)
        if (block%kind == euclidean_block) cycle
        sign = side(block)
        if (block%kind == callback_block) then
          call frame%callback%apply(dexpinv_operation, u, (v), v)
          exists = all(abs(v) <= huge(v))
        else if (block%kind == se3_block) then
          call dexpinv_motion(block%k, sign, u(first:last), v(first:last), exists)
        else if (is_rotation(block)) then
          call dexpinv_rotation(sign, u(first:last), v(first:last), exists)
        else
          call dexpinv_matrix(block, sign, order, u(first:last), v(first:last), exists)
        end if
      end associate
    end do
  end subroutine dexpinv

  ! For rotations the bracket is the cross product times the sign, and ad^3 = -|u|^2 ad gives a
  ! closed form. Parts of its series don't wait for each other.
  pure subroutine dexpinv_rotation(sign, u, v, exists)
    real(wp), intent(in) :: sign, u(3)
    real(wp), intent(inout) :: v(3)
    logical, intent(inout) :: exists
    real(wp) :: square, fourth, half, once(3), factor

    square = u(1)**2 + u(2)**2 + u(3)**2
    once = cross(u, v)
    if (square >= radius**2) then
      if (.not. norm2(once) <= commute * norm2(u) * norm2(v)) exists = .false.
      return
    end if
    if (square < series_below) then
      fourth = square**2
      factor = (beta(1) + beta(2) * square) + (beta(3) + beta(4) * square) * fourth &
               + ((beta(5) + beta(6) * square) + (beta(7) + beta(8) * square) * fourth) &
                 * fourth**2 &
               + ((beta(9) + beta(10) * square) + beta(11) * fourth) * fourth**4
    else
      half = sqrt(square) / 2
      factor = (1 - half * cos(half) / sin(half)) / square
    end if
    v = v - (sign / 2) * once + factor * cross(u, once)
  end subroutine dexpinv_rotation

  ! Replaces v by the series in matrices up to the power `order` of u. The order of a step needs two
  ! powers less, but then errors of long steps exceed their estimates by far. Beyond the radius of
  ! convergence it is used only if the brackets of this v don't grow.
  subroutine dexpinv_matrix(block, sign, order, u, v, exists)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: sign
    integer, intent(in) :: order
    real(wp), intent(in) :: u(:)
    real(wp), intent(inout) :: v(:)
    logical, intent(inout) :: exists
    real(wp), dimension(block%point_size), target :: x, power, total, spare
    real(wp) :: bound                  ! no sum of two angles or difference of eigenvalues is larger
    integer :: j

    call make_matrix(block, sign * u, x)
    call make_matrix(block, v, power)
    bound = norm2(u) * merge(sqrt(2.0_wp), 1.0_wp, is_real(block))
    if (is_real(block) .and. block%n > largest_own) &
      bound = min(bound, 2 * maxval(sum(reshape(abs(x), [block%n, block%n]), dim=1)))
    if (bound >= radius) then
      total = power / max(norm2(power), smallest)
      call apply_bracket(block, x, total, spare)
      if (norm2(total) <= commute * bound) return
      if (.not. growth(total) < radius) then
        exists = .false.
        return
      end if
    end if
    total = power
    call apply_bracket(block, x, power, spare)
    total = total - power / 2
    do j = 1, min(order / 2, last_term)
      if (j > 1) call apply_bracket(block, x, power, spare)
      call apply_bracket(block, x, power, spare)
      total = total + merge(beta(j), -beta(j), modulo(j, 2) == 1) * power
    end do
    call get_coefficients(block, total, v)

  contains

    ! The factor by which repeated brackets with x grow
    real(wp) function growth(power)
      real(wp), contiguous, target, intent(inout) :: power(:)
      real(wp) :: factor
      integer :: k

      growth = 1.0_wp
      factor = norm2(power)
      do k = 2, powers
        power = power / factor
        call apply_bracket(block, x, power, spare)
        factor = norm2(power)
        if (factor <= commute * bound) then
          growth = 0.0_wp
          return
        end if
        if (k > powers / 2) growth = growth * factor**(2 / real(powers, wp))
      end do
    end function growth

  end subroutine dexpinv_matrix

  ! Whether matrices of the Lie algebra are real; complex ones are held in twice as many numbers.
  pure logical function is_real(block)
    type(block_t), intent(in) :: block

    is_real = block%kind == so_block .or. block%kind == isospectral_block
  end function is_real

  ! Makes the matrix with given coefficients.
  subroutine make_matrix(block, coefficients, matrix)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: coefficients(:)
    real(wp), contiguous, target, intent(out) :: matrix(:)
    real(wp), pointer, contiguous :: real_view(:, :)
    complex(wp), pointer, contiguous :: view(:, :)

    if (is_real(block)) then
      real_view(1:block%n, 1:block%n) => matrix
      call algebra_matrix(block%n, coefficients, real_view)
    else
      view => as_complex(block%n, matrix)
      call algebra_matrix(block%n, coefficients, view)
    end if
  end subroutine make_matrix

  ! Computes the coefficients of a matrix.
  subroutine get_coefficients(block, matrix, v)
    type(block_t), intent(in) :: block
    real(wp), contiguous, target, intent(in) :: matrix(:)
    real(wp), intent(out) :: v(:)
    real(wp), pointer, contiguous :: view(:, :)

    if (is_real(block)) then
      view(1:block%n, 1:block%n) => matrix
      call algebra_coefficients(block%n, view, v)
    else
      call algebra_coefficients(block%n, as_complex(block%n, matrix), v)
    end if
  end subroutine get_coefficients

  ! Replaces a matrix by its bracket with x, the difference of their product and its adjoint.
  subroutine apply_bracket(block, x, matrix, spare)
    type(block_t), intent(in) :: block
    real(wp), contiguous, target, intent(in) :: x(:)
    real(wp), contiguous, target, intent(inout) :: matrix(:), spare(:)
    real(wp), pointer, contiguous :: product(:, :)
    complex(wp), pointer, contiguous :: view(:, :)

    if (is_real(block)) then
      product(1:block%n, 1:block%n) => spare
      call multiply_real(block%n, x, matrix, product)
      product = product - transpose(product)
    else
      view => as_complex(block%n, spare)
      call multiply(block%n, as_complex(block%n, x), as_complex(block%n, matrix), view)
      view = view - conjg(transpose(view))
    end if
    matrix = spare
  end subroutine apply_bracket

  ! For rigid motions ad (ad^2 + angle^2)^2 = 0, so that the sum is 1 - ad / 2 + a ad^2 + b ad^4,
  ! with the value and the derivative of the series at the eigenvalues of ad
  pure subroutine dexpinv_motion(vectors, sign, u, v, exists)
    integer, intent(in) :: vectors
    real(wp), intent(in) :: sign, u(3, 0:vectors)    ! u: a rotation and velocities
    real(wp), intent(inout) :: v(3, 0:vectors)
    logical, intent(inout) :: exists
    real(wp) :: a, b, square
    real(wp), dimension(3, 0:vectors) :: power, sum

    square = dot_product(u(:, 0), u(:, 0))
    power = motion_bracket(u, v)
    if (square >= radius**2) then
      if (.not. norm2(power) <= commute * norm2(u) * norm2(v)) exists = .false.
      return
    end if
    call motion_factors(square, a, b)
    sum = v - (sign / 2) * power
    power = motion_bracket(u, power)
    sum = sum + a * power
    power = motion_bracket(u, motion_bracket(u, power))
    v = sum + b * power
  end subroutine dexpinv_motion

  ! The coefficients a and b of dexpinv_motion
  pure subroutine motion_factors(square, a, b)
    real(wp), intent(in) :: square           ! the angle's
    real(wp), intent(out) :: a, b
    real(wp) :: half, sine, cotangent, value, slope
    integer :: k

    if (square < series_below) then
      a = 0.0_wp
      b = 0.0_wp
      do k = last_term - 1, 1, -1            ! terms of the series
        a = (real(1 - k, wp) * beta(k + 1) + a) * square
        b = b * square - real(k, wp) * beta(k + 1)
      end do
      a = a + beta(1)
    else
      half = sqrt(square) / 2
      sine = sin(half)
      cotangent = half * cos(half) / sine
      value = (1 - cotangent) / square
      slope = ((half / sine)**2 - cotangent) / (2 * square)
      b = (value - slope) / square
      a = value + b * square
    end if
  end subroutine motion_factors

  ! The bracket of two rigid motions
  pure function motion_bracket(u, v)
    real(wp), intent(in) :: u(:, 0:), v(:, 0:)       ! a rotation and velocities
    real(wp) :: motion_bracket(3, 0:ubound(u, 2))
    integer :: i

    motion_bracket(:, 0) = cross(u(:, 0), v(:, 0))
    do i = 1, ubound(u, 2)
      motion_bracket(:, i) = cross(u(:, 0), v(:, i)) - cross(v(:, 0), u(:, i))
    end do
  end function motion_bracket

end module algebra_m
