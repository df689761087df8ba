! Joints of mechanical systems: constraints g(q) = 0 on configurations, their derivatives G along
! the fields, and the symmetric matrix G J^-1 G^T, by whose factors constraint forces are computed.
!
! Every joint is a few rows. A row is the dot product of two vectors of these three: d, from a point
! of the second body to one of the first, and one axis of each body. A body is an attitude and a
! position, one of which may be missing: then it turns about the origin, or is a point mass. The
! ground is body 0. Rows of one's own are evaluated in Python, and follow those of joints.
!
! Rows depend on few bodies, on the velocities between their first and their last one. The factor is
! that of Cholesky within the envelope of the matrix: each row from the first column that isn't zero
! on, so that chains cost time in proportion to their length if their joints follow each other.
module joints_m
  use kinds, only: wp
  use blocks_m, only: block_t, body_t, velocities
  use callback_m, only: callback_t
  use rotations_m, only: get_quaternion, rotate_matrix
  use shared_numbers, only: along_space, between_axes, coincident_axes, &
                            constraints_operation, fixed_length, so3_block
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
  end type row_t

  type :: linkage_t
    integer :: rows = 0, own = 0             ! rows of joints, and of one's own
    integer :: forces = 0                    ! momenta
    integer :: momenta_offset = 0            ! entries of a point before the momenta
    integer :: after = 0                     ! and up to their end
    integer, allocatable :: places(:, :)     ! (2, 0:bodies) attitude's and position's block, or 0
    type(row_t), allocatable :: row(:)
    integer, allocatable :: span(:, :)       ! (2, rows + own) the blocks of a row, first and last
    integer, allocatable :: v1(:), v2(:)     ! (rows + own) their velocities, first and last
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
    real(wp), allocatable :: min_scale(:)    ! (rows + own) those of own rows at points of size one
    ! (forces, rows + own) derivatives along the fields, and J^-1 times these
    real(wp), allocatable :: slope(:, :), moved(:, :)
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
    integer :: i, j, bodies                            ! blocks with inertia

    bodies = findloc(blocks%v1, forces + 1, 1) - 1
    linkage%rows = size(integers, 2)
    linkage%own = own
    linkage%forces = forces
    linkage%momenta_offset = blocks(bodies)%p2
    linkage%after = linkage%momenta_offset + forces
    allocate (linkage%places(2, 0:size(places, 2)), source=0)
    linkage%places(:, 1:) = places
    allocate (linkage%row(linkage%rows))
    linkage%span = spread([1, bodies], 2, linkage%rows + own)
    do i = 1, linkage%rows
      linkage%row(i) = row_t(integers(1, i), integers(2:3, i), reshape(numbers(1:6, i), [3, 2]), &
                             reshape(numbers(7:12, i), [3, 2]), numbers(13, i))
      associate (block => linkage%places(:, integers(2:3, i)))
        linkage%span(:, i) = [minval(block, block > 0), maxval(block)]
      end associate
    end do
    linkage%v1 = blocks(linkage%span(1, :))%v1
    linkage%v2 = blocks(linkage%span(2, :))%v2
    linkage%first = [(findloc(linkage%v1(:i) <= linkage%v2(i) &
                              .and. linkage%v2(:i) >= linkage%v1(i), .true., 1), &
                      i=1, size(linkage%v1))]
    linkage%start = [(sum([(j - linkage%first(j), j=1, i)]), i=1, linkage%rows + own)]
  end subroutine make_linkage

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
    real(wp) :: axis(3, 2)                   ! axes of a row
    ! the two vectors of a row, what turns of the first one with the first body, and of the second
    ! one with each, and the factors of their positions in the second one
    real(wp) :: left(3), right(3), turned(3), lever(3, 2), side(2)
    integer :: i

    if (.not. allocated(c%g)) then
      associate (n => linkage%rows + linkage%own, m => linkage%forces)
        allocate (c%g(n), c%bias(n), c%factor(linkage%start(n) + n))
        allocate (c%scale(n), source=1.0_wp)
        allocate (c%min_scale(n), c%slope(m, n), c%moved(m, n), source=0.0_wp)
      end associate
    end if
    failed = .false.
    c%exchanged = .false.
    axis = 0.0_wp
    if (depth == 2) call velocities(blocks, bodies, [1, size(bodies)], &
                                    y(linkage%momenta_offset + 1:linkage%after), omega)
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
    if (linkage%own > 0) call evaluate_own(linkage, y, omega, depth, c, failed)
    if (depth == 0) return
    do i = 1, size(c%g)
      associate (v => linkage%v1(i), last => linkage%v2(i))
        call velocities(blocks, bodies, linkage%span(:, i), c%slope(v:last, i), c%moved(v:last, i))
      end associate
    end do

  contains

    ! Evaluates a row of a joint: d, the axes, and the row as the dot product of two of them.
    subroutine evaluate_row(i, row)
      integer, intent(in) :: i
      type(row_t), intent(in) :: row
      ! points of the bodies from their positions and from the origin, and between both
      real(wp) :: arm(3, 2), end(3, 2), d(3)
      real(wp) :: before(3)                  ! the second axis of the row before
      integer :: j

      do j = 1, 2
        arm(:, j) = matmul(r(:, :, row%body(j)), row%point(:, j))
        end(:, j) = x(:, row%body(j)) + arm(:, j)
      end do
      d = end(:, 1) - end(:, 2)
      before = axis(:, 2)
      axis = row%axis
      if (row%form /= along_space) axis(:, 1) = matmul(r(:, :, row%body(1)), axis(:, 1))
      axis(:, 2) = matmul(r(:, :, row%body(2)), axis(:, 2))
      ! the row before has the axis of the second body that shall coincide with that of the first
      if (row%form == coincident_axes) &
        c%exchanged = c%exchanged .or. dot_product(axis(:, 1), before) < 0.5_wp
      left = axis(:, 1)
      right = d
      lever(:, 1) = arm(:, 1)
      lever(:, 2) = -arm(:, 2)
      side = [1.0_wp, -1.0_wp]
      turned = 0.0_wp
      if (row%form /= along_space) turned = left
      c%scale(i) = maxval(abs(end)) + maxval(abs(arm))
      select case (row%form)
      case (between_axes, coincident_axes)
        right = axis(:, 2)
        lever(:, 1) = 0.0_wp
        lever(:, 2) = right
        side = 0.0_wp
        c%scale(i) = 1.0_wp
      case (fixed_length)
        left = d / row%length
        turned = 0.0_wp
      end select
      c%g(i) = dot_product(left, right)
      if (row%form == fixed_length) &
        c%g(i) = (dot_product(d, d) - row%length**2) / (2 * row%length)
      if (depth > 0) call find_slopes(i, row)
      if (depth > 1) c%bias(i) = second_derivative(row)
    end subroutine evaluate_row

    ! Finds the derivatives of a row along the fields of its bodies.
    subroutine find_slopes(i, row)
      integer, intent(in) :: i
      type(row_t), intent(in) :: row
      real(wp) :: torque(3)
      integer :: j

      do j = 1, 2
        associate (turns => linkage%places(1, row%body(j)), moves => linkage%places(2, row%body(j)))
          if (moves > 0) c%slope(blocks(moves)%v1:blocks(moves)%v2, i) = side(j) * left
          if (turns == 0) cycle
          torque = cross(lever(:, j), left)
          if (j == 1) torque = torque + cross(turned, right)
          if (.not. blocks(turns)%space) torque = matmul(torque, r(:, :, row%body(j)))
          c%slope(blocks(turns)%v1:blocks(turns)%v2, i) = torque
        end associate
      end do
    end subroutine find_slopes

    ! The second derivative of a row whose vectors turn with constant angular velocities
    pure real(wp) function second_derivative(row)
      type(row_t), intent(in) :: row
      real(wp), dimension(3) :: left1, left2, right1, right2, swing    ! derivatives by time
      integer :: j

      left1 = cross(turning(:, row%body(1)), turned)
      left2 = cross(turning(:, row%body(1)), left1)
      right1 = 0.0_wp
      right2 = 0.0_wp
      do j = 1, 2
        swing = cross(turning(:, row%body(j)), lever(:, j))
        right1 = right1 + side(j) * velocity(:, row%body(j)) + swing
        right2 = right2 + cross(turning(:, row%body(j)), swing)
      end do
      if (row%form == fixed_length) left1 = right1 / (2 * row%length)  ! both vectors are d
      second_derivative = dot_product(left2, right) + 2 * dot_product(left1, right1) &
                          + dot_product(left, right2)
    end function second_derivative

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
        r = reshape(y(k:k + 8), [3, 3])
      else
        call rotate_matrix(get_quaternion(block, y(k:k + 3)), .false., r)
      end if
      r = transpose(r)                       ! from rows
    end associate
  end subroutine place

  ! Evaluates the rows of one's own.
  subroutine evaluate_own(linkage, y, omega, depth, c, failed)
    type(linkage_t), intent(in) :: linkage
    real(wp), contiguous, intent(in) :: y(:), omega(:)
    integer, intent(in) :: depth
    type(constraints_t), intent(inout) :: c
    logical, intent(out) :: failed
    real(wp) :: answer(linkage%own * (1 + min(depth, 1) * (2 + linkage%forces) + depth / 2))

    associate (n => linkage%own, m => linkage%forces, rows => linkage%rows)
      call linkage%python%apply(constraints_operation, [real(depth, wp), omega], &
                                y(:linkage%momenta_offset), answer, failed)
      c%g(rows + 1:) = answer(:n)
      if (depth == 0) return
      c%scale(rows + 1:) = answer(n + 1:2 * n)
      c%min_scale(rows + 1:) = answer(2 * n + 1:3 * n)
      c%slope(:, rows + 1:) = reshape(answer(3 * n + 1:3 * n + n * m), [m, n])
      if (depth > 1) c%bias(rows + 1:) = answer(3 * n + n * m + 1:)
    end associate
  end subroutine evaluate_own

  ! Factors G J^-1 G^T, whose rows have been evaluated.
  pure subroutine factor_constraints(linkage, c)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(inout) :: c            ! known becomes false where it is singular
    real(wp), parameter :: min_rest = 1e3_wp * epsilon(1.0_wp)
    real(wp) :: entry, rest                  ! of G J^-1 G^T, and without the columns before
    integer :: i, j, k, v, last

    c%known = .false.
    associate (l => c%factor, start => linkage%start, first => linkage%first)
      do i = 1, size(c%g)
        entry = 0.0_wp
        rest = 0.0_wp
        do j = first(i), i
          v = max(linkage%v1(i), linkage%v1(j))
          last = min(linkage%v2(i), linkage%v2(j))
          k = max(first(i), first(j))
          entry = dot_product(c%slope(v:last, i), c%moved(v:last, j))
          rest = entry - dot_product(l(start(i) + k:start(i) + j - 1), &
                                     l(start(j) + k:start(j) + j - 1))
          if (j < i) l(start(i) + j) = rest / l(start(j) + j)
        end do
        if (.not. rest > min_rest * entry) return
        l(start(i) + i) = sqrt(rest)
      end do
    end associate
    c%known = .true.
  end subroutine factor_constraints

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

  ! G or G J^-1 times a vector of velocities, forces or momenta
  pure function rates(linkage, derivatives, vector)
    type(linkage_t), intent(in) :: linkage
    real(wp), intent(in) :: derivatives(:, :)          ! slope, or moved
    real(wp), intent(in) :: vector(:)                  ! (forces)
    real(wp) :: rates(size(linkage%v1))
    integer :: i

    do i = 1, size(rates)
      associate (v => linkage%v1(i), last => linkage%v2(i))
        rates(i) = dot_product(derivatives(v:last, i), vector(v:last))
      end associate
    end do
  end function rates

  ! Adds G^T x to momenta, or J^-1 G^T x to velocities.
  pure subroutine constraint_impulse(linkage, derivatives, x, vector)
    type(linkage_t), intent(in) :: linkage
    real(wp), intent(in) :: derivatives(:, :)          ! slope, or moved
    real(wp), intent(in) :: x(:)
    real(wp), intent(inout) :: vector(:)               ! (forces)
    integer :: i

    do i = 1, size(x)
      associate (v => linkage%v1(i), last => linkage%v2(i))
        vector(v:last) = vector(v:last) + x(i) * derivatives(v:last, i)
      end associate
    end do
  end subroutine constraint_impulse

end module joints_m
