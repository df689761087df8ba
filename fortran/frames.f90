! Frames: manifolds with vector fields E_i whose flows are known. A frame is a product of blocks,
! each with its own manifold; points and coefficients of the blocks lie one after the other.
module frames_m
  use kinds, only: wp
  use shared_numbers, only: callback_block, euclidean_block, flow_operation, isospectral_block, &
                            linear_action_block, polynomial, quaternion_block, &
                            restore_operation, scalar_first, se3_block, &
                            so3_block, so_block, space_axes, sphere_block, su2_block, su_block, &
                            u_block
  use isospectral_m, only: move_isospectral, restore_isospectral
  use linear_action_m, only: linear_action_t, make_linear_action, move_linearly, &
                             move_polynomially
  use orthogonal_m, only: move_orthogonal, to_orthogonal
  use unitary_m, only: move_unitary, restore_unitary
  implicit none
  ! What flows call is private so that it is inlined; otherwise flows take a fifth longer.
  private
  public :: flow_sequence_t, frame_t, block_t, callback_t, make_frame, apply_flows, flow_along, &
            restore, get_quaternion, distance_bound

  ! Functions outside of compiled code, by their Operation
  type, abstract :: callback_t
  contains
    procedure(apply_i), deferred :: apply
  end type callback_t

  abstract interface

    ! Applies an operation to two arrays. The result is NaN where there is none.
    subroutine apply_i(self, operation, a, b, c)
      import :: callback_t, wp
      class(callback_t), intent(in) :: self
      integer, intent(in) :: operation
      real(wp), contiguous, intent(in) :: a(:), b(:)
      real(wp), contiguous, intent(inout) :: c(:)
    end subroutine apply_i

  end interface

  type :: block_t
    integer :: kind = 0
    logical :: space = .false.
    logical :: scalar_first = .false.
    logical :: polynomial = .false.
    integer :: n = 0            ! n of R^n, SO(n), SU(n), U(n), rows of isospectral matrices
    integer :: constants = 0    ! constants of the blocks before
    integer :: vectors = 0      ! coefficients of the blocks before
    integer :: points = 0       ! entries of the points of the blocks before
    integer :: dimension = 0    ! number of coefficients
    integer :: point_size = 0   ! number of entries of a point
    type(linear_action_t) :: action
  end type block_t

  ! Time-1 flows one after the other; flow j is along the sum of weight(k) times the field stage(k),
  ! over its terms k = first(j), ..., first(j + 1) - 1, at least one. For a polynomial block all
  ! are one flow: the sum of flow j is the coefficient of (2 t - 1)^(j - 1) in the field at time t.
  type :: flow_sequence_t
    integer, allocatable :: first(:)         ! (flows + 1)
    real(wp), allocatable :: weight(:)       ! (terms)
    integer, allocatable :: stage(:)         ! (terms)
  end type flow_sequence_t

  type :: frame_t
    integer :: dimension = 0
    integer :: point_size = 0
    real(wp), allocatable :: constants(:)    ! of all blocks, one after the other
    type(block_t), allocatable :: blocks(:)
    class(callback_t), pointer :: callback => null()
    type(flow_sequence_t) :: single          ! one flow along one field with weight 1
  end type frame_t

  ! Its square doesn't underflow, and sin(x) / x is exactly 1 there.
  real(wp), parameter :: smallest = sqrt(tiny(1.0_wp))

contains

  ! Makes the frame with the given blocks.
  subroutine make_frame(description, constants, frame)
    integer, intent(in) :: description(:, :)  ! (3, blocks): a BlockKind, n, a sum of BlockOptions
    real(wp), intent(in) :: constants(:)      ! of all blocks, or more
    type(frame_t), intent(out) :: frame
    integer :: i, length, used

    frame%constants = constants
    frame%single = flow_sequence_t(first=[1, 2], weight=[1.0_wp], stage=[1])
    allocate (frame%blocks(size(description, 2)))
    used = 0
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), options => description(3, i))
        block%kind = description(1, i)
        block%space = iand(options, space_axes) /= 0
        block%scalar_first = iand(options, scalar_first) /= 0
        block%polynomial = iand(options, polynomial) /= 0
        block%vectors = frame%dimension
        block%points = frame%point_size
        block%dimension = 3
        block%n = description(2, i)
        select case (block%kind)
        case (euclidean_block)
          block%dimension = block%n
          block%point_size = block%n
        case (so3_block)
          block%point_size = 9
        case (quaternion_block)
          block%point_size = 4
        case (se3_block)
          block%dimension = 6
          block%point_size = 16
        case (sphere_block)
          block%point_size = 3
        case (su2_block)
          block%point_size = 8
        case (so_block)
          block%dimension = block%n * (block%n - 1) / 2
          block%point_size = block%n**2
        case (su_block)
          block%dimension = block%n**2 - 1
          block%point_size = 2 * block%n**2
        case (u_block)
          block%dimension = block%n**2
          block%point_size = 2 * block%n**2
        case (isospectral_block)
          block%dimension = block%n * (block%n - 1) / 2
          block%point_size = block%n**2
          block%constants = used
          used = used + block%n
        case (linear_action_block)
          call make_linear_action(constants(used + 1:), block%action, length)
          block%dimension = block%action%generators
          block%point_size = block%action%point_size
          used = used + length
        case (callback_block)
          block%dimension = block%n
          block%point_size = options
        case default
          error stop 'make_frame: there is no such block'
        end select
        frame%dimension = frame%dimension + block%dimension
        frame%point_size = frame%point_size + block%point_size
      end associate
    end do
  end subroutine make_frame

  ! Moves y along the time-1 flow of the field with coefficients v.
  subroutine flow_along(frame, v, y)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: v(frame%dimension)
    real(wp), intent(inout) :: y(frame%point_size)

    call apply_flows(frame, frame%single, 1, 1, v, y)
  end subroutine flow_along

  ! Moves y along some flows of a sequence, in their order. Flows of different blocks commute, so
  ! each block is moved along all of them at once.
  subroutine apply_flows(frame, flows, begin, last, f, y)
    type(frame_t), intent(in) :: frame
    type(flow_sequence_t), intent(in) :: flows
    integer, intent(in) :: begin, last       ! flows; none if `last` is before `begin`
    real(wp), intent(in) :: f(frame%dimension, *)            ! (dimension, stages) the fields
    real(wp), intent(inout) :: y(frame%point_size)
    integer :: i, k

    if (last < begin) return
    k = flows%first(begin)
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), &
                 v => frame%blocks(i)%vectors, m => frame%blocks(i)%dimension, &
                 p => frame%blocks(i)%points)
        select case (block%kind)
        case (euclidean_block)
          call translate(m, flows%first(last + 1) - k, flows%weight(k), flows%stage(k), &
                         frame%dimension, f(v + 1, 1), y(p + 1))
        case (se3_block)
          call move_rigid_body(block, flows, begin, last, frame%dimension, f(v + 1, 1), y(p + 1))
        case (so_block, isospectral_block, su_block, u_block, linear_action_block, callback_block)
          call move_matrix(frame, block, flows, begin, last, f(v + 1, 1), y(p + 1))
        case default
          call rotate(block, flows, begin, last, frame%dimension, f(v + 1, 1), y(p + 1))
        end select
      end associate
    end do
  end subroutine apply_flows

  ! Adds all terms of all flows to a point of Euclidean space.
  pure subroutine translate(n, terms, weight, stage, m, f, y)
    integer, intent(in) :: n, terms
    real(wp), intent(in) :: weight(terms)
    integer, intent(in) :: stage(terms)
    integer, intent(in) :: m                 ! coefficients of the frame
    real(wp), intent(in) :: f(m, *)
    real(wp), intent(inout) :: y(n)
    integer :: k

    if (n == 3) then                         ! a size that the compiler knows
      do k = 1, terms
        y(1:3) = y(1:3) + weight(k) * f(1:3, stage(k))
      end do
    else
      do k = 1, terms
        y = y + weight(k) * f(1:n, stage(k))
      end do
    end if
  end subroutine translate

  ! Moves a matrix of any size, or a point whose flows are outside of compiled code.
  subroutine move_matrix(frame, block, flows, begin, last, f, y)
    type(frame_t), intent(in) :: frame
    type(block_t), intent(in) :: block
    type(flow_sequence_t), intent(in) :: flows
    integer, intent(in) :: begin, last
    real(wp), intent(in) :: f(frame%dimension, *)
    real(wp), intent(inout) :: y(block%point_size)
    real(wp) :: v(block%dimension, begin:last)               ! coefficients of each flow
    integer :: j, k

    do j = begin, last
      k = flows%first(j)
      v(:, j) = flows%weight(k) * f(:block%dimension, flows%stage(k))
      do k = k + 1, flows%first(j + 1) - 1
        v(:, j) = v(:, j) + flows%weight(k) * f(:block%dimension, flows%stage(k))
      end do
    end do
    select case (block%kind)
    case (so_block)
      call move_orthogonal(block%n, block%space, v, y)
    case (isospectral_block)
      call move_isospectral(block%n, v, y)
    case (su_block, u_block)
      call move_unitary(block%kind, block%n, block%space, v, y)
    case (linear_action_block)
      if (block%polynomial) then
        call move_polynomially(block%action, v, y)
      else
        call move_linearly(block%action, v, y)
      end if
    case (callback_block)
      call frame%callback%apply(flow_operation, reshape(v, [size(v)]), (y), y)
    end select
  end subroutine move_matrix

  ! Rotates a point by the product of the rotations of all flows, a quaternion of length 1 up to
  ! rounding.
  subroutine rotate(block, flows, begin, last, m, f, y)
    type(block_t), intent(in) :: block
    type(flow_sequence_t), intent(in) :: flows
    integer, intent(in) :: begin, last
    integer, intent(in) :: m                 ! coefficients of the frame
    real(wp), intent(in) :: f(m, *)
    real(wp), intent(inout) :: y(block%point_size)
    real(wp) :: q(4), e(4), half, sinc, side
    logical :: left
    integer :: j, k

    left = block%space .or. block%kind == sphere_block
    side = merge(1.0_wp, -1.0_wp, left)
    do j = begin, last
      k = flows%first(j)
      call exponential(combined(flows%first(j + 1) - k, flows%weight(k), flows%stage(k), m, f), e, &
                       half, sinc)
      if (j == begin) then
        q(1) = e(1)            ! one by one: loads of pairs would wait for the stores
        q(2) = e(2)
        q(3) = e(3)
        q(4) = e(4)
      else
        call multiply(side, e, q(1), q(2), q(3), q(4))
      end if
    end do

    select case (block%kind)
    case (so3_block)
      call rotate_matrix(q, left, y(1:3), y(4:6), y(7:9))
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
  end subroutine rotate

  ! The first three coefficients of a flow
  pure function combined(terms, weight, stage, m, f)
    integer, intent(in) :: terms, m
    real(wp), intent(in) :: weight(terms)
    integer, intent(in) :: stage(terms)
    real(wp), intent(in) :: f(m, *)
    real(wp) :: combined(3)
    integer :: k

    combined = weight(1) * f(1:3, stage(1))
    do k = 2, terms
      combined = combined + weight(k) * f(1:3, stage(k))
    end do
  end function combined

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

  ! Moves a rigid motion (R, x), y -> R y + x; the coefficients are a rotation vector and a
  ! velocity. One flow's motion is (exp hat v, V u), V the mean of exp(s hat v) over s from 0 to 1:
  ! V u = a u + (1 - a) n (n . u) + b n x u, where v = angle n, a = sin(angle) / angle and b = (1 -
  ! cos(angle)) / angle. Along the unit vector n nothing cancels that isn't small beside u.
  subroutine move_rigid_body(block, flows, begin, last, m, f, y)
    type(block_t), intent(in) :: block
    type(flow_sequence_t), intent(in) :: flows
    integer, intent(in) :: begin, last
    integer, intent(in) :: m                 ! coefficients of the frame
    real(wp), intent(in) :: f(m, *)
    real(wp), intent(inout) :: y(16)
    real(wp) :: q(4), e(4), x(3), u(3), v(3), n(3), half, sinc, a, b
    integer :: j, k

    q = [0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    x = 0.0_wp
    do j = begin, last
      k = flows%first(j)
      v = combined(flows%first(j + 1) - k, flows%weight(k), flows%stage(k), m, f)
      u = combined(flows%first(j + 1) - k, flows%weight(k), flows%stage(k), m, f(4, 1))
      call exponential(v, e, half, sinc)
      n = v / (2 * half)
      a = sinc * e(4)
      b = half * sinc**2
      u = a * u + (1 - a) * dot_product(n, u) * n + b * cross(n, u)
      if (block%space) then
        call rotate_vector(e, x)
        x = x + u
      else
        call rotate_vector(q, u)
        x = x + u
      end if
      call multiply(merge(1.0_wp, -1.0_wp, block%space), e, q(1), q(2), q(3), q(4))
    end do

    if (block%space) then
      u = [y(4), y(8), y(12)]
      call rotate_vector(q, u)
      u = u + x
    else
      u = [y(4) + dot_product(y(1:3), x), y(8) + dot_product(y(5:7), x), &
           y(12) + dot_product(y(9:11), x)]
    end if
    call rotate_matrix(q, block%space, y(1:3), y(5:7), y(9:11))
    y(4) = u(1)
    y(8) = u(2)
    y(12) = u(3)
  end subroutine move_rigid_body

  ! Removes rounding off the manifold from a point: one Newton-Schulz step, y -> (3 y - y y^T y) /
  ! 2, towards the nearest rotation or unit vector. It is the identity on the manifold and squares
  ! the distance; without it rounding errors accumulate. Eigenvalues of isospectral points are
  ! replaced.
  subroutine restore(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(inout) :: y(:)    ! (point_size)
    real(wp) :: q(4)
    integer :: i

    do i = 1, size(frame%blocks)
      associate (p => frame%blocks(i)%points, n => frame%blocks(i)%point_size)
        select case (frame%blocks(i)%kind)
        case (so3_block)
          call orthogonalise(y(p + 1:p + 3), y(p + 4:p + 6), y(p + 7:p + 9))
        case (se3_block)
          call orthogonalise(y(p + 1:p + 3), y(p + 5:p + 7), y(p + 9:p + 11))
        case (quaternion_block, sphere_block)
          y(p + 1:p + n) = (1.5_wp - 0.5_wp * dot_product(y(p + 1:p + n), y(p + 1:p + n))) &
                           * y(p + 1:p + n)
        case (so_block)
          call to_orthogonal(frame%blocks(i)%n, y(p + 1:p + n))
        case (isospectral_block)
          associate (m => frame%blocks(i)%n, k => frame%blocks(i)%constants)
            call restore_isospectral(m, frame%constants(k + 1:k + m), y(p + 1:p + n))
          end associate
        case (su_block, u_block)
          call restore_unitary(frame%blocks(i)%kind, frame%blocks(i)%n, y(p + 1:p + n))
        case (callback_block)
          call frame%callback%apply(restore_operation, (y), (y), y)
        case (su2_block)
          q = get_quaternion(frame%blocks(i), y(p + 1:p + n))
          q = (1.5_wp - 0.5_wp * dot_product(q, q)) * q
          call set_quaternion(q, y(p + 1:p + n))
        end select
      end associate
    end do
  end subroutine restore

  ! An upper bound of the distance of a point from the manifold, huge where none is cheap. Singular
  ! values s of a matrix y are within |s^2 - 1| of 1, and so within the norm of y y^T - 1.
  pure real(wp) function distance_bound(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)       ! (point_size)
    real(wp) :: last(4), q(4)
    integer :: i

    distance_bound = 0.0_wp
    do i = 1, size(frame%blocks)
      associate (p => frame%blocks(i)%points, n => frame%blocks(i)%point_size)
        select case (frame%blocks(i)%kind)
        case (euclidean_block)
          if (.not. all(abs(y(p + 1:p + n)) <= huge(y))) distance_bound = huge(distance_bound)
        case (so3_block)
          distance_bound = max(distance_bound, rotation_bound(y(p + 1:p + 3), y(p + 4:p + 6), &
                                                              y(p + 7:p + 9)))
        case (se3_block)
          last = abs(y(p + 13:p + 16) - [0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp])
          distance_bound = max(distance_bound, sum(last) &
                               + rotation_bound(y(p + 1:p + 3), y(p + 5:p + 7), y(p + 9:p + 11)))
          if (.not. all(abs(y(p + 1:p + 16)) <= huge(y))) distance_bound = huge(distance_bound)
        case (quaternion_block, sphere_block)
          distance_bound = max(distance_bound, &
                               abs(dot_product(y(p + 1:p + n), y(p + 1:p + n)) - 1))
        case (su2_block)
          q = get_quaternion(frame%blocks(i), y(p + 1:p + n))
          distance_bound = max(distance_bound, abs(dot_product(q, q) - 1), &
                               maxval(abs(y(p + 1:p + 2) - [y(p + 7), -y(p + 8)])), &
                               maxval(abs(y(p + 3:p + 4) + [y(p + 5), -y(p + 6)])))
        case default
          distance_bound = huge(distance_bound)
        end select
      end associate
    end do
    if (.not. distance_bound <= huge(distance_bound)) distance_bound = huge(distance_bound)
  end function distance_bound

  ! An upper bound of the distance of a matrix from the rotations
  pure real(wp) function rotation_bound(x, y, z)
    real(wp), intent(in) :: x(3), y(3), z(3)       ! rows of a matrix

    rotation_bound = abs(dot_product(x, x) - 1) + abs(dot_product(y, y) - 1) &
                     + abs(dot_product(z, z) - 1) + 2 * (abs(dot_product(x, y)) &
                     + abs(dot_product(y, z)) + abs(dot_product(z, x)))
    if (.not. dot_product(cross(x, y), z) > 0) rotation_bound = huge(rotation_bound)
  end function rotation_bound

  ! One Newton-Schulz step of a matrix of three rows
  pure subroutine orthogonalise(x, y, z)
    real(wp), intent(inout) :: x(3), y(3), z(3)    ! rows of a matrix near a rotation
    real(wp) :: xx, yy, zz, xy, yz, zx, old(3, 3)

    xx = 1.5_wp - 0.5_wp * dot_product(x, x)
    yy = 1.5_wp - 0.5_wp * dot_product(y, y)
    zz = 1.5_wp - 0.5_wp * dot_product(z, z)
    xy = -0.5_wp * dot_product(x, y)
    yz = -0.5_wp * dot_product(y, z)
    zx = -0.5_wp * dot_product(z, x)
    old(:, 1) = x
    old(:, 2) = y
    old(:, 3) = z
    x = xx * old(:, 1) + xy * old(:, 2) + zx * old(:, 3)
    y = xy * old(:, 1) + yy * old(:, 2) + yz * old(:, 3)
    z = zx * old(:, 1) + yz * old(:, 2) + zz * old(:, 3)
  end subroutine orthogonalise

  ! The unit quaternion (vector part, scalar part) of the rotation vector v. The quotient sin(x) / x
  ! is accurate to one or two roundings at every x, so that no series is needed near zero.
  pure subroutine exponential(v, e, half, sinc)
    real(wp), intent(in) :: v(3)
    real(wp), intent(out) :: e(4)
    real(wp), intent(out) :: half    ! of the angle
    real(wp), intent(out) :: sinc    ! sin(half) / half

    half = max(sqrt(v(1)**2 + v(2)**2 + v(3)**2) / 2, smallest)
    sinc = sin(half) / half
    e(1:3) = (sinc / 2) * v
    e(4) = cos(half)
  end subroutine exponential

  ! The quaternion q = (x, y, z; w) becomes p q where the side is 1, q p where it is -1.
  pure subroutine multiply(side, p, x, y, z, w)
    real(wp), intent(in) :: side
    real(wp), intent(in) :: p(4)
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

  ! The cross product
  pure function cross(u, v)
    real(wp), intent(in) :: u(3), v(3)
    real(wp) :: cross(3)

    cross(1) = u(2) * v(3) - u(3) * v(2)
    cross(2) = u(3) * v(1) - u(1) * v(3)
    cross(3) = u(1) * v(2) - u(2) * v(1)
  end function cross

  ! Rotates a vector by a unit quaternion.
  pure subroutine rotate_vector(q, u)
    real(wp), intent(in) :: q(4)
    real(wp), intent(inout) :: u(3)
    real(wp) :: twice(3)

    twice = 2 * cross(q(1:3), u)
    u = u + q(4) * twice + cross(q(1:3), twice)
  end subroutine rotate_vector

  ! Multiplies the matrix with rows x, y, z by the rotation of q, from the left or the right.
  pure subroutine rotate_matrix(q, left, x, y, z)
    real(wp), intent(in) :: q(4)
    logical, intent(in) :: left
    real(wp), intent(inout) :: x(3), y(3), z(3)
    real(wp) :: a(3), b(3), c(3)            ! rows of the rotation
    real(wp) :: old(3, 3), twice(3)

    twice = 2 * q(1:3)
    a(1) = 1 - (twice(2) * q(2) + twice(3) * q(3))
    b(2) = 1 - (twice(1) * q(1) + twice(3) * q(3))
    c(3) = 1 - (twice(1) * q(1) + twice(2) * q(2))
    a(2) = twice(1) * q(2) - twice(3) * q(4)
    b(1) = twice(1) * q(2) + twice(3) * q(4)
    b(3) = twice(2) * q(3) - twice(1) * q(4)
    c(2) = twice(2) * q(3) + twice(1) * q(4)
    c(1) = twice(3) * q(1) - twice(2) * q(4)
    a(3) = twice(3) * q(1) + twice(2) * q(4)
    if (left) then
      old(:, 1) = x
      old(:, 2) = y
      old(:, 3) = z
      x = a(1) * old(:, 1) + a(2) * old(:, 2) + a(3) * old(:, 3)
      y = b(1) * old(:, 1) + b(2) * old(:, 2) + b(3) * old(:, 3)
      z = c(1) * old(:, 1) + c(2) * old(:, 2) + c(3) * old(:, 3)
    else
      x = x(1) * a + x(2) * b + x(3) * c
      y = y(1) * a + y(2) * b + y(3) * c
      z = z(1) * a + z(2) * b + z(3) * c
    end if
  end subroutine rotate_matrix

end module frames_m
