! Frames: manifolds with vector fields E_i whose flows are known. A frame is a product of blocks,
! each with its own manifold; points and coefficients of the blocks lie one after the other.
module frames_m
  use kinds, only: wp
  use shared_numbers, only: callback_block, euclidean_block, flow_operation, isospectral_block, &
                            linear_action_block, polynomial_option, quaternion_block, &
                            scalar_first_option, se3_block, so3_block, so_block, &
                            space_axes_option, sphere_block, stiefel_block, su2_block, su_block, &
                            u_block
  use blocks_m, only: as_complex, block_t, body_t
  use callback_m, only: callback_t
  use joints_m, only: linkage_t
  use stiefel_m, only: move_isospectral, move_stiefel, restore_isospectral, restore_stiefel
  use linear_action_m, only: make_linear_action, move_linearly, move_polynomially, spectral_bound
  use orthogonal_m, only: move_orthogonal, restore_orthogonal
  use rotations_m, only: get_quaternion, move_rigid_body, orthogonalise, rotate, rotation_bound, &
                         set_quaternion
  use unitary_m, only: move_unitary, restore_unitary
  implicit none
  private
  public :: frame_t, apply_flows, distance_bound, make_frame, restore, turning

  type :: frame_t
    integer :: dimension = 0, point_size = 0
    logical :: derivatives = .false.         ! whether right-hand sides give derivatives of points
    logical :: python_derivatives = .false.  ! whether only Python has their coefficients
    ! the largest part of one that is dropped, relative to it, and its time
    real(wp), pointer :: dropped => null(), dropped_at => null()
    real(wp), allocatable :: constants(:)    ! numbers of all blocks, one after the other
    type(block_t), allocatable :: blocks(:)
    type(callback_t), pointer :: callback => null()
    ! number of momenta and of forces of a mechanical system; entries of a point before momenta
    integer :: forces = 0, momenta_offset = 0
    integer :: tangents = 0                  ! rows of derivatives behind the momenta
    type(body_t), pointer :: bodies(:) => null()       ! a body for each block but the last
    logical :: jointed = .false.             ! whether it has joints or other constraints
    type(linkage_t) :: linkage
  end type frame_t

contains

  ! Makes a frame of its blocks, with the places of each in coefficients and points.
  subroutine make_frame(description, constants, frame)
    integer, intent(in) :: description(:, :)  ! (3, blocks): a BlockKind, n, a sum of BlockOptions
    real(wp), intent(in) :: constants(:)      ! numbers of all blocks, or more
    type(frame_t), intent(out) :: frame
    integer :: i, length, used

    frame%constants = constants
    allocate (frame%blocks(size(description, 2)))
    used = 0
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), options => description(3, i))
        block%kind = description(1, i)
        block%space = iand(options, space_axes_option) /= 0 &
                      .or. any(block%kind == [sphere_block, isospectral_block])
        block%scalar_first = iand(options, scalar_first_option) /= 0
        block%polynomial = iand(options, polynomial_option) /= 0
        block%v1 = frame%dimension + 1
        block%p1 = frame%point_size + 1
        block%dimension = 3
        block%n = description(2, i)
        block%constants = used
        select case (block%kind)
        case (euclidean_block)
          block%dimension = block%n
          block%point_size = block%n
        case (quaternion_block)
          block%point_size = 4
        case (so3_block, se3_block)                    ! k translations
          if (block%kind == se3_block) block%k = block%n
          block%dimension = 3 + 3 * block%k
          block%point_size = (3 + block%k)**2
        case (sphere_block)
          block%point_size = 3
        case (su2_block)
          block%point_size = 8
        case (su_block, u_block)
          block%dimension = block%n**2 - merge(1, 0, block%kind == su_block)
          block%point_size = 2 * block%n**2
        case (so_block, isospectral_block)
          block%dimension = block%n * (block%n - 1) / 2
          block%point_size = block%n**2
          if (block%kind == isospectral_block) used = used + block%n
        case (stiefel_block)
          block%k = nint(constants(used + 1))
          used = used + 1
          block%dimension = block%n * block%k
          block%point_size = block%dimension
        case (linear_action_block)
          call make_linear_action(constants(used + 1:), block%action, length)
          block%dimension = block%action%generators
          block%point_size = block%action%point_size
          used = used + length
        case (callback_block)                ! alone in its frame; its options are a point size
          block%dimension = block%n
          block%point_size = options
          used = used + block%dimension
        case default
          error stop 'make_frame: there is no such block'
        end select
        frame%dimension = frame%dimension + block%dimension
        frame%point_size = frame%point_size + block%point_size
        block%v2 = frame%dimension
        block%p2 = frame%point_size
      end associate
    end do
  end subroutine make_frame

  ! An angle that the time-1 flow of the field with coefficients v doesn't exceed: of points, or of
  ! other fields, that is, of the eigenvalues of its brackets, which those in Python don't tell.
  pure real(wp) function turning(frame, v, fields)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: v(:)           ! (dimension)
    logical, intent(in) :: fields
    real(wp) :: angle
    integer :: i

    turning = 0.0_wp
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i))
        select case (block%kind)
        case (euclidean_block)
          cycle
        case (callback_block)
          angle = norm2(v * frame%constants(block%constants + 1:block%constants + block%dimension))
          if (fields) angle = 0.0_wp
        case (linear_action_block)
          angle = spectral_bound(block%action, v(block%v1:block%v2))
          if (fields) angle = 2 * dot_product(abs(v(block%v1:block%v2)), block%action%norm)
        case default
          angle = norm2(v(block%v1:merge(block%v1 + 2, block%v2, block%kind == se3_block)))
          if (fields .and. block%n > 3 .and. any(block%kind == [so_block, isospectral_block])) &
            angle = sqrt(2.0_wp) * angle               ! su_block and u_block: see blocks_m
        end select
        turning = max(turning, angle)
      end associate
    end do
  end function turning

  ! Moves y, or one block of it, along the time-1 flows of some fields, block by block.
  subroutine apply_flows(frame, flows, v, y, only)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: flows
    real(wp), intent(in) :: v(frame%dimension, *)            ! (dimension, flows)
    real(wp), target, intent(inout) :: y(frame%point_size)
    integer, optional, intent(in) :: only    ! number of the block
    complex(wp), pointer, contiguous :: matrix(:, :)
    integer :: i, j

    if (flows < 1) return
    do i = 1, size(frame%blocks)
      if (present(only)) then
        if (i /= only) cycle
      end if
      associate (block => frame%blocks(i), v1 => frame%blocks(i)%v1, v2 => frame%blocks(i)%v2, &
                 p1 => frame%blocks(i)%p1, p2 => frame%blocks(i)%p2)
        select case (block%kind)
        case (euclidean_block)
          do j = 1, flows
            y(p1:p2) = y(p1:p2) + v(v1:v2, j)
          end do
        case (se3_block)
          call move_rigid_body(block, flows, frame%dimension, v(v1, 1), y(p1))
        case (so_block)
          call move_orthogonal(block%n, block%space, v(v1:v2, :flows), y(p1))
        case (isospectral_block)
          call move_isospectral(block%n, v(v1:v2, :flows), y(p1))
        case (su_block, u_block)
          matrix => as_complex(block%n, y(p1:p2))
          call move_unitary(block%n, block%space, v(v1:v2, :flows), matrix)
        case (stiefel_block)
          do j = 1, flows
            call move_stiefel(block%k, block%n, v(v1, j), y(p1))
          end do
        case (linear_action_block)
          if (block%polynomial) then
            call move_polynomially(block%action, v(v1:v2, :flows), 0.0_wp, y(p1:p2))
          else
            call move_linearly(block%action, v(v1:v2, :flows), y(p1:p2))
          end if
        case (callback_block)
          call frame%callback%apply(flow_operation, [v(v1:v2, :flows)], (y(p1:p2)), y(p1:p2))
        case default
          call rotate(block, flows, frame%dimension, v(v1, 1), y(p1))
        end select
      end associate
    end do
  end subroutine apply_flows

  ! Removes rounding off the manifold from a point: one Newton-Schulz step, y -> (3 y - y y^T y) /
  ! 2, towards the nearest rotation or unit vector. It squares the distance; without it rounding
  ! errors accumulate. Eigenvalues of isospectral points are replaced.
  subroutine restore(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, target, intent(inout) :: y(:)    ! (point_size)
    real(wp) :: q(4)
    complex(wp), pointer, contiguous :: matrix(:, :)
    integer :: i

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), p1 => frame%blocks(i)%p1, p2 => frame%blocks(i)%p2)
        select case (block%kind)
        case (so3_block, se3_block)
          call orthogonalise(3 + block%k, y(p1:p2))
        case (quaternion_block, sphere_block)
          y(p1:p2) = (1.5_wp - 0.5_wp * dot_product(y(p1:p2), y(p1:p2))) * y(p1:p2)
        case (so_block)
          call restore_orthogonal(block%n, y(p1:p2))
        case (isospectral_block)
          call restore_isospectral(block%n, frame%constants(block%constants + 1:), y(p1:p2))
        case (stiefel_block)
          call restore_stiefel(block%k, block%n, y(p1:p2))
        case (su_block, u_block)
          matrix => as_complex(block%n, y(p1:p2))
          call restore_unitary(block%n, matrix)
          if (block%kind == su_block) call remove_phase(block%n, matrix)
        case (su2_block)
          q = get_quaternion(block, y(p1:p2))
          q = (1.5_wp - 0.5_wp * dot_product(q, q)) * q
          call set_quaternion(q, y(p1:p2))
        end select
      end associate
    end do
  end subroutine restore

  ! Changes a unitary matrix to determinant 1. Flows by large angles leave its phase no digits.
  pure subroutine remove_phase(n, y)
    integer, intent(in) :: n
    complex(wp), intent(inout) :: y(n, n)
    complex(wp) :: a(n, n), determinant
    real(wp) :: angle
    integer :: i, j, pivot

    a = y
    determinant = cmplx(1.0_wp, kind=wp)
    do i = 1, n                                      ! Gaussian elimination
      pivot = i - 1 + maxloc(abs(a(i:, i)), dim=1)
      if (pivot /= i) then
        a([i, pivot], :) = a([pivot, i], :)
        determinant = -determinant
      end if
      determinant = determinant * a(i, i)
      if (.not. abs(a(i, i)) > 0) exit
      do j = i + 1, n
        a(j, i:) = a(j, i:) - (a(j, i) / a(i, i)) * a(i, i:)
      end do
    end do
    angle = -atan2(aimag(determinant), real(determinant, wp)) / real(n, wp)
    y = y * cmplx(cos(angle), sin(angle), wp)
  end subroutine remove_phase

  ! An upper bound of the distance of a point from the manifold, huge where none is cheap. Singular
  ! values s of a matrix y are within |s^2 - 1| of 1, and so within the norm of y y^T - 1.
  pure real(wp) function distance_bound(frame, y)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)       ! (point_size)
    real(wp) :: q(4)
    integer :: i

    distance_bound = huge(distance_bound)
    if (.not. all(abs(y) <= huge(y))) return       ! max leaves out NaN
    distance_bound = 0.0_wp
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), point => y(frame%blocks(i)%p1:frame%blocks(i)%p2))
        select case (block%kind)
        case (euclidean_block)
          cycle
        case (so3_block, se3_block)
          distance_bound = max(distance_bound, rotation_bound(3 + block%k, point))
        case (quaternion_block, sphere_block)
          distance_bound = max(distance_bound, abs(dot_product(point, point) - 1))
        case (su2_block)
          q = get_quaternion(block, point)
          distance_bound = max(distance_bound, abs(dot_product(q, q) - 1), &
                               maxval(abs(point(1:2) - [point(7), -point(8)])), &
                               maxval(abs(point(3:4) + [point(5), -point(6)])))
        case default
          distance_bound = huge(distance_bound)
        end select
      end associate
    end do
    if (.not. distance_bound <= huge(distance_bound)) distance_bound = huge(distance_bound)
  end function distance_bound

end module frames_m
