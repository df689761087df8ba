! Differences of points: the smallest v whose flow leads from x to y; their magnitudes.
!
! Of rotations v is the logarithm of the quotient as a quaternion q = (sin(a / 2) n, cos(a / 2)),
! v = 2 atan2(|q(1:3)|, q(4)) q(1:3) / |q(1:3)|, which is accurate for every angle a.
!
! Norms of errors of steps: root mean squares over the coefficients of the flow from one
! point to another or, on frames without such coefficients, over the entries of points.
module coordinates_m
  use blocks_m, only: as_complex, block_t, min_length
  use frames_m, only: frame_t
  use kinds, only: wp
  use linear_action_m, only: linear_tangent
  use orthogonal_m, only: orthogonal_difference
  use rotations_m, only: get_quaternion
  use shared_numbers, only: callback_block, coordinates_operation, euclidean_block, &
                            isospectral_block, linear_action_block, quaternion_block, se3_block, &
                            sizes_operation, so3_block, so_block, sphere_block, stiefel_block, &
                            su2_block, su_block, tangent_operation, u_block, &
                            without_isotropy_operation
  use stiefel_m, only: isospectral_tangent, stiefel_tangent
  use unitary_m, only: unitary_difference
  use vectors_m, only: cross, nan
  implicit none
  private
  public :: coordinate_sizes, difference, error_norm, error_scales, point_sizes, &
            quaternion_quotient, quotient, remove_isotropy, tangent, tolerances_t

  real(wp), parameter :: pi = acos(-1.0_wp)

  ! near the opposite point of a sphere, the least sine of the angle over the chord between them
  real(wp), parameter :: min_sine = 1.0e-4_wp

  ! The tolerances of a pair and its longest step. A difference has `width` entries.
  type :: tolerances_t
    real(wp), allocatable :: atol(:)       ! (width)
    real(wp), allocatable :: rtols(:)      ! (width)
    real(wp) :: rtol = 0.0_wp              ! the smallest one
    logical :: in_coordinates = .true.     ! whether differences are in coordinates
    integer :: reals_per_entry = 1         ! 2 if entries are complex
    real(wp) :: exponent = 0.0_wp          ! power of an error that a step size is proportional to
    real(wp) :: max_step = 0.0_wp
  end type tolerances_t

contains

  ! Computes the smallest v whose flow leads from x to y, NaN if they are half a turn apart.
  subroutine difference(frame, x, y, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, target, intent(in) :: x(:), y(:)       ! (point_size)
    real(wp), contiguous, intent(out) :: v(:)          ! (dimension)
    integer :: i

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), p1 => frame%blocks(i)%p1, p2 => frame%blocks(i)%p2)
        select case (block%kind)
        case (euclidean_block)
          v(block%v1:block%v2) = y(p1:p2) - x(p1:p2)
        case (quaternion_block, su2_block)
          v(block%v1:block%v2) = logarithm(quaternion_quotient(get_quaternion(block, x(p1:p2)), &
            get_quaternion(block, y(p1:p2) - x(p1:p2)), block%space))
        case (so3_block, se3_block)
          call find_twist(block, x(p1:p2), y(p1:p2), v(block%v1:block%v2))
        case (sphere_block)
          v(block%v1:block%v2) = rotation_between(x(p1:p2), y(p1:p2))
        case (so_block)
          call orthogonal_difference(block%n, block%space, x(p1:p2), y(p1:p2), v(block%v1:block%v2))
        case (su_block, u_block)
          call unitary_difference(block%n, block%space, as_complex(block%n, x(p1:p2)), &
                                  as_complex(block%n, y(p1:p2)), v(block%v1:block%v2))
        case (callback_block)
          call frame%callback%apply(coordinates_operation, x, y, v)
        case default                         ! no coordinates are known
          v(block%v1:block%v2) = nan
        end select
      end associate
    end do
  end subroutine difference

  ! Computes the magnitude that the error in each coordinate is relative to: |y_i| on Euclidean
  ! space, the distance from the origin for the translations of a rigid motion, 1 for angles
  subroutine coordinate_sizes(frame, y, s)
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
  end subroutine coordinate_sizes

  ! X^T Y in body axes and Y X^T in space axes. With the difference of two rotations as Y it is the
  ! rotation between them less the identity, without cancellation for small angles.
  pure function quotient(block, x, y)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: x(3, 3), y(3, 3)   ! X and Y by rows
    real(wp) :: quotient(3, 3)

    if (block%space) then
      quotient = matmul(transpose(y), x)
    else
      quotient = matmul(x, transpose(y))
    end if
  end function quotient

  ! The quaternion (vector part, scalar part >= 0) of a rotation, given less the identity, by its
  ! largest component (S. W. Shepperd, J. Guidance Control 1 (1978), 223).
  pure function quaternion_of(r) result(q)
    real(wp), intent(in) :: r(3, 3)
    real(wp) :: q(4), outer(4, 4), trace     ! outer: four times the outer product of q with itself
    integer :: i, row

    trace = r(1, 1) + r(2, 2) + r(3, 3)
    outer(1:3, 1:3) = r + transpose(r)
    do i = 1, 3
      outer(i, i) = 2 * r(i, i) - trace
    end do
    outer(1:3, 4) = [r(3, 2) - r(2, 3), r(1, 3) - r(3, 1), r(2, 1) - r(1, 2)]
    outer(4, 1:3) = outer(1:3, 4)
    outer(4, 4) = 4 + trace
    row = maxloc([(outer(i, i), i=1, 4)], 1)
    q = outer(:, row) / norm2(outer(:, row))
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

  ! Computes the coefficients (v, u, ...) of the rigid motion from x to y. The velocities are a u +
  ! (1 - a) n (n . u) + b n x u, translations u turned about the axis n and stretched.
  pure subroutine find_twist(block, x, y, twist)
    type(block_t), intent(in) :: block
    real(wp), intent(in), dimension(3 + block%k, 3) :: x, y    ! rows
    real(wp), intent(out) :: twist(3, 0:block%k)
    real(wp) :: r(3, 3), u(3), v(3), n(3), half, a, b
    integer :: i

    r = quotient(block, x(1:3, :), y(1:3, :) - x(1:3, :))
    v = logarithm(quaternion_of(r))
    twist(:, 0) = v
    half = max(sqrt(dot_product(v, v)) / 2, min_length)
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
  pure function quaternion_quotient(p, chord, space) result(r)
    real(wp), intent(in) :: p(4), chord(4)   ! chord: q - p; vector part, scalar part
    logical, intent(in) :: space
    real(wp) :: r(4)

    r(1:3) = p(4) * chord(1:3) - chord(4) * p(1:3) &
             + merge(1.0_wp, -1.0_wp, space) * cross(p(1:3), chord(1:3))
    r(4) = dot_product(p, p + chord)
  end function quaternion_quotient

  ! The smallest rotation vector that rotates the unit vector x to y
  pure function rotation_between(x, y) result(v)
    real(wp), intent(in) :: x(3), y(3)
    real(wp) :: v(3), chord(3), sine, cosine

    cosine = dot_product(x, y)
    chord = y - sign(1.0_wp, cosine) * x
    v = cross(x, chord)
    sine = sqrt(dot_product(v, v))
    if (sine > 0) v = (atan2(sine, cosine) / sine) * v
    if ((cosine < 0 .and. .not. sine > min_sine * norm2(chord)) &
        .or. .not. (sine > 0 .or. cosine > 0)) v = nan
  end function rotation_between

  ! Computes the field with coefficients v as a difference, of entries if these are compared.
  subroutine tangent(frame, tolerances, v, y, change)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: v(:)           ! (dimension)
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: change(:)     ! (width)
    integer :: i

    if (tolerances%in_coordinates) then
      change = v
      return
    end if
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), v1 => frame%blocks(i)%v1, v2 => frame%blocks(i)%v2, &
                 p1 => frame%blocks(i)%p1, p2 => frame%blocks(i)%p2)
        select case (block%kind)
        case (callback_block)
          call frame%callback%apply(tangent_operation, v, y, change)
        case (linear_action_block)
          call linear_tangent(block%action, v(v1:v2), y(p1:p2), change(p1:p2))
        case (stiefel_block)
          call stiefel_tangent(block%k, block%n, v(v1:v2), y(p1:p2), change(p1:p2))
        case (isospectral_block)
          call isospectral_tangent(block%n, v(v1:v2), y(p1:p2), change(p1:p2))
        end select
      end associate
    end do
  end subroutine tangent

  ! Computes the magnitudes that errors are relative to, of entries their root mean square.
  subroutine point_sizes(frame, tolerances, y, magnitudes)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: magnitudes(:) ! (width)
    integer :: counted

    if (tolerances%in_coordinates) then
      call coordinate_sizes(frame, y, magnitudes)
      return
    end if
    counted = count(tolerances%atol <= huge(1.0_wp))
    magnitudes = norm2(merge(y, 0.0_wp, tolerances%atol <= huge(1.0_wp))) &
            / sqrt(real(counted / tolerances%reals_per_entry, wp))
  end subroutine point_sizes

  ! Computes the tolerances at the larger of two points, all positive.
  subroutine error_scales(frame, tolerances, x, y, spare, scale)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: x(:), y(:)     ! (point_size)
    real(wp), contiguous, intent(out) :: spare(:)      ! (width) workspace
    real(wp), contiguous, intent(out) :: scale(:)      ! (width)

    call point_sizes(frame, tolerances, x, spare)
    call point_sizes(frame, tolerances, y, scale)
    scale = max(tolerances%rtols * max(scale, spare) + tolerances%atol, tiny(1.0_wp))
  end subroutine error_scales

  ! The root mean square of a difference in tolerances, without entries of infinite tolerance
  pure real(wp) function error_norm(tolerances, v, scale)
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: v(:), scale(:)       ! (width)
    integer :: counted

    counted = max(count(scale <= huge(1.0_wp)), 1)
    error_norm = sqrt(sum((v / scale)**2) &
                      / (real(counted, wp) / real(tolerances%reals_per_entry, wp)))
  end function error_norm

  ! Removes the part of v whose flow leaves the point fixed: on a sphere, the rotation about it.
  subroutine remove_isotropy(frame, y, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)         ! (point_size)
    real(wp), contiguous, intent(inout) :: v(:)      ! (dimension)
    integer :: i

    do i = 1, size(frame%blocks)
      if (frame%blocks(i)%kind == callback_block) &
        call frame%callback%apply(without_isotropy_operation, (v), y, v)
      if (frame%blocks(i)%kind /= sphere_block) cycle
      associate (k => frame%blocks(i)%v1, p => frame%blocks(i)%p1)
        v(k:k + 2) = v(k:k + 2) - dot_product(v(k:k + 2), y(p:p + 2)) * y(p:p + 2)
      end associate
    end do
  end subroutine remove_isotropy

end module coordinates_m
