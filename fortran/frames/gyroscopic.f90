! Free motion with a force B omega, B antisymmetric and constant in the axes of the body.
!
! In vector spaces p' = B J^-1 p is linear, and solved by its series. On rotations B omega = l x omega
! is that of a rotor with the constant momentum l. With the momentum M = mu + l of body and rotor the
! energy is that of a free body, M . J^-1 M / 2, and a linear part, -M . a, a = J^-1 l, whose flow
! turns M by the angle |a| t about a, and the body by the opposite one. Where the two flows don't
! commute, nine leapfrog steps of W. Kahan and R.-C. Li, "Composition constants for raising the orders
! of unconventional schemes", Math. Comp. 66 (1997), have order six, and are symplectic.
module gyroscopic_m
  use kinds, only: wp
  use blocks_m, only: body_t, find_velocities
  use frames_m, only: frame_t, apply_flows
  use rotations_m, only: exponential, rotate_vector
  implicit none
  private
  public :: move_linearly, rotor_momentum, substeps, turn_with_rotor

  ! half of the nine parts
  real(wp), parameter :: part(4) = [0.3921614440073141_wp, 0.3325991367893594_wp, &
                                     -0.7062461725576394_wp, 0.0822135962935508_wp]

contains

  ! The momentum of the rotor
  pure function rotor_momentum(body) result(momentum)
    type(body_t), intent(in) :: body
    real(wp) :: momentum(3)

    momentum = [body%gyroscopic(3, 2), body%gyroscopic(1, 3), body%gyroscopic(2, 1)]
  end function rotor_momentum

  ! The parts of a step
  pure function substeps(body)
    type(body_t), intent(in) :: body
    real(wp), allocatable :: substeps(:)

    substeps = [1.0_wp]
    if (.not. body%commutes) substeps = [part, 1 - 2 * sum(part), part(4:1:-1)]
  end function substeps

  ! Follows the linear part of the energy of block i; the momentum is that of body and rotor.
  subroutine turn_with_rotor(frame, i, time, momentum, y)
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: i
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(3), y(frame%point_size)
    real(wp) :: v(frame%forces), q(4), sinc

    associate (own => v(frame%blocks(i)%v1:frame%blocks(i)%v2), body => frame%bodies(i))
      call find_velocities(body, 3, rotor_momentum(body), own)
      own = time * own
      call exponential(own, q, sinc)
      call rotate_vector(q, momentum)
      own = -own
      call apply_flows(frame, 1, v, y, i)
    end associate
  end subroutine turn_with_rotor

  ! Moves a block of a vector space, by a series for each piece of the motion.
  subroutine move_linearly(body, time, momentum, point)
    type(body_t), intent(in) :: body
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(:), point(:)
    real(wp) :: term(size(momentum)), velocity(size(momentum)), step
    integer, parameter :: terms = 18         ! 1 / 18! is rounding
    integer :: k, piece, pieces

    pieces = max(1, ceiling(abs(time) * maxval(sum(abs(body%gyroscopic), 2)) &
                            * maxval(sum(abs(body%inverse), 2))))
    step = time / real(pieces, wp)
    do piece = 1, pieces
      term = momentum
      do k = 1, terms
        call find_velocities(body, size(term), term, velocity)
        velocity = step / real(k, wp) * velocity
        point = point + velocity
        term = matmul(body%gyroscopic, velocity)
        momentum = momentum + term
      end do
    end do
  end subroutine move_linearly

end module gyroscopic_m
