! Rotations of three dimensions: flows of matrices, unit quaternions, SU(2), spheres and rigid
! motions. All are by the quaternion q = (sin(half) v / (2 half), cos(half)) of the rotation vector
! v, half = |v| / 2: those of several flows are multiplied, and one rotation moves the point.
module rotations_m
  use kinds, only: wp
  use blocks_m, only: beta, block_t, full_turn, half_turn, min_length, series_below, zero_bracket
  use shared_numbers, only: quaternion_block, so3_block, sphere_block, su2_block
  implicit none
  ! What flows call is private so that it is inlined; otherwise flows take a fifth longer.
  private
  public :: dexpinv_rotation, exponential, get_quaternion, move_rigid_body, orthogonalise, rotate, &
            rotate_matrix, rotate_vector, rotation_bound, set_quaternion, turn_point

  ! Taylor's coefficients of sin(x) / x and cos(x) for x**2, x**4, ..., enough up to max_square
  integer :: term
  real(wp), parameter :: sines(8) = [((-1.0_wp)**term / gamma(real(2 * term + 2, wp)), term = 1, 8)]
  real(wp), parameter :: cosines(8) = [((-1.0_wp)**term / gamma(real(2 * term + 1, wp)), &
                                        term = 1, 8)]
  real(wp), parameter :: max_square = 0.64_wp

contains

  ! Rotates a point by the product of the rotations of all flows.
  subroutine rotate(block, flows, m, v, y)
    type(block_t), intent(in) :: block
    integer, intent(in) :: flows, m          ! m: coefficients of the frame
    real(wp), intent(in) :: v(m, *)          ! the first three rows are used
    real(wp), intent(inout) :: y(block%point_size)
    real(wp) :: q(4), e(4), sinc, side
    integer :: j

    side = merge(1.0_wp, -1.0_wp, block%space)
    call exponential(v(1:3, 1), q, sinc)
    do j = 2, flows
      call exponential(v(1:3, j), e, sinc)
      call multiply(side, e, q(1), q(2), q(3), q(4))
    end do
    call turn_point(block, q, y)
  end subroutine rotate

  ! Rotates a point by a unit quaternion, from the side of the axes of the block.
  pure subroutine turn_point(block, q, y)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: q(4)
    real(wp), intent(inout) :: y(block%point_size)
    real(wp) :: e(4), side

    side = merge(1.0_wp, -1.0_wp, block%space)
    select case (block%kind)
    case (so3_block)
      call rotate_matrix(q, block%space, y)
    case (sphere_block)
      call rotate_vector(q, y)
    case (quaternion_block)
      if (block%scalar_first) then
        call multiply(side, q, y(2), y(3), y(4), y(1))
      else
        call multiply(side, q, y(1), y(2), y(3), y(4))
      end if
    case (su2_block)
      e = get_quaternion(block, y)
      call multiply(side, q, e(1), e(2), e(3), e(4))
      call set_quaternion(e, y)
    end select
  end subroutine turn_point

  ! Moves a rigid motion (R, x), y -> R y + x, or one with several vectors x; the coefficients are a
  ! rotation vector and as many velocities. One flow's motion is (exp hat v, V u), where V is the
  ! mean of exp(s hat v) over s from 0 to 1: V u = a u + (1 - a) n (n . u) + b n x u with v = angle
  ! n, a = sin(angle) / angle and b = (1 - cos(angle)) / angle. Only what is small beside u cancels.
  subroutine move_rigid_body(block, flows, m, all_v, y)
    type(block_t), intent(in) :: block
    integer, intent(in) :: flows, m          ! m: coefficients of the frame
    real(wp), intent(in) :: all_v(m, *)      ! the first 3 + 3 k rows are used
    real(wp), intent(inout) :: y(3 + block%k, 3)     ! rows, of R and of x
    real(wp) :: q(4), e(4), x(3, block%k), u(3), v(3), n(3), r(3, 3), half, sinc, a, b
    integer :: i, j

    q = [0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    x = 0.0_wp
    do j = 1, flows
      v = all_v(1:3, j)
      call exponential(v, e, sinc)
      half = max(norm2(v) / 2, min_length)
      n = v / (2 * half)
      a = sinc * e(4)
      b = half * sinc**2
      do i = 1, block%k
        u = all_v(3 * i + 1:3 * i + 3, j)
        u = a * u + (1 - a) * dot_product(n, u) * n + b * cross(n, u)
        if (block%space) then
          call rotate_vector(e, x(:, i))
        else
          call rotate_vector(q, u)
        end if
        x(:, i) = x(:, i) + u
      end do
      call multiply(merge(1.0_wp, -1.0_wp, block%space), e, q(1), q(2), q(3), q(4))
    end do
    do i = 1, block%k
      if (block%space) then
        u = y(3 + i, :)
        call rotate_vector(q, u)
        y(3 + i, :) = u + x(:, i)
      else
        do j = 1, 3
          y(3 + i, j) = y(3 + i, j) + dot_product(y(1:3, j), x(:, i))
        end do
      end if
    end do
    r = y(1:3, :)
    call rotate_matrix(q, block%space, r)
    y(1:3, :) = r
  end subroutine move_rigid_body

  ! The quaternion (vector part, scalar part) of a point. For SU(2) it is the nearest one to the
  ! matrix w - i (x, y, z) . (the Pauli matrices), so that rounding off the group is removed.
  pure function get_quaternion(block, y) result(q)
    type(block_t), intent(in) :: block
    real(wp), contiguous, intent(in) :: y(:)       ! (4) or (8)
    real(wp) :: q(4)

    if (block%kind == su2_block) then
      q = [-(y(4) + y(6)), y(5) - y(3), y(8) - y(2), y(1) + y(7)] / 2
    else if (block%scalar_first) then
      q = [y(2:4), y(1)]
    else
      q = y
    end if
  end function get_quaternion

  ! Stores a quaternion as a matrix of SU(2).
  pure subroutine set_quaternion(q, y)
    real(wp), intent(in) :: q(4)
    real(wp), contiguous, intent(inout) :: y(:)    ! (8)

    y = [q(4), -q(3), -q(2), -q(1), q(2), -q(1), q(4), q(3)]
  end subroutine set_quaternion

  ! One Newton-Schulz step of the rotation at the beginning of a matrix
  pure subroutine orthogonalise(m, y)
    integer, intent(in) :: m
    real(wp), intent(inout) :: y(m, 3)             ! the first three rows of a matrix
    real(wp) :: old(3, 3), factor(3, 3)
    integer :: i

    old = y(1:3, :)
    factor = -0.5_wp * matmul(transpose(old), old)
    do i = 1, 3
      factor(i, i) = 1.5_wp + factor(i, i)
    end do
    y(1:3, :) = matmul(old, factor)
  end subroutine orthogonalise

  ! An upper bound of the distance of a matrix from the rotations, or from rigid motions
  pure real(wp) function rotation_bound(m, y)
    integer, intent(in) :: m
    real(wp), intent(in) :: y(m, m)                ! rows; those from the fourth on are constant
    integer :: j

    associate (a => y(1:3, 1), b => y(1:3, 2), c => y(1:3, 3))
      rotation_bound = abs(dot_product(a, a) - 1) + abs(dot_product(b, b) - 1) &
                       + abs(dot_product(c, c) - 1) + 2 * (abs(dot_product(a, b)) &
                       + abs(dot_product(b, c)) + abs(dot_product(c, a)))
      if (.not. dot_product(cross(a, b), c) > 0) rotation_bound = huge(rotation_bound)
    end associate
    do j = 4, m
      rotation_bound = rotation_bound + sum(abs(y(:, j))) - abs(y(j, j)) + abs(y(j, j) - 1)
    end do
  end function rotation_bound

  ! The unit quaternion (vector part, scalar part) of the rotation vector v, and sin(half) / half of
  ! half its angle. Where Taylor's series need few terms, they take a third of the time of a root, a
  ! quotient and the functions of the library, one of which waits for the other.
  pure subroutine exponential(v, e, sinc)
    real(wp), intent(in) :: v(3)
    real(wp), intent(out) :: e(4), sinc
    real(wp) :: square, half

    square = (v(1)**2 + v(2)**2 + v(3)**2) / 4
    if (square <= max_square) then
      sinc = 1 + square * polynomial(sines, square)
      e(4) = 1 + square * polynomial(cosines, square)
    else
      half = sqrt(square)
      sinc = sin(half) / half
      e(4) = cos(half)
    end if
    e(1:3) = (sinc / 2) * v
  end subroutine exponential

  ! A polynomial of degree seven, evaluated in parts that don't wait for each other
  pure real(wp) function polynomial(c, x)
    real(wp), intent(in) :: c(8), x
    real(wp) :: square

    square = x**2
    polynomial = (c(1) + c(2) * x) + (c(3) + c(4) * x) * square &
                 + ((c(5) + c(6) * x) + (c(7) + c(8) * x) * square) * square**2
  end function polynomial

  ! The quaternion q = (x, y, z; w) becomes p q where the side is 1, q p where it is -1.
  pure subroutine multiply(side, p, x, y, z, w)
    real(wp), intent(in) :: side, p(4)
    real(wp), intent(inout) :: x, y, z, w
    real(wp) :: a, b, c, d

    a = p(4) * x + p(1) * w + side * (p(2) * z - p(3) * y)
    b = p(4) * y + p(2) * w + side * (p(3) * x - p(1) * z)
    c = p(4) * z + p(3) * w + side * (p(1) * y - p(2) * x)
    d = p(4) * w - p(1) * x - p(2) * y - p(3) * z
    x = a
    y = b
    z = c
    w = d
  end subroutine multiply

  ! Replaces u by q u q^-1 = u + 2 w p x u + 2 p x (p x u), q = (p, w).
  pure subroutine rotate_vector(q, u)
    real(wp), intent(in) :: q(4)
    real(wp), intent(inout) :: u(3)
    real(wp) :: twice(3)

    twice = 2 * cross(q(1:3), u)
    u = u + q(4) * twice + cross(q(1:3), twice)
  end subroutine rotate_vector

  ! Multiplies a matrix, which is stored by rows, by the rotation of q, from the left or the right.
  pure subroutine rotate_matrix(q, left, y)
    real(wp), intent(in) :: q(4)
    logical, intent(in) :: left
    real(wp), intent(inout) :: y(3, 3)       ! rows
    real(wp) :: r(3, 3), twice(3)            ! r: rows of the rotation

    twice = 2 * q(1:3)
    r(1, 1) = 1 - (twice(2) * q(2) + twice(3) * q(3))
    r(2, 2) = 1 - (twice(1) * q(1) + twice(3) * q(3))
    r(3, 3) = 1 - (twice(1) * q(1) + twice(2) * q(2))
    r(2, 1) = twice(1) * q(2) - twice(3) * q(4)
    r(1, 2) = twice(1) * q(2) + twice(3) * q(4)
    r(3, 2) = twice(2) * q(3) - twice(1) * q(4)
    r(2, 3) = twice(2) * q(3) + twice(1) * q(4)
    r(1, 3) = twice(3) * q(1) - twice(2) * q(4)
    r(3, 1) = twice(3) * q(1) + twice(2) * q(4)
    if (left) then
      y = matmul(y, r)
    else
      y = matmul(r, y)
    end if
  end subroutine rotate_matrix

  ! On rotations [u, v] = side u x v, and ad^3 = -|u|^2 ad gives a closed form.
  pure subroutine dexpinv_rotation(side, u, v, exists)
    real(wp), intent(in) :: side, u(3)
    real(wp), intent(inout) :: v(3)
    logical, intent(inout) :: exists
    real(wp) :: square, fourth, half, once(3), factor

    square = u(1)**2 + u(2)**2 + u(3)**2
    once = cross(u, v)
    if (square >= half_turn**2) then
      if (norm2(once) <= zero_bracket * norm2(u) * norm2(v)) return
      if (square >= full_turn**2) then
        exists = .false.
        return
      end if
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
    v = v - (side / 2) * once + factor * cross(u, once)
  end subroutine dexpinv_rotation

  ! The cross product: a copy of that of vectors_m, which isn't inlined in another file
  pure function cross(u, v)
    real(wp), intent(in) :: u(3), v(3)
    real(wp) :: cross(3)

    cross(1) = u(2) * v(3) - u(3) * v(2)
    cross(2) = u(3) * v(1) - u(1) * v(3)
    cross(3) = u(1) * v(2) - u(2) * v(1)
  end function cross

end module rotations_m
