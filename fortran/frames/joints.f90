! Joints of mechanical systems: constraints g(q) = 0 on configurations, their derivatives G along the
! fields, and the symmetric matrix G J^-1 G^T, by whose factors constraint forces are computed.
!
! Every joint is a few rows. A row is the dot product of two vectors of these three: d, from a point
! of the second body to one of the first, and one axis of each body. A body is an attitude and a
! position, one of which may be missing: then it turns about the origin, or is a point mass. The
! ground is body 0. Rows of one's own are evaluated in Python, and follow those of joints.
!
! Rows depend on few bodies. The factor is that of Cholesky within the envelope of the matrix: each
! row from the first column that isn't zero on, so that chains cost time in proportion to their
! length if their joints follow each other.
module joints_m
  use kinds, only: wp
  use blocks_m, only: block_t, body_t, find_velocities
  use callback_m, only: callback_t
  use rotations_m, only: get_quaternion, rotate_matrix
  use shared_numbers, only: along_body, along_space, between_axes, coincident_axes, &
                            constraints_operation, euclidean_block, fixed_length, so3_block
  use vectors_m, only: cross
  implicit none
  private
  public :: constraints_t, linkage_t, constraint_impulse, evaluate_constraints, &
            factor_constraints, make_linkage, rates, solve_constraints

  type :: row_t
    integer :: form = 0                      ! a RowForm
    integer :: body(2) = 0
    real(wp) :: point(3, 2) = 0.0_wp         ! in the axes of each body
    real(wp) :: axis(3, 2) = 0.0_wp
    real(wp) :: length = 0.0_wp              ! the fixed length
    logical :: repeats = .false.             ! whether the row before has the same bodies and points
  end type row_t

  type :: linkage_t
    integer :: rows = 0, own = 0             ! rows of joints, and of one's own
    integer :: forces = 0                    ! momenta
    integer :: before = 0                    ! entries of a point before the momenta
    integer :: after = 0                     ! and up to their end
    integer, allocatable :: places(:, :)     ! (2, 0:bodies) blocks of attitude and position, 0 for none
    type(row_t), allocatable :: row(:)
    integer, allocatable :: block(:, :)      ! (4, rows) attitudes and positions of both bodies
    integer, allocatable :: field(:, :)      ! (4, rows) velocities before theirs, -1 for none
    integer, allocatable :: first(:)         ! (rows + own) the first column in the envelope
    integer, allocatable :: start(:)         ! (rows + own) its place in the factor, less one
    type(callback_t) :: python               ! evaluates rows of one's own
  end type linkage_t

  ! The constraints at a point
  type :: constraints_t
    logical :: known = .false.               ! whether the factor is that of the present point
    ! whether axes that shall coincide are opposite or exchanged, which their cosines allow too
    logical :: exchanged = .false.
    real(wp), allocatable :: g(:)            ! (rows + own)
    real(wp), allocatable :: bias(:)         ! (rows + own) second derivative at constant velocities
    real(wp), allocatable :: scale(:)        ! (rows + own) lengths that g is a difference of
    real(wp), allocatable :: least(:)        ! (rows + own) those of own rows at points of size one
    ! (3, 4, rows) derivatives along the fields of the blocks of a row, and J^-1 times these
    real(wp), allocatable :: slope(:, :, :), moved(:, :, :)
    real(wp), allocatable :: own(:, :), own_moved(:, :)      ! (forces, own) the same of own rows
    real(wp), allocatable :: factor(:)
  end type constraints_t

contains

  ! Makes the linkage of a frame with bodies. The columns of the table are rows: form and two bodies
  ! as integers; two points, two axes and a length as numbers.
  subroutine make_linkage(blocks, forces, places, integers, numbers, own, linkage)
    type(block_t), intent(in) :: blocks(:)
    integer, intent(in) :: forces, own
    integer, intent(in) :: places(:, :)      ! (2, bodies) blocks of attitude and position
    integer, intent(in) :: integers(:, :)    ! (3, rows)
    real(wp), intent(in) :: numbers(:, :)    ! (13, rows)
    type(linkage_t), intent(inout) :: linkage
    integer :: i, j

    linkage%rows = size(integers, 2)
    linkage%own = own
    linkage%forces = forces
    linkage%before = blocks(findloc(blocks%v1, forces + 1, 1))%p1 - 1
    linkage%after = linkage%before + forces
    allocate (linkage%places(2, 0:size(places, 2)), source=0)
    linkage%places(:, 1:) = places
    allocate (linkage%row(linkage%rows), linkage%block(4, linkage%rows), &
              linkage%field(4, linkage%rows))
    do i = 1, linkage%rows
      linkage%row(i) = row_t(integers(1, i), integers(2:3, i), reshape(numbers(1:6, i), [3, 2]), &
                             reshape(numbers(7:12, i), [3, 2]), numbers(13, i))
      if (i > 1) linkage%row(i)%repeats = all(integers(2:, i - 1) == integers(2:, i)) &
                                          .and. .not. any(abs(numbers(:6, i - 1) - numbers(:6, i)) > 0)
      linkage%block(:, i) = reshape(linkage%places(:, integers(2:3, i)), [4])
      associate (block => linkage%block(:, i))
        linkage%field(:, i) = merge(blocks(max(block, 1))%v1 - 1, -1, block > 0)
      end associate
    end do
    linkage%first = [(findloc([(coupled(linkage%block(:, i), linkage%block(:, j)), j=1, i)], &
                              .true., 1), i=1, linkage%rows), spread(1, 1, own)]
    linkage%start = [(sum([(j - linkage%first(j), j=1, i)]), i=1, linkage%rows + own)]
  end subroutine make_linkage

  ! Whether two rows depend on a block that both have
  pure logical function coupled(a, b)
    integer, intent(in) :: a(4), b(4)
    integer :: i

    coupled = any([(a(i) > 0 .and. any(b == a(i)), i = 1, 4)])
  end function coupled

  ! Evaluates the constraints at a point: g alone, or with derivatives, or with the bias too.
  subroutine evaluate_constraints(linkage, blocks, bodies, y, depth, c, failed)
    type(linkage_t), intent(in) :: linkage
    type(block_t), intent(in) :: blocks(:)
    type(body_t), intent(in) :: bodies(:)
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) or more
    integer, intent(in) :: depth                       ! 0 for g, 1 with G, 2 with the bias
    type(constraints_t), intent(inout) :: c
    logical, intent(out) :: failed                     ! whether Python raised an exception
    real(wp), dimension(3, 0:ubound(linkage%places, 2)) :: x, velocity, turning
    real(wp) :: r(3, 3, 0:ubound(linkage%places, 2)), omega(merge(linkage%forces, 0, depth == 2))
    ! points of a row and of those that repeat them, from the bodies and from the origin
    real(wp) :: arm(3, 2), end(3, 2), d(3), length
    real(wp) :: axis(3, 2), n(3)             ! axes of a row, and its derivative along d
    integer :: carrier(2)                    ! bodies that the axes are fixed in
    integer :: i, k

    call reserve(linkage, c)
    failed = .false.
    c%exchanged = .false.
    axis = 0.0_wp
    if (depth == 2) call velocities(blocks, bodies, y(linkage%before + 1:linkage%after), omega)
    velocity = 0.0_wp
    turning = 0.0_wp
    do i = 0, ubound(linkage%places, 2)
      associate (turns => linkage%places(1, i), moves => linkage%places(2, i))
        call place(blocks, turns, moves, y, x(:, i), r(:, :, i))
        if (depth < 2) cycle
        if (moves > 0) velocity(:, i) = omega(blocks(moves)%v1:blocks(moves)%v2)
        if (turns == 0) cycle
        turning(:, i) = omega(blocks(turns)%v1:blocks(turns)%v2)
        if (.not. blocks(turns)%space) turning(:, i) = matmul(r(:, :, i), turning(:, i))
      end associate
    end do
    do i = 1, linkage%rows
      call evaluate_row(i, linkage%row(i))
    end do
    if (linkage%own > 0) call evaluate_own(linkage, blocks, y, omega, depth, c, failed)
    if (depth == 0) return
    do i = 1, linkage%rows
      do k = 1, 4
        if (linkage%block(k, i) > 0) call find_velocities(bodies(linkage%block(k, i)), 3, &
                                                          c%slope(:, k, i), c%moved(:, k, i))
      end do
    end do
    do i = 1, linkage%own
      call velocities(blocks, bodies, c%own(:, i), c%own_moved(:, i))
    end do

  contains

    ! Evaluates a row of a joint: d, the axes, and the row as their dot product.
    subroutine evaluate_row(i, row)
      integer, intent(in) :: i
      type(row_t), intent(in) :: row
      real(wp) :: before(3)                  ! the second axis of the row before
      integer :: j

      if (.not. row%repeats) then
        do j = 1, 2
          arm(:, j) = matmul(r(:, :, row%body(j)), row%point(:, j))
          end(:, j) = x(:, row%body(j)) + arm(:, j)
        end do
        d = end(:, 1) - end(:, 2)
        length = maxval(abs(end)) + maxval(abs(arm))
      end if
      carrier = merge(0, row%body, row%form == along_space)
      before = axis(:, 2)
      axis = row%axis
      do j = 1, 2
        if (carrier(j) > 0) axis(:, j) = matmul(r(:, :, carrier(j)), axis(:, j))
      end do
      ! each of three rows has the next axis of the second body
      if (any(linkage%row(max(1, i - 2):i - 1)%form == coincident_axes)) &
        c%exchanged = c%exchanged .or. dot_product(axis(:, 1), before) < 0.5_wp
      c%scale(i) = length
      select case (row%form)
      case (along_space, along_body)
        c%g(i) = dot_product(axis(:, 1), d)
        n = axis(:, 1)
      case (between_axes, coincident_axes)
        c%g(i) = dot_product(axis(:, 1), axis(:, 2))
        c%scale(i) = 1.0_wp
        n = 0.0_wp
      case (fixed_length)
        c%g(i) = (dot_product(d, d) - row%length**2) / (2 * row%length)
        n = d / row%length
      end select
      if (depth > 0) call find_slopes(i, row)
      if (depth > 1) call find_bias(i, row)
    end subroutine evaluate_row

    ! Finds the derivatives of a row along the fields of its bodies.
    subroutine find_slopes(i, row)
      integer, intent(in) :: i
      type(row_t), intent(in) :: row
      real(wp) :: torque(3)
      integer :: j

      do j = 1, 2
        c%slope(:, 2 * j, i) = merge(n, -n, j == 1)
        torque = cross(arm(:, j), c%slope(:, 2 * j, i))
        if (row%form == between_axes .or. row%form == coincident_axes) &
          torque = cross(axis(:, j), axis(:, 3 - j))
        if (row%form == along_body .and. j == 1) torque = torque + cross(axis(:, 1), d)
        associate (turns => linkage%places(1, row%body(j)))
          if (turns == 0) cycle
          if (.not. blocks(turns)%space) torque = matmul(torque, r(:, :, row%body(j)))
        end associate
        c%slope(:, 2 * j - 1, i) = torque
      end do
    end subroutine find_slopes

    ! Finds the second derivative of a row whose vectors turn with constant angular velocities.
    subroutine find_bias(i, row)
      integer, intent(in) :: i
      type(row_t), intent(in) :: row
      real(wp) :: first(3, 2), second(3, 2)            ! derivatives of the axes by time
      real(wp) :: d1(3), d2(3), swing(3), side         ! and those of d
      integer :: j

      first = 0.0_wp
      second = 0.0_wp
      d1 = 0.0_wp
      d2 = 0.0_wp
      do j = 1, 2
        side = merge(1.0_wp, -1.0_wp, j == 1)
        swing = cross(turning(:, row%body(j)), arm(:, j))
        d1 = d1 + side * (velocity(:, row%body(j)) + swing)
        d2 = d2 + side * cross(turning(:, row%body(j)), swing)
        if (carrier(j) == 0) cycle
        first(:, j) = cross(turning(:, carrier(j)), axis(:, j))
        second(:, j) = cross(turning(:, carrier(j)), first(:, j))
      end do
      select case (row%form)
      case (along_space, along_body)
        c%bias(i) = dot_product(second(:, 1), d) + 2 * dot_product(first(:, 1), d1) &
                    + dot_product(axis(:, 1), d2)
      case (between_axes, coincident_axes)
        c%bias(i) = dot_product(second(:, 1), axis(:, 2)) &
                    + 2 * dot_product(first(:, 1), first(:, 2)) + dot_product(axis(:, 1), second(:, 2))
      case (fixed_length)
        c%bias(i) = (dot_product(d1, d1) + dot_product(d, d2)) / row%length
      end select
    end subroutine find_bias

  end subroutine evaluate_constraints

  ! The position of a body, and the matrix that turns vectors of the body into those of space
  pure subroutine place(blocks, attitude, position, y, x, r)
    type(block_t), intent(in) :: blocks(:)
    integer, intent(in) :: attitude, position          ! blocks, 0 for none
    real(wp), contiguous, intent(in) :: y(:)
    real(wp), intent(out) :: x(3), r(3, 3)
    real(wp), parameter :: identity(3, 3) = reshape(real([1, 0, 0, 0, 1, 0, 0, 0, 1], wp), [3, 3])

    x = 0.0_wp
    if (position > 0) x = y(blocks(position)%p1:blocks(position)%p2)
    r = identity
    if (attitude == 0) return
    associate (block => blocks(attitude), k => blocks(attitude)%p1)
      if (block%kind == so3_block) then
        r(1, :) = y(k:k + 2)
        r(2, :) = y(k + 3:k + 5)
        r(3, :) = y(k + 6:k + 8)
      else
        call rotate_matrix(get_quaternion(block, y(k:k + 3)), .false., r(1, :), r(2, :), r(3, :))
      end if
    end associate
  end subroutine place

  ! Evaluates the rows of one's own. Their size is the sum of the terms of their derivatives along
  ! the point, with a scale of one for angles and that of the largest entry for positions.
  subroutine evaluate_own(linkage, blocks, y, omega, depth, c, failed)
    type(linkage_t), intent(in) :: linkage
    type(block_t), intent(in) :: blocks(:)
    real(wp), contiguous, intent(in) :: y(:), omega(:)
    integer, intent(in) :: depth
    type(constraints_t), intent(inout) :: c
    logical, intent(out) :: failed
    real(wp) :: answer(linkage%own * (1 + min(depth, 1) * linkage%forces + depth / 2))
    real(wp) :: scale(linkage%forces), length
    logical :: moves(linkage%forces)                   ! positions
    integer :: i

    associate (n => linkage%own, m => linkage%forces)
      call linkage%python%apply(constraints_operation, [real(depth, wp), omega], &
                                y(:linkage%before), answer, failed)
      c%g(linkage%rows + 1:) = answer(:n)
      if (depth == 0) return
      c%own = reshape(answer(n + 1:n + n * m), [m, n])
      if (depth > 1) c%bias(linkage%rows + 1:) = answer(n + n * m + 1:)
      length = 0.0_wp
      moves = .false.
      do i = 1, size(blocks)
        associate (b => blocks(i))
          if (b%kind /= euclidean_block .or. b%v1 > m) cycle
          length = max(length, maxval(abs(y(b%p1:b%p2))))
          moves(b%v1:b%v2) = .true.
        end associate
      end do
      scale = merge(length, 1.0_wp, moves)
      do i = 1, n
        c%scale(linkage%rows + i) = sum(abs(c%own(:, i)) * scale)
        c%least(linkage%rows + i) = sum(abs(c%own(:, i)))
      end do
    end associate
  end subroutine evaluate_own

  ! Allocates the memory for constraints once.
  subroutine reserve(linkage, c)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(inout) :: c

    if (allocated(c%g)) return
    associate (n => linkage%rows + linkage%own, m => linkage%forces)
      allocate (c%g(n), c%bias(n), c%scale(n), c%least(n), c%slope(3, 4, linkage%rows), &
                c%moved(3, 4, linkage%rows), c%own(m, linkage%own), c%own_moved(m, linkage%own), &
                c%factor(linkage%start(n) + n))
    end associate
    c%scale = 1.0_wp
    c%least = 0.0_wp
  end subroutine reserve

  ! Velocities of all bodies
  pure subroutine velocities(blocks, bodies, momenta, omega)
    type(block_t), intent(in) :: blocks(:)
    type(body_t), intent(in) :: bodies(:)
    real(wp), intent(in) :: momenta(:)
    real(wp), intent(out) :: omega(:)
    integer :: i

    do i = 1, size(bodies)
      associate (v => blocks(i)%v1, last => blocks(i)%v2)
        call find_velocities(bodies(i), last - v + 1, momenta(v:last), omega(v:last))
      end associate
    end do
  end subroutine velocities

  ! Factors G J^-1 G^T, whose rows have been evaluated.
  pure subroutine factor_constraints(linkage, c)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(inout) :: c            ! known becomes false where it is singular
    real(wp), parameter :: least = 1e3_wp * epsilon(1.0_wp)
    real(wp) :: sum, diagonal
    integer :: i, j, k

    c%known = .false.
    associate (l => c%factor, start => linkage%start, first => linkage%first)
      do i = 1, size(c%g)
        do j = first(i), i - 1
          k = max(first(i), first(j))
          l(start(i) + j) = (entry(linkage, c, i, j) &
                             - dot_product(l(start(i) + k:start(i) + j - 1), &
                                           l(start(j) + k:start(j) + j - 1))) / l(start(j) + j)
        end do
        diagonal = entry(linkage, c, i, i)
        associate (row => l(start(i) + first(i):start(i) + i - 1))
          sum = diagonal - dot_product(row, row)
        end associate
        if (.not. sum > least * diagonal) return
        l(start(i) + i) = sqrt(sum)
      end do
    end associate
    c%known = .true.
  end subroutine factor_constraints

  ! The entry of G J^-1 G^T in row i and column j <= i
  pure real(wp) function entry(linkage, c, i, j)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(in) :: c
    integer, intent(in) :: i, j
    integer :: k, l

    entry = 0.0_wp
    if (j > linkage%rows) then
      entry = dot_product(c%own(:, i - linkage%rows), c%own_moved(:, j - linkage%rows))
      return
    end if
    do k = 1, 4
      associate (v => linkage%field(k, j))
        if (v < 0) cycle
        if (i > linkage%rows) then
          entry = entry + dot_product(c%own(v + 1:v + 3, i - linkage%rows), c%moved(:, k, j))
          cycle
        end if
        do l = 1, 4
          if (linkage%field(l, i) == v) &
            entry = entry + dot_product(c%slope(:, l, i), c%moved(:, k, j))
        end do
      end associate
    end do
  end function entry

  ! Solves G J^-1 G^T x = b by the factor.
  pure subroutine solve_constraints(linkage, c, x)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(in) :: c
    real(wp), intent(inout) :: x(:)                    ! b, then the solution
    integer :: i

    associate (l => c%factor, start => linkage%start, first => linkage%first)
      do i = 1, size(x)
        x(i) = (x(i) - dot_product(l(start(i) + first(i):start(i) + i - 1), x(first(i):i - 1))) &
               / l(start(i) + i)
      end do
      do i = size(x), 1, -1
        x(i) = x(i) / l(start(i) + i)
        x(first(i):i - 1) = x(first(i):i - 1) - x(i) * l(start(i) + first(i):start(i) + i - 1)
      end do
    end associate
  end subroutine solve_constraints

  ! G J^-1 times a vector of forces or momenta, by the derivatives that J^-1 was applied to
  pure function rates(linkage, c, momenta)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(in) :: c
    real(wp), intent(in) :: momenta(:)
    real(wp) :: rates(size(c%g))
    integer :: i, k

    rates = 0.0_wp
    do i = 1, linkage%rows
      do k = 1, 4
        associate (v => linkage%field(k, i))
          if (v >= 0) rates(i) = rates(i) + dot_product(c%moved(:, k, i), momenta(v + 1:v + 3))
        end associate
      end do
    end do
    do i = 1, linkage%own
      rates(linkage%rows + i) = dot_product(c%own_moved(:, i), momenta)
    end do
  end function rates

  ! Adds G^T x to momenta, or J^-1 G^T x to velocities.
  pure subroutine constraint_impulse(linkage, c, moved, x, vector)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(in) :: c
    logical, intent(in) :: moved                       ! whether by J^-1
    real(wp), intent(in) :: x(:)
    real(wp), intent(inout) :: vector(:)               ! (forces)
    integer :: i, k

    do i = 1, linkage%rows
      do k = 1, 4
        associate (v => linkage%field(k, i))
          if (v >= 0) vector(v + 1:v + 3) = vector(v + 1:v + 3) &
            + x(i) * merge(c%moved(:, k, i), c%slope(:, k, i), moved)
        end associate
      end do
    end do
    do i = 1, linkage%own
      vector = vector + x(linkage%rows + i) * merge(c%own_moved(:, i), c%own(:, i), moved)
    end do
  end subroutine constraint_impulse

end module joints_m
