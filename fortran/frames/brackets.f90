! Brackets [u, v] of fields of a frame, by their coefficients: DU V - DV U as vector fields.
module brackets_m
  use kinds, only: wp
  use algebra_m, only: cross, motion_bracket, side
  use bases_m, only: algebra_coefficients, algebra_matrix, skew_coefficients, skew_matrix
  use blocks_m, only: block_t
  use frames_m, only: frame_t
  use orthogonal_m, only: skew_bracket
  use shared_numbers, only: bracket_operation, callback_block, euclidean_block, isospectral_block, &
                            se3_block, so_block, su_block, u_block
  use unitary_m, only: multiply
  implicit none
  private
  public :: bracket

contains

  ! Computes the bracket w = [u, v] of fields of the frame.
  subroutine bracket(frame, u, v, w)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: u(:), v(:)   ! (dimension)
    real(wp), contiguous, intent(out) :: w(:)        ! (dimension)
    integer :: i, n

    do i = 1, size(frame%blocks)
      associate (block => frame%blocks(i), first => frame%blocks(i)%vectors + 1, &
                 last => frame%blocks(i)%vectors + frame%blocks(i)%dimension)
        n = block%n
        select case (block%kind)
        case (euclidean_block)
          w(first:last) = 0.0_wp
        case (callback_block)
          call frame%callback%apply(bracket_operation, u, v, w)
        case (se3_block)
          w(first:last) = side(block) * reshape(motion_bracket( &
            reshape(u(first:last), [3, 1 + block%k]), reshape(v(first:last), [3, 1 + block%k])), &
            [block%dimension])
        case (so_block, isospectral_block, su_block, u_block)
          if (block%dimension == 3 .and. n == 3) then  ! SO(3) acts on the matrix
            w(first:last) = side(block) * cross(u(first:last), v(first:last))
          else if (block%kind == so_block .or. block%kind == isospectral_block) then
            call bracket_skew(n, side(block) * u(first:last), v(first:last), w(first:last))
          else
            call bracket_unitary(block, side(block) * u(first:last), v(first:last), w(first:last))
          end if
        case default
          w(first:last) = side(block) * cross(u(first:last), v(first:last))
        end select
      end associate
    end do
  end subroutine bracket

  ! The bracket of real skew matrices
  subroutine bracket_skew(n, u, v, w)
    integer, intent(in) :: n                         ! rows
    real(wp), intent(in) :: u(:), v(:)
    real(wp), intent(out) :: w(:)
    real(wp), dimension(n, n) :: x, y, z

    call skew_matrix(n, u, x)
    call skew_matrix(n, v, y)
    call skew_bracket(n, x, y, z)
    call skew_coefficients(n, z, w)
  end subroutine bracket_skew

  ! The bracket of skew-Hermitian matrices
  subroutine bracket_unitary(block, u, v, w)
    type(block_t), intent(in) :: block
    real(wp), intent(in) :: u(:), v(:)
    real(wp), intent(out) :: w(:)
    complex(wp), dimension(block%n, block%n) :: x, y, z

    call algebra_matrix(block%kind, block%n, u, x)
    call algebra_matrix(block%kind, block%n, v, y)
    call multiply(block%n, x, y, z)
    z = z - conjg(transpose(z))
    call algebra_coefficients(block%kind, block%n, z, w)
  end subroutine bracket_unitary

end module brackets_m
