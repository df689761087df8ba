! Coefficients of derivatives of points, for right-hand sides that return these: the inverse of the
! fields, without isotropy. Frame.coefficients has the formulas. What no field has is dropped.
module derivatives_m
  use kinds, only: wp
  use blocks_m, only: as_complex, block_t
  use coordinates_m, only: quaternion_quotient, quotient
  use frames_m, only: frame_t
  use stiefel_m, only: isospectral_coefficients, stiefel_coefficients
  use orthogonal_m, only: orthogonal_coefficients
  use rotations_m, only: get_quaternion, set_quaternion
  use shared_numbers, only: coefficients_operation, euclidean_block, isospectral_block, &
                            quaternion_block, se3_block, so3_block, so_block, sphere_block, &
                            stiefel_block, su2_block, su_block, u_block
  use unitary_m, only: unitary_coefficients
  use vectors_m, only: cross
  implicit none
  private
  public :: coefficients_of

  ! largest parts that are dropped without a report, those of cg/frames/base.py
  real(wp), parameter :: relative = 1e-8_wp, absolute = 1e-12_wp

contains

  ! Computes the coefficients of a derivative at a point, and reports the largest part dropped.
  subroutine coefficients_of(frame, t, y, slope, v)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: t
    real(wp), target, intent(in) :: y(frame%point_size), slope(frame%point_size)
    real(wp), intent(out) :: v(frame%dimension)
    real(wp) :: dropped, p(4), q(4), half_velocity(4), matrix(8)
    real(wp), allocatable :: answer(:)       ! coefficients, length of what is dropped
    integer :: i

    if (frame%python_derivatives) then
      allocate (answer(size(v) + 1))
      call frame%callback%apply(coefficients_operation, y, slope, answer)
      v = answer(:size(v))
      dropped = answer(size(answer))
      if (dropped > absolute) call report(frame, t, dropped**2, sum(slope**2))
      return
    end if
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), v1 => frame%blocks(i)%v1, v2 => frame%blocks(i)%v2, &
                 p1 => frame%blocks(i)%p1, p2 => frame%blocks(i)%p2)
        select case (block%kind)
        case (euclidean_block)
          v(v1:v2) = slope(p1:p2)
          cycle
        case (so3_block, se3_block)
          call motion_coefficients(block, y(p1), slope(p1), v(v1), dropped)
        case (quaternion_block, su2_block)
          p = get_quaternion(block, y(p1:p2))
          q = get_quaternion(block, slope(p1:p2))
          half_velocity = quaternion_quotient(p, q, block%space)
          v(v1:v2) = 2 * half_velocity(1:3)
          dropped = dot_product(p, q)**2
          if (block%kind == su2_block) then
            call set_quaternion(q, matrix)
            ! matrices are longer by the root of 2
            dropped = 2 * dropped + sum((slope(p1:p2) - matrix)**2)
          end if
        case (sphere_block)
          v(v1:v2) = cross(y(p1:p2), slope(p1:p2))
          dropped = dot_product(y(p1:p2), slope(p1:p2))**2
        case (so_block)
          call orthogonal_coefficients(block%n, block%space, y(p1), slope(p1), v(v1:v2), dropped)
        case (isospectral_block)
          call isospectral_coefficients(block%n, frame%constants(block%constants + 1:), y(p1), &
                                        slope(p1), v(v1:v2), dropped)
        case (stiefel_block)
          call stiefel_coefficients(block%k, block%n, y(p1), slope(p1), v(v1), dropped)
        case (su_block, u_block)
          call unitary_coefficients(block%n, block%space, as_complex(block%n, y(p1:p2)), &
                                    as_complex(block%n, slope(p1:p2)), v(v1:v2), dropped)
        end select
        if (dropped > absolute**2) call report(frame, t, dropped, sum(slope(p1:p2)**2))
      end associate
    end do
  end subroutine coefficients_of

  ! Reports what is dropped of a derivative; both lengths are squared.
  subroutine report(frame, t, dropped, whole)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: t, dropped, whole

    if (.not. (associated(frame%dropped) .and. dropped > relative**2 * whole)) return
    if (.not. dropped > frame%dropped**2 * whole) return
    frame%dropped = sqrt(dropped / whole)
    frame%dropped_at = t
  end subroutine report

  ! Computes coefficients of a derivative of a motion, stored by rows, and the square of the rest.
  pure subroutine motion_coefficients(block, y, slope, v, dropped)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: y(3 + block%k, 3 + block%k), slope(3 + block%k, 3 + block%k)
    real(wp), intent(out) :: v(3, 1 + block%k), dropped
    real(wp) :: r(3, 3), x(3, 3)               ! the transpose of R, and R^T R' or R' R^T
    integer :: j

    r = y(1:3, 1:3)
    x = quotient(block, r, slope(1:3, 1:3))
    v(:, 1) = [x(3, 2) - x(2, 3), x(1, 3) - x(3, 1), x(2, 1) - x(1, 2)] / 2
    dropped = sum((x + transpose(x))**2) / 4
    do j = 1, block%k
      if (block%space) then
        v(:, 1 + j) = slope(3 + j, 1:3) - cross(v(:, 1), y(3 + j, 1:3))
      else
        v(:, 1 + j) = matmul(r, slope(3 + j, 1:3))
      end if
      dropped = dropped + sum(slope(:, 3 + j)**2)
    end do
  end subroutine motion_coefficients

end module derivatives_m
