! Norms of errors of steps: root mean squares over the coefficients of the flow from one
! point to another or, on frames without such coefficients, over the entries of points.
module error_norm_m
  use kinds, only: wp
  use coordinates_m, only: sizes
  use frames_m, only: frame_t
  use isospectral_m, only: isospectral_tangent
  use linear_action_m, only: linear_tangent
  use shared_numbers
  use stiefel_m, only: stiefel_tangent
  implicit none
  private
  public :: tolerances_t, norm, point_sizes, remove_isotropy, scales, tangent

  ! The tolerances of a pair and the limits of its steps. The width is the number of entries of a
  ! difference.
  type :: tolerances_t
    real(wp), allocatable :: atol(:)       ! (width)
    real(wp), allocatable :: rtols(:)      ! (width)
    real(wp) :: rtol = 0.0_wp              ! the smallest one
    logical :: in_coordinates = .true.     ! whether differences are in coordinates
    integer :: parts = 1                   ! numbers of an entry: 2 if it is complex
    real(wp) :: exponent = 0.0_wp          ! power of an error that a step size is proportional to
    real(wp) :: max_step = 0.0_wp
  end type tolerances_t

contains

  ! Computes the field with coefficients v as a difference. If entries are compared, all blocks are
  ! isospectral, of columns, linear actions, or outside of compiled code.
  subroutine tangent(frame, tolerances, v, y, found)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: v(:)           ! (dimension)
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: found(:)      ! (width)
    integer :: i

    if (tolerances%in_coordinates) then
      found = v
      return
    end if
    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), k => frame%blocks(i)%v1, m => frame%blocks(i)%v2, &
                 p => frame%blocks(i)%p1, n => frame%blocks(i)%p2)
        select case (block%kind)
        case (callback_block)
          call frame%callback%apply(tangent_operation, v, y, found)
        case (linear_action_block)
          call linear_tangent(block%action, v(k:m), y(p:n), found(p:n))
        case (stiefel_block)
          call stiefel_tangent(block%k, block%n, v(k:m), y(p:n), found(p:n))
        case default
          call isospectral_tangent(block%n, v(k:m), y(p:n), found(p:n))
        end select
      end associate
    end do
  end subroutine tangent

  ! Computes the magnitudes that relative errors refer to; for entries, the root mean square of all
  ! entries whose tolerance is finite.
  subroutine point_sizes(frame, tolerances, y, found)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: y(:)           ! (point_size)
    real(wp), contiguous, intent(out) :: found(:)      ! (width)
    integer :: counted

    if (tolerances%in_coordinates) then
      call sizes(frame, y, found)
      return
    end if
    counted = count(tolerances%atol <= huge(1.0_wp))
    found = norm2(merge(y, 0.0_wp, tolerances%atol <= huge(1.0_wp))) &
            / sqrt(real(counted / tolerances%parts, wp))
  end subroutine point_sizes

  ! Computes the tolerances at the larger of two points, all positive.
  subroutine scales(frame, tolerances, x, y, spare, found)
    type(frame_t), intent(in) :: frame
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: x(:), y(:)     ! (point_size)
    real(wp), contiguous, intent(out) :: spare(:)      ! (width) workspace
    real(wp), contiguous, intent(out) :: found(:)      ! (width)

    call point_sizes(frame, tolerances, x, spare)
    call point_sizes(frame, tolerances, y, found)
    found = max(tolerances%rtols * max(found, spare) + tolerances%atol, tiny(1.0_wp))
  end subroutine scales

  ! The root mean square of a difference in tolerances. Entries with infinite tolerance are left
  ! out.
  pure real(wp) function norm(tolerances, v, scale)
    type(tolerances_t), intent(in) :: tolerances
    real(wp), contiguous, intent(in) :: v(:), scale(:)       ! (width)
    integer :: counted

    counted = max(count(scale <= huge(1.0_wp)), 1)
    norm = sqrt(sum((v / scale)**2) / (real(counted, wp) / real(tolerances%parts, wp)))
  end function norm

  ! Removes the part of v whose flow leaves the point fixed: on a sphere, the rotation about it.
  subroutine remove_isotropy(frame, y, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: y(:)         ! (point_size)
    real(wp), contiguous, intent(inout) :: v(:)      ! (dimension)
    integer :: i

    do i = 1, size(frame%blocks)
      if (frame%blocks(i)%kind == callback_block) then
        call frame%callback%apply(shortest_operation, (v), y, v)
      end if
      if (frame%blocks(i)%kind /= sphere_block) cycle
      associate (k => frame%blocks(i)%v1, p => frame%blocks(i)%p1)
        v(k:k + 2) = v(k:k + 2) - dot_product(v(k:k + 2), y(p:p + 2)) * y(p:p + 2)
      end associate
    end do
  end subroutine remove_isotropy

end module error_norm_m
