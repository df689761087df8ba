! Differences of points: the smallest coefficients v of a flow from x to y, by which errors of steps
! are measured, and the magnitudes that their relative tolerances refer to.
!
! Of rotations v is the logarithm of the quotient as a quaternion q = (sin(a / 2) n, cos(a / 2)),
! v = 2 atan2(|q(1:3)|, q(4)) q(1:3) / |q(1:3)|, which is accurate for every angle a.
module coordinates_m
  use kinds, only: wp
  use blocks_m, only: block_t
  use frames_m, only: frame_t
  use rotations_m, only: get_quaternion
  use shared_numbers
  use unitary_m, only: unitary_difference
  use vectors_m, only: cross, nan
  implicit none
  private
  public :: difference, sizes

  real(wp), parameter :: pi = acos(-1.0_wp)
  real(wp), parameter :: smallest = sqrt(tiny(1.0_wp))    ! its square doesn't underflow

  ! near the opposite point of a sphere, the least fraction of the distance that is along the sphere
  real(wp), parameter :: opposite = 1.0e-4_wp

contains

  ! Computes the smallest v whose flow leads from x to y. It is NaN between opposite points of a
  ! sphere and between matrices that are half a turn apart.
  subroutine difference(frame, x, y, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: x(:), y(:)     ! (point_size)
    real(wp), contiguous, intent(out) :: v(:)          ! (dimension)
    integer :: i

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), p => frame%blocks(i)%p1, last => frame%blocks(i)%p2)
        if (block%kind == callback_block) then
          call frame%callback%apply(coordinates_operation, x, y, v)
        else
          call difference_in_block(block, x(p:last), y(p:last), v(block%v1:block%v2))
        end if
      end associate
    end do
  end subroutine difference

  ! Computes the difference in one block.
  subroutine difference_in_block(block, x, y, v)
    type(block_t), intent(in) :: block
    real(wp), contiguous, intent(in) :: x(:), y(:)
    real(wp), contiguous, intent(out) :: v(:)

    select case (block%kind)
    case (euclidean_block)
      v = y - x
    case (quaternion_block, su2_block)
      v = logarithm(quaternion_quotient(get_quaternion(block, x), get_quaternion(block, y - x), &
                                        block%space))
    case (so3_block)
      v = logarithm(quaternion_of(quotient(block, transpose(reshape(x, [3, 3])), &
                                           transpose(reshape(y - x, [3, 3])))))
    case (se3_block)
      call find_twist(block, x, y, v)
    case (sphere_block)
      v = smallest_rotation(x, y)
    case (so_block, su_block, u_block)
      call unitary_difference(block%kind, block%n, block%space, x, y, v)
    case default                           ! no coordinates are known
      v = nan
    end select
  end subroutine difference_in_block

  ! Computes the magnitude that the error in each coordinate is relative to: |y_i| on Euclidean
  ! space, the distance from the origin for the translations of a rigid motion, 1 for angles
  subroutine sizes(frame, y, s)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)     ! (point_size)
    real(wp), contiguous, intent(out) :: s(:)    ! (dimension)
    integer :: i, j

    s = 1.0_wp
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), m => 3 + frame%blocks(i)%k)  ! m: entries of a row
        select case (block%kind)
        case (euclidean_block)
          s(block%v1:block%v2) = abs(y(block%p1:block%p2))
        case (se3_block)
          do j = 3, m - 1
            s(block%v1 + 3 * j - 6:block%v1 + 3 * j - 4) = norm2(y(block%p1 + j + [0, m, 2 * m]))
          end do
        case (callback_block)
          call frame%callback%apply(sizes_operation, y, y, s)
        end select
      end associate
    end do
  end subroutine sizes

  ! x^T y in body axes and y x^T in space axes. With the difference of two rotations as y it is the
  ! rotation between them less the identity, without cancellation for small angles.
  pure function quotient(block, x, y)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: x(3, 3), y(3, 3)
    real(wp) :: quotient(3, 3)

    if (block%space) then
      quotient = matmul(y, transpose(x))
    else
      quotient = matmul(transpose(x), y)
    end if
  end function quotient

  ! The quaternion (vector part, scalar part >= 0) of a rotation, by way of its component of largest
  ! modulus: S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance Control 1 (1978). The
  ! rotation is given less the identity.
  pure function quaternion_of(r) result(q)
    real(wp), intent(in) :: r(3, 3)
    real(wp) :: q(4), outer(4, 4), trace     ! outer: four times the outer product of q with itself
    integer :: i, largest

    trace = r(1, 1) + r(2, 2) + r(3, 3)
    outer(1:3, 1:3) = r + transpose(r)
    do i = 1, 3
      outer(i, i) = 2 * r(i, i) - trace
    end do
    outer(1:3, 4) = [r(3, 2) - r(2, 3), r(1, 3) - r(3, 1), r(2, 1) - r(1, 2)]
    outer(4, 1:3) = outer(1:3, 4)
    outer(4, 4) = 4 + trace
    largest = maxloc([(outer(i, i), i=1, 4)], 1)
    q = outer(:, largest) / norm2(outer(:, largest))
    if (q(4) < 0) q = -q
  end function quaternion_of

  ! The rotation vector, of length at most 2 pi, of a unit quaternion
  pure function logarithm(q) result(v)
    real(wp), intent(in) :: q(4)
    real(wp) :: v(3), sine

    sine = sqrt(dot_product(q(1:3), q(1:3)))
    if (sine > 0) then
      v = (2 * (atan2(sine, q(4)) / sine)) * q(1:3)
    else if (q(4) < 0) then
      v = [2 * pi, 0.0_wp, 0.0_wp]     ! any axis would do
    else
      v = 2 * q(1:3)
    end if
  end function logarithm

  ! Computes the coefficients (v, u, ...) of the rigid motion from x to y. A translation is
  ! a u + (1 - a) n (n . u) + b n x u, as in frames; across the axis n that is a turn and a
  ! stretch by the sinc of half the angle.
  pure subroutine find_twist(block, x, y, twist)
    type(block_t), intent(in) :: block
    real(wp), intent(in), dimension(3 + block%k, 3) :: x, y    ! rows
    real(wp), intent(out) :: twist(3, 0:block%k)
    real(wp) :: r(3, 3), u(3), v(3), n(3), half, a, b
    integer :: i

    r = quotient(block, transpose(x(1:3, :)), transpose(y(1:3, :) - x(1:3, :)))
    v = logarithm(quaternion_of(r))
    twist(:, 0) = v
    half = max(sqrt(dot_product(v, v)) / 2, smallest)
    n = v / (2 * half)
    a = half * cos(half) / sin(half)
    b = half
    do i = 1, block%k
      if (block%space) then
        u = y(3 + i, :) - x(3 + i, :) - matmul(r, x(3 + i, :))
      else
        u = matmul(x(1:3, :), y(3 + i, :) - x(3 + i, :))
      end if
      twist(:, i) = a * u + (1 - a) * dot_product(n, u) * n - b * cross(n, u)
    end do
  end subroutine find_twist

  ! p^-1 q, or q p^-1, without cancellation for small angles
  pure function quaternion_quotient(p, away, space) result(r)
    real(wp), intent(in) :: p(4), away(4)   ! away: q - p; vector part, scalar part
    logical, intent(in) :: space
    real(wp) :: r(4)

    r(1:3) = p(4) * away(1:3) - away(4) * p(1:3) &
             + merge(1.0_wp, -1.0_wp, space) * cross(p(1:3), away(1:3))
    r(4) = dot_product(p, p + away)
  end function quaternion_quotient

  ! The smallest rotation vector that rotates the unit vector x to y
  pure function smallest_rotation(x, y) result(v)
    real(wp), intent(in) :: x(3), y(3)
    real(wp) :: v(3), short(3), sine, cosine

    cosine = dot_product(x, y)
    short = y - sign(1.0_wp, cosine) * x
    v = cross(x, short)
    sine = sqrt(dot_product(v, v))
    if (cosine < 0 .and. .not. sine > opposite * norm2(short)) then
      v = nan
    else if (sine > 0) then
      v = (atan2(sine, cosine) / sine) * v
    else if (.not. cosine > 0) then
      v = nan
    end if
  end function smallest_rotation

end module coordinates_m
