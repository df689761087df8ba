! Free motion with a force B omega, B antisymmetric and constant in the axes of the body.
!
! In vector spaces p' = B J^-1 p is linear, and solved by its series. On rotations B omega = l x
! omega is that of a rotor with the constant momentum l. With the momentum M = mu + l of body and
! rotor the energy is that of a free body, M . J^-1 M / 2, and a linear part, -M . a, a = J^-1 l,
! whose flow turns M by the angle |a| t about a, and the body by the opposite one. Where the two
! flows don't commute, nine leapfrog steps have order six: W. Kahan, R.-C. Li, "Composition
! constants for raising the orders of unconventional schemes", Math. Comp. 66 (1997).
!
! Derivatives of free motion: tangents (xi, eta) of configuration and momentum move by
! xi' = J^-1 eta + [omega, xi]. Where the velocity omega is constant, eta is too, and the series of
! the solution ends at rounding after some terms for each piece of the motion. Of a rigid body the
! velocity changes; the derivatives by the momentum are differences of the exact motion, of order 8.
module gyroscopic_m
  use algebra_m, only: bracket
  use blocks_m, only: block_t, body_t, find_velocities, velocities
  use frames_m, only: frame_t
  use kinds, only: wp
  use rigid_body_m, only: turn_freely
  use rotations_m, only: exponential, rotate_vector, turn_point
  use shared_numbers, only: euclidean_block
  use vectors_m, only: cross, nan
  implicit none
  private
  public :: carry_tangents, move_by_series, rotor_momentum, substeps, turn_with_rotor

  ! The leapfrog steps that a step is divided into; the last four repeat the first ones backward.
  real(wp), parameter :: half(4) = [0.3921614440073141_wp, 0.3325991367893594_wp, &
                                     -0.7062461725576394_wp, 0.0822135962935508_wp]
  real(wp), parameter :: substeps(9) = [half, 1 - 2 * sum(half), half(4:1:-1)]
  integer, parameter :: terms = 18           ! terms of a series; 1 / 18! is rounding
  real(wp), parameter :: max_pieces = 1e6_wp ! since a motion isn't interrupted

contains

  ! The vector l of the matrix B = l x of a rotor
  pure function rotor_momentum(body) result(momentum)
    type(body_t), intent(in) :: body
    real(wp) :: momentum(3)

    momentum = [body%gyroscopic(3, 2), body%gyroscopic(1, 3), body%gyroscopic(2, 1)]
  end function rotor_momentum

  ! Follows the linear part of the energy of a body; the momentum is that of body and rotor.
  pure subroutine turn_with_rotor(block, body, time, momentum, point)
    type(block_t), intent(in) :: block
    type(body_t), intent(in) :: body
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(3), point(block%point_size)
    real(wp) :: v(3), q(4), sinc

    call find_velocities(body, 3, rotor_momentum(body), v)
    call exponential(time * v, q, sinc)
    call rotate_vector(q, momentum)
    q(1:3) = -q(1:3)
    call turn_point(block, q, point)
  end subroutine turn_with_rotor

  ! Moves a block of a vector space, by a series for each piece of the motion.
  subroutine move_by_series(body, time, momentum, point)
    type(body_t), intent(in) :: body
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(:), point(:)
    real(wp) :: term(size(momentum)), velocity(size(momentum)), step
    integer :: k, piece, pieces

    step = abs(time) * maxval(sum(abs(body%gyroscopic), 2)) * maxval(sum(abs(body%inverse), 2))
    if (.not. step <= max_pieces) momentum = nan
    pieces = max(1, ceiling(merge(step, 0.0_wp, step <= max_pieces)))
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
  end subroutine move_by_series

  ! Moves tangents along the drift that starts at a point.
  subroutine carry_tangents(frame, time, momentum, x)
    type(frame_t), intent(in) :: frame
    real(wp), intent(in) :: time, momentum(frame%forces)
    ! tangents are rows; columns are coordinates, then momenta
    real(wp), intent(inout) :: x(frame%tangents, 2 * frame%forces)
    real(wp), dimension(frame%dimension) :: u, xi, term
    real(wp) :: source(frame%dimension)      ! J^-1 eta times a piece
    real(wp) :: fraction                     ! part of the motion in a piece
    logical :: turns(frame%forces)           ! components of rigid bodies
    integer :: i, j, k, piece, pieces

    u = 0.0_wp
    call velocities(frame%blocks, frame%bodies, [1, size(frame%bodies)], momentum, u(:frame%forces))
    u = time * u
    pieces = 1
    do i = 1, size(frame%bodies)
      associate (block => frame%blocks(i), v => frame%blocks(i)%v1, last => frame%blocks(i)%v2)
        turns(v:last) = frame%bodies(i)%turns
        if (frame%bodies(i)%turns .or. block%kind == euclidean_block) u(v:last) = 0.0_wp
        if (.not. 2 * norm2(u(v:last)) <= max_pieces) x = nan
        pieces = max(pieces, ceiling(min(2 * norm2(u(v:last)), max_pieces)))
      end associate
    end do
    fraction = 1.0_wp / real(pieces, wp)
    u = fraction * u
    source = 0.0_wp
    do j = 1, size(x, 1)
      xi = 0.0_wp
      xi(:frame%forces) = x(j, :frame%forces)
      call velocities(frame%blocks, frame%bodies, [1, size(frame%bodies)], &
                      x(j, frame%forces + 1:), source(:frame%forces))
      source(:frame%forces) = merge(0.0_wp, time * fraction * source(:frame%forces), turns)
      do piece = 1, pieces
        call bracket(frame, u, xi, term)
        term = term + source
        xi = xi + term
        do k = 2, merge(terms, 1, any(u /= 0))
          call bracket(frame, u, term / real(k, wp), term)
          xi = xi + term
        end do
      end do
      x(j, :frame%forces) = xi(:frame%forces)
    end do
    do i = 1, size(frame%bodies)
      associate (v => frame%blocks(i)%v1, last => frame%blocks(i)%v2, m => frame%forces)
        if (frame%bodies(i)%turns) call carry_of_body(frame%bodies(i), time, momentum(v:last), &
                                                      x(:, v:last), x(:, m + v:m + last))
      end associate
    end do
  end subroutine carry_tangents

  ! Moves tangents of a rigid body, whose coordinates turn with it.
  subroutine carry_of_body(body, time, momentum, xi, eta)
    type(body_t), intent(in) :: body
    real(wp), intent(in) :: time, momentum(3)
    real(wp), intent(inout) :: xi(:, :), eta(:, :)     ! (tangents, 3)
    real(wp), parameter :: weight(4) = [4.0_wp / 5, -1.0_wp / 5, 4.0_wp / 105, -1.0_wp / 280]
    real(wp), parameter :: angle = 0.02_wp   ! angle of a difference, for an error below rounding
    real(wp) :: q(4), q_moved(4), change(4), moved(3), step, after(3)
    real(wp), dimension(3, 3) :: turned, by_momentum   ! derivatives by each component, as columns
    integer :: i, j, k, side

    after = momentum
    call turn_freely(body%top, time, after, q)
    step = angle / (abs(time) * maxval(body%top%inverse))
    do j = 1, 3
      change = 0.0_wp
      by_momentum(:, j) = 0.0_wp
      do k = 1, 4
        do side = -1, 1, 2
          moved = momentum
          moved(j) = moved(j) + real(side * k, wp) * step
          call turn_freely(body%top, time, moved, q_moved)
          q_moved = sign(1.0_wp, dot_product(q, q_moved)) * q_moved - q
          change = change + real(side, wp) * weight(k) / step * q_moved
          by_momentum(:, j) = by_momentum(:, j) &
                              + real(side, wp) * weight(k) / step * (moved - after)
        end do
      end do
      turned(:, j) = 2 * (q(4) * change(:3) - change(4) * q(:3) - cross(q(:3), change(:3)))
    end do
    q(:3) = -q(:3)
    do i = 1, size(xi, 1)
      moved = xi(i, :)
      call rotate_vector(q, moved)
      xi(i, :) = moved + matmul(turned, eta(i, :))
      eta(i, :) = matmul(by_momentum, eta(i, :))
    end do
  end subroutine carry_of_body

end module gyroscopic_m
