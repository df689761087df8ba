! Joints of mechanical systems: constraints g(q) = 0 on configurations, their derivatives G along
! the fields, and the symmetric matrix G J^-1 G^T, by whose factors constraint forces are computed.
!
! Every joint is a few rows, dot products of vectors that RowForm in cg/support/shared_numbers.py
! lists. A body is an attitude and a position, one of which may be missing: then it turns about the
! origin, or is a point mass. The ground is body 0. The user's rows, which are evaluated in Python,
! follow those of joints.
!
! Rows depend on few bodies, on the velocities between their first and their last one. Cholesky's
! factor is stored within the envelope of the matrix (A. George, J. W. Liu, Computer Solution of
! Large Sparse Positive Definite Systems, 1981, chapter 4): each row from its first nonzero column
! on, so that chains cost time in proportion to their length if their joints follow each other.
module joints_m
  use kinds, only: wp
  use blocks_m, only: block_t, body_t, velocities
  use callback_m, only: callback_t
  use rotations_m, only: get_quaternion, rotate_matrix
  use shared_numbers, only: along_space, between_axes, coincident_axes, constraints_operation, &
                            fixed_length, no_stop, out_of_memory, raised, so3_block
  use vectors_m, only: cross
  implicit none
  private
  public :: constraints_t, linkage_t, constraint_impulse, evaluate_constraints, &
            factor_constraints, make_linkage, rates, solve_constraints

  type :: row_t
    integer :: form = 0                      ! a RowForm
    integer :: body(2) = 0
    real(wp) :: point(3, 2) = 0.0_wp         ! points in the axes of each body
    real(wp) :: axis(3, 2) = 0.0_wp
    real(wp) :: length = 0.0_wp              ! the fixed length
  end type row_t

  type :: linkage_t
    integer :: joint_rows = 0, user_rows = 0
    integer :: forces = 0                    ! number of momenta
    integer :: momenta_offset = 0, momenta_end = 0     ! entries of a point before and up to them
    ! (0:bodies) the blocks of attitudes and positions, 0 where a body has none
    integer, allocatable :: attitude(:), position(:)
    type(row_t), allocatable :: row(:)       ! (joint_rows)
    integer, allocatable :: span(:, :)       ! (2, rows) the blocks of a row, first and last
    integer, allocatable :: v1(:), v2(:)     ! (rows) velocities of these blocks, first and last
    integer, allocatable :: first_column(:)  ! (rows) the first column in the envelope
    integer, allocatable :: row_start(:)     ! (rows) entries of the factor before column 1
    type(callback_t) :: python               ! evaluates the user's rows
  end type linkage_t

  ! The constraints at a point
  type :: constraints_t
    logical :: factored = .false.            ! whether `factor` belongs to the present point
    ! whether axes that shall coincide are opposite or exchanged, which their cosines allow too
    logical :: exchanged = .false.
    real(wp), allocatable :: g(:)            ! (rows)
    real(wp), allocatable :: bias(:)         ! (rows) second derivative at constant velocities
    real(wp), allocatable :: scale(:)        ! (rows) lengths that g is a difference of
    real(wp), allocatable :: min_scale(:)    ! (rows) scales of user's rows at points of size one
    real(wp), allocatable :: gradient(:, :)  ! (forces, rows) G^T
    real(wp), allocatable :: response(:, :)  ! (forces, rows) J^-1 G^T, velocities by unit impulses
    real(wp), allocatable :: factor(:)       ! see row_start: the Cholesky factor in its envelope
  end type constraints_t

  ! A body at a point
  type :: pose_t
    real(wp) :: x(3)                         ! position
    real(wp) :: r(3, 3)                      ! turns vectors of the body into those of space
    real(wp) :: velocity(3), turning(3)      ! turning: angular velocity in space
  end type pose_t

  ! A row as the dot product of two vectors of space
  type :: product_t
    real(wp) :: axis(3, 2)                   ! the axis of each body
    real(wp) :: left(3), right(3)
    real(wp) :: turned(3)                    ! the part of `left` that turns with the first body
    real(wp) :: lever(3, 2)                  ! the part of `right` that turns with each body
    real(wp) :: side(2)                      ! factor of each body's position in `right`
  end type product_t

contains

  ! Makes the linkage of a frame with bodies.
  subroutine make_linkage(blocks, forces, body_blocks, integers, numbers, user_rows, linkage)
    type(block_t), intent(in) :: blocks(:)
    integer, intent(in) :: forces, user_rows
    integer, intent(in) :: body_blocks(:, :) ! (2, bodies) blocks of attitude and position, or 0
    integer, intent(in) :: integers(:, :)    ! (3, rows) a RowForm, two bodies
    real(wp), intent(in) :: numbers(:, :)    ! (13, rows) two points, two axes, a length
    type(linkage_t), intent(inout) :: linkage
    integer :: i, j, bodies, rows            ! bodies: blocks with inertia

    bodies = findloc(blocks%v1, forces + 1, 1) - 1
    linkage%joint_rows = size(integers, 2)
    linkage%user_rows = user_rows
    rows = linkage%joint_rows + user_rows
    linkage%forces = forces
    linkage%momenta_offset = blocks(bodies)%p2
    linkage%momenta_end = linkage%momenta_offset + forces
    allocate (linkage%attitude(0:size(body_blocks, 2)), linkage%position(0:size(body_blocks, 2)))
    linkage%attitude(:) = [0, body_blocks(1, :)]
    linkage%position(:) = [0, body_blocks(2, :)]
    allocate (linkage%row(linkage%joint_rows))
    linkage%span = spread([1, bodies], 2, rows)
    do i = 1, linkage%joint_rows
      linkage%row(i) = row_t(integers(1, i), integers(2:3, i), reshape(numbers(1:6, i), [3, 2]), &
                             reshape(numbers(7:12, i), [3, 2]), numbers(13, i))
      associate (block => [linkage%attitude(linkage%row(i)%body), &
                           linkage%position(linkage%row(i)%body)])
        linkage%span(:, i) = [minval(block, block > 0), maxval(block)]
      end associate
    end do
    linkage%v1 = blocks(linkage%span(1, :))%v1
    linkage%v2 = blocks(linkage%span(2, :))%v2
    linkage%first_column = [(findloc(linkage%v1(:i) <= linkage%v2(i) .and. &
                              linkage%v2(:i) >= linkage%v1(i), .true., 1), i=1, rows)]
    linkage%row_start = [(sum([(j - linkage%first_column(j), j=1, i)]), i=1, rows)]
  end subroutine make_linkage

  ! Evaluates the constraints at a point: g alone, or with derivatives, or with the bias too.
  subroutine evaluate_constraints(linkage, blocks, bodies, y, depth, c, status)
    type(linkage_t), intent(in) :: linkage
    type(block_t), intent(in) :: blocks(:)
    type(body_t), intent(in) :: bodies(:)
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size) or more
    integer, intent(in) :: depth                       ! 0 for g, 1 with G, 2 with the bias
    type(constraints_t), intent(inout) :: c
    integer, intent(out) :: status                     ! no_stop, raised or out_of_memory
    type(pose_t) :: pose(0:ubound(linkage%attitude, 1))
    real(wp) :: omega(merge(linkage%forces, 0, depth == 2))
    integer :: alloc_status, i

    alloc_status = 0
    if (.not. allocated(c%g)) then
      associate (n => linkage%joint_rows + linkage%user_rows, m => linkage%forces)
        ! derivatives along fields of other bodies remain zero; g is the last that is allocated
        allocate (c%bias(n), c%factor(linkage%row_start(n) + n), c%scale(n), c%min_scale(n), &
                  c%gradient(m, n), c%response(m, n), c%g(n), source=0.0_wp, stat=alloc_status)
      end associate
    end if
    c%factored = .false.
    status = merge(no_stop, out_of_memory, alloc_status == 0)
    if (status /= no_stop) return
    if (depth == 2) call velocities(blocks, bodies, [1, size(bodies)], &
                                    y(linkage%momenta_offset + 1:linkage%momenta_end), omega)
    do i = 0, ubound(pose, 1)
      call find_pose(blocks, linkage%attitude(i), linkage%position(i), y, omega, pose(i))
    end do
    call evaluate_joints(linkage, blocks, pose, depth, c)
    if (linkage%user_rows > 0) call evaluate_user_rows(linkage, y, omega, depth, c, status)
    if (depth == 0) return
    do i = 1, size(c%g)
      associate (v => linkage%v1(i), last => linkage%v2(i))
        call velocities(blocks, bodies, linkage%span(:, i), c%gradient(v:last, i), &
                        c%response(v:last, i))
      end associate
    end do
  end subroutine evaluate_constraints

  ! Finds the pose of a body, and its velocities if those of all blocks are given.
  pure subroutine find_pose(blocks, attitude, position, y, omega, pose)
    type(block_t), intent(in) :: blocks(:)
    integer, intent(in) :: attitude, position          ! blocks, 0 for none
    real(wp), contiguous, intent(in) :: y(:)
    real(wp), intent(in) :: omega(:)                   ! (forces), or empty
    type(pose_t), intent(out) :: pose
    real(wp), parameter :: identity(3, 3) = reshape(real([1, 0, 0, 0, 1, 0, 0, 0, 1], wp), [3, 3])

    pose = pose_t(x=0.0_wp, r=identity, velocity=0.0_wp, turning=0.0_wp)
    if (position > 0) then
      pose%x = y(blocks(position)%p1:blocks(position)%p2)
      if (size(omega) > 0) pose%velocity = omega(blocks(position)%v1:blocks(position)%v2)
    end if
    if (attitude == 0) return
    associate (block => blocks(attitude), k => blocks(attitude)%p1)
      if (block%kind == so3_block) then
        pose%r = reshape(y(k:k + 8), [3, 3])
      else
        call rotate_matrix(get_quaternion(block, y(k:k + 3)), .false., pose%r)
      end if
      pose%r = transpose(pose%r)             ! from rows
      if (size(omega) == 0) return
      pose%turning = omega(block%v1:block%v2)
      if (.not. block%space) pose%turning = matmul(pose%r, pose%turning)
    end associate
  end subroutine find_pose

  ! Evaluates the rows of joints; for depth see evaluate_constraints.
  pure subroutine evaluate_joints(linkage, blocks, pose, depth, c)
    type(linkage_t), intent(in) :: linkage
    type(block_t), intent(in) :: blocks(:)
    type(pose_t), intent(in) :: pose(0:)
    integer, intent(in) :: depth
    type(constraints_t), intent(inout) :: c
    type(product_t) :: product
    real(wp) :: axis_before(3)               ! the second axis of the row before
    integer :: i

    c%exchanged = .false.
    product%axis = 0.0_wp
    do i = 1, linkage%joint_rows
      associate (row => linkage%row(i), right => product%right)
        axis_before = product%axis(:, 2)
        call find_vectors(row, pose, product, c%scale(i))
        ! the row before has the axis of the second body that shall coincide with that of the first
        if (row%form == coincident_axes) &
          c%exchanged = c%exchanged .or. dot_product(product%axis(:, 1), axis_before) < 0.5_wp
        c%g(i) = dot_product(product%left, right)
        if (row%form == fixed_length) &
          c%g(i) = (dot_product(right, right) - row%length**2) / (2 * row%length)
        if (depth > 0) call find_gradient(linkage, blocks, row, pose, product, c%gradient(:, i))
        if (depth > 1) c%bias(i) = second_derivative(row, pose, product)
      end associate
    end do
  end subroutine evaluate_joints

  ! Finds the two vectors of a row, and the lengths that their product is a difference of.
  pure subroutine find_vectors(row, pose, product, scale)
    type(row_t), intent(in) :: row
    type(pose_t), intent(in) :: pose(0:)
    type(product_t), intent(out) :: product
    real(wp), intent(out) :: scale
    real(wp) :: arm(3, 2), tip(3, 2)         ! points from the positions of bodies, and in space
    integer :: j

    do j = 1, 2
      associate (body => pose(row%body(j)))
        arm(:, j) = matmul(body%r, row%point(:, j))
        tip(:, j) = body%x + arm(:, j)
        product%axis(:, j) = row%axis(:, j)
        if (j == 2 .or. row%form /= along_space) product%axis(:, j) = matmul(body%r, row%axis(:, j))
      end associate
    end do
    product%left = product%axis(:, 1)
    product%turned = product%left
    if (any(row%form == [between_axes, coincident_axes])) then
      product%right = product%axis(:, 2)
      product%lever(:, 1) = 0.0_wp
      product%lever(:, 2) = product%right
      product%side = 0.0_wp
      scale = 1.0_wp
      return
    end if
    product%right = tip(:, 1) - tip(:, 2)
    product%lever(:, 1) = arm(:, 1)
    product%lever(:, 2) = -arm(:, 2)
    product%side = [1.0_wp, -1.0_wp]
    if (any(row%form == [along_space, fixed_length])) product%turned = 0.0_wp
    if (row%form == fixed_length) product%left = product%right / row%length
    scale = maxval(abs(tip)) + maxval(abs(arm))
  end subroutine find_vectors

  ! Finds the derivatives of a row along the fields of its bodies.
  pure subroutine find_gradient(linkage, blocks, row, pose, product, gradient)
    type(linkage_t), intent(in) :: linkage
    type(block_t), intent(in) :: blocks(:)
    type(row_t), intent(in) :: row
    type(pose_t), intent(in) :: pose(0:)
    type(product_t), intent(in) :: product
    real(wp), intent(inout) :: gradient(:)             ! (forces)
    real(wp) :: torque(3)
    integer :: j

    do j = 1, 2
      associate (attitude => linkage%attitude(row%body(j)), &
                 position => linkage%position(row%body(j)))
        if (position > 0) &
          gradient(blocks(position)%v1:blocks(position)%v2) = product%side(j) * product%left
        if (attitude == 0) cycle
        torque = cross(product%lever(:, j), product%left)
        if (j == 1) torque = torque + cross(product%turned, product%right)
        if (.not. blocks(attitude)%space) torque = matmul(torque, pose(row%body(j))%r)
        gradient(blocks(attitude)%v1:blocks(attitude)%v2) = torque
      end associate
    end do
  end subroutine find_gradient

  ! The second derivative of a row whose vectors turn with constant angular velocities
  pure real(wp) function second_derivative(row, pose, product)
    type(row_t), intent(in) :: row
    type(pose_t), intent(in) :: pose(0:)
    type(product_t), intent(in) :: product
    real(wp), dimension(3) :: left1, left2, right1, right2, swing      ! derivatives by time
    integer :: j

    left1 = cross(pose(row%body(1))%turning, product%turned)
    left2 = cross(pose(row%body(1))%turning, left1)
    right1 = 0.0_wp
    right2 = 0.0_wp
    do j = 1, 2
      associate (body => pose(row%body(j)))
        swing = cross(body%turning, product%lever(:, j))
        right1 = right1 + product%side(j) * body%velocity + swing
        right2 = right2 + cross(body%turning, swing)
      end associate
    end do
    if (row%form == fixed_length) left1 = right1 / (2 * row%length)    ! left, too, lies along d
    second_derivative = dot_product(left2, product%right) + 2 * dot_product(left1, right1) &
                        + dot_product(product%left, right2)
  end function second_derivative

  ! Evaluates the user's rows in Python; for depth see evaluate_constraints.
  subroutine evaluate_user_rows(linkage, y, omega, depth, c, status)
    type(linkage_t), intent(in) :: linkage
    real(wp), contiguous, intent(in) :: y(:), omega(:)
    integer, intent(in) :: depth
    type(constraints_t), intent(inout) :: c
    integer, intent(inout) :: status                   ! raised if Python raises an exception
    logical :: failed
    real(wp) :: answer(linkage%user_rows * (1 + min(depth, 1) * (2 + linkage%forces) + depth / 2))

    associate (n => linkage%user_rows, m => linkage%forces, before => linkage%joint_rows)
      call linkage%python%apply(constraints_operation, [real(depth, wp), omega], &
                                y(:linkage%momenta_offset), answer, failed)
      if (failed) status = raised
      c%g(before + 1:) = answer(:n)
      if (depth == 0) return
      c%scale(before + 1:) = answer(n + 1:2 * n)
      c%min_scale(before + 1:) = answer(2 * n + 1:3 * n)
      c%gradient(:, before + 1:) = reshape(answer(3 * n + 1:3 * n + n * m), [m, n])
      if (depth > 1) c%bias(before + 1:) = answer(3 * n + n * m + 1:)
    end associate
  end subroutine evaluate_user_rows

  ! Factors G J^-1 G^T, whose rows have been evaluated.
  pure subroutine factor_constraints(linkage, c)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(inout) :: c            ! factored unless the matrix is singular
    real(wp), parameter :: min_pivot = 1e3_wp * epsilon(1.0_wp)        ! relative to the diagonal
    real(wp) :: entry                        ! of G J^-1 G^T
    real(wp) :: rest                         ! the entry less the product of rows of the factor
    integer :: i, j, k, v, last

    associate (l => c%factor, start => linkage%row_start, first => linkage%first_column)
      do i = 1, size(c%g)
        entry = 0.0_wp
        rest = 0.0_wp
        do j = first(i), i
          v = max(linkage%v1(i), linkage%v1(j))
          last = min(linkage%v2(i), linkage%v2(j))
          k = max(first(i), first(j))
          entry = dot_product(c%gradient(v:last, i), c%response(v:last, j))
          rest = entry - dot_product(l(start(i) + k:start(i) + j - 1), &
                                     l(start(j) + k:start(j) + j - 1))
          if (j < i) l(start(i) + j) = rest / l(start(j) + j)
        end do
        if (.not. rest > min_pivot * entry) return
        l(start(i) + i) = sqrt(rest)
      end do
    end associate
    c%factored = .true.
  end subroutine factor_constraints

  ! Solves G J^-1 G^T x = b by the factor.
  pure subroutine solve_constraints(linkage, c, x)
    type(linkage_t), intent(in) :: linkage
    type(constraints_t), intent(in) :: c
    real(wp), intent(inout) :: x(:)                    ! b, then the solution
    integer :: i

    associate (l => c%factor, start => linkage%row_start, first => linkage%first_column)
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
    real(wp), intent(in) :: derivatives(:, :)          ! gradient, or response
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
    real(wp), intent(in) :: derivatives(:, :)          ! gradient, or response
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
