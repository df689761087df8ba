! Brackets [u, v] of a frame's fields, by their coefficients, and the inverse derivative of the
! exponential, dexp^-1, in their Lie algebra. For y = exp(u) y0 with y' = sum_i v_i E_i(y) it is u'
! = dexp_u^-1 v = v - [u, v] / 2 + [u, [u, v]] / 12 - ..., on most blocks in closed form.
module algebra_m
  use kinds, only: wp
  use blocks_m, only: beta, block_t, full_turn, half_turn, last_term, series_below, zero_bracket
  use frames_m, only: frame_t
  use shared_numbers, only: bracket_operation, callback_block, dexpinv_operation, euclidean_block, &
                            isospectral_block, se3_block, so_block, su_block, u_block
  use orthogonal_m, only: orthogonal_bracket, orthogonal_dexpinv
  use rotations_m, only: dexpinv_rotation
  use unitary_m, only: unitary_bracket, unitary_dexpinv
  use vectors_m, only: cross
  implicit none
  private
  public :: bracket, dexpinv

contains

  ! Computes the bracket w = [u, v] of fields of the frame: DU V - DV U as vector fields.
  subroutine bracket(frame, u, v, w)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: u(:), v(:)   ! (dimension)
    real(wp), contiguous, intent(out) :: w(:)        ! (dimension)
    real(wp) :: side
    integer :: i

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), v1 => frame%blocks(i)%v1, v2 => frame%blocks(i)%v2)
        side = merge(1.0_wp, -1.0_wp, block%space)     ! 1 if points are moved from the left
        if (block%kind == euclidean_block) then
          w(v1:v2) = 0.0_wp
        else if (block%kind == callback_block) then
          call frame%callback%apply(bracket_operation, u, v, w)
        else if (block%kind == se3_block) then
          w(v1:v2) = side * reshape(motion_bracket(reshape(u(v1:v2), [3, 1 + block%k]), &
            reshape(v(v1:v2), [3, 1 + block%k])), [block%dimension])
        else if (is_rotation(block)) then
          w(v1:v2) = side * cross(u(v1:v2), v(v1:v2))
        else if (any(block%kind == [su_block, u_block])) then
          call unitary_bracket(block%n, side * u(v1:v2), v(v1:v2), w(v1:v2))
        else
          call orthogonal_bracket(block%n, side * u(v1:v2), v(v1:v2), w(v1:v2))
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

  ! Replaces v by dexp_u^-1 v.
  subroutine dexpinv(frame, order, u, v, exists)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: order                     ! the method's, where the series ends
    real(wp), intent(in) :: u(frame%dimension)
    real(wp), intent(inout) :: v(frame%dimension)
    ! whether the whole series converges; if not, v is undefined
    logical, intent(out) :: exists
    real(wp) :: side
    integer :: i

    exists = .true.
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), v1 => frame%blocks(i)%v1, v2 => frame%blocks(i)%v2)
        if (block%kind == euclidean_block) cycle
        side = merge(1.0_wp, -1.0_wp, block%space)
        if (block%kind == callback_block) then
          call frame%callback%apply(dexpinv_operation, u, (v), v)
          exists = all(abs(v) <= huge(v))
        else if (block%kind == se3_block) then
          call dexpinv_motion(block%k, side, u(v1:v2), v(v1:v2), exists)
        else if (is_rotation(block)) then
          call dexpinv_rotation(side, u(v1:v2), v(v1:v2), exists)
        else if (any(block%kind == [su_block, u_block])) then
          call unitary_dexpinv(block%n, order, side * u(v1:v2), v(v1:v2), exists)
        else
          call orthogonal_dexpinv(block%n, order, side * u(v1:v2), v(v1:v2), exists)
        end if
      end associate
    end do
  end subroutine dexpinv

  ! For rigid motions ad (ad^2 + angle^2)^2 = 0, so that the sum is 1 - ad / 2 + a ad^2 + b ad^4,
  ! with the value and the derivative of the series at the eigenvalues of ad.
  pure subroutine dexpinv_motion(vectors, side, u, v, exists)
    integer, intent(in) :: vectors
    real(wp), intent(in) :: side, u(3, 0:vectors)    ! u: a rotation and velocities
    real(wp), intent(inout) :: v(3, 0:vectors)
    logical, intent(inout) :: exists
    real(wp) :: a, b, square, half, sine, cotangent, value, slope
    real(wp), dimension(3, 0:vectors) :: power, total
    integer :: k

    square = dot_product(u(:, 0), u(:, 0))
    power = motion_bracket(u, v)
    if (square >= half_turn**2) then
      if (norm2(power(:, 0)) <= zero_bracket * norm2(u(:, 0)) * norm2(v(:, 0)) .and. &
          norm2(power) <= zero_bracket * norm2(u) * norm2(v)) return
      if (square >= full_turn**2) then
        exists = .false.
        return
      end if
    end if
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
    total = v - (side / 2) * power
    power = motion_bracket(u, power)
    total = total + a * power
    power = motion_bracket(u, motion_bracket(u, power))
    v = total + b * power
  end subroutine dexpinv_motion

  ! The bracket of se(3): (w1 x w2, w1 x u2 - w2 x u1), with any number of velocities u
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
