! The free motion of a rigid body, exact for every spin and time.
!
! Let n = (n1, n2, n3) be the direction of the momentum in principal axes, L its length, and J1, J2,
! J3 inverse moments of inertia. If J1 >= J2 >= J3, or the opposite, n3 keeps its sign, and
!
!   n1 = a1 cn u,   n2 = a2 sn u,   n3 = a3 dn u,   u' = +- L a3 sqrt(|J3 - J2| |J3 - J1|),
!
! with Jacobi's functions of a modulus m <= 1. Functions at a later time follow by their addition
! theorem from the present n, so that no phase is computed, and small components keep their
! digits, which decide the motion near the separatrix, m = 1.
!
! Let B be the shortest rotation from the third axis to n. The attitude is a rotation that is fixed
! in space, a rotation about the third axis by an angle chi, and then the inverse of B, where
!
!   chi' = L (J3 +- a1^2 |J3 - J1| / (1 + n3)).
!
! Its integral is an elliptic one of the third kind. Over a piece of at most `max_piece` in u, in
! which the two halves are added, it is computed by Gauss's formula; whole periods are counted.
module rigid_body_m
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  use vectors_m, only: nan
  implicit none
  private
  public :: top_t, turn_freely

  type :: top_t                              ! 24 numbers, which cg/frames/inertia.py computes
    sequence
    ! principal axes as columns, and their last digits, without which lengths would drift
    real(wp) :: axes(3, 3) = 0.0_wp, digits(3, 3) = 0.0_wp
    ! inverse moments, the largest first, and their differences, 1 - 2, 2 - 3 and 1 - 3
    real(wp) :: inverse(3) = 0.0_wp, gap(3) = 0.0_wp
  end type top_t

  ! Squares and weights of the positive nodes of Gauss's formula with 14 nodes
  real(wp), parameter :: node_square(7) = [ &
    0.01167587194014667_wp, 0.1018327040027696_wp, 0.2654811572689373_wp, 0.4723715370044845_wp, &
    0.6842620156531486_wp, 0.8619913332033933_wp, 0.9727557512974903_wp]
  real(wp), parameter :: weight(7) = [ &
    0.2152638534631578_wp, 0.2051984637212956_wp, 0.1855383974779378_wp, 0.1572031671581935_wp, &
    0.1215185706879032_wp, 0.08015808715976021_wp, 0.03511946033175186_wp]
  ! the longest piece in u, for which the error of Gauss's formula is below rounding
  real(wp), parameter :: max_piece = 1.1_wp
  ! Unit vectors are scaled before their lengths are compared: the spacing of numbers jumps at 1, so
  ! that roundings of squares would have a mean there, and lengths would drift.
  real(wp), parameter :: scaled = 0.7_wp, pi = acos(-1.0_wp)

  ! A solution as functions of u: the modulus, its complement, a3, and the present functions
  type :: motion_t
    real(wp) :: m, complement, a3, sn, cn, dn
  end type motion_t

contains

  ! Moves the momentum in body axes freely. The body turns by a quaternion (vector, scalar part),
  ! continuous in time. Both are NaN if the body turns so far that its phase has no digits.
  pure subroutine turn_freely(top, time, momentum, q)
    type(top_t), intent(in) :: top
    real(wp), intent(in) :: time
    real(wp), intent(inout) :: momentum(3)
    real(wp), intent(out) :: q(4)
    real(wp) :: length, before(3), n(3), after(3), angle
    real(wp) :: about(2)                     ! the larger one: of the smallest or largest moment
    integer :: order(3)                      ! the axes, which half turns make n3 positive in
    real(wp) :: signs(3)
    logical :: swapped

    q = [0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
    length = maxval(abs(momentum))
    if (.not. (length > 0 .and. all(abs(momentum) <= huge(length)))) return
    length = length * sqrt(sum((momentum / length)**2))
    if (.not. length * abs(time) * maxval(top%inverse) * epsilon(length) < 1) then
      q = nan
      momentum = nan
      return
    end if
    before = momentum / length
    n = matmul(before, top%axes) + matmul(before, top%digits)
    about = [n(1)**2 * top%gap(1), n(3)**2 * top%gap(2)]
    swapped = about(1) > about(2) .or. (about(1) == about(2) .and. top%gap(1) > top%gap(2))
    order = merge([3, 2, 1], [1, 2, 3], swapped)
    n = n(order)
    signs = [1.0_wp, merge(-1.0_wp, 1.0_wp, swapped), 1.0_wp]
    if (n(3) < 0) signs(2:3) = -signs(2:3)
    n = signs * n
    call move_direction(top, swapped, length * time, n, after, angle)
    q = turned(n, angle, after)
    q(order) = signs * q(1:3)
    after(order) = signs * after
    q(1:3) = matmul(top%axes, q(1:3))
    after = matmul(top%axes, after) + matmul(top%digits, after)
    after = after + (sum((scaled * before)**2) - sum((scaled * after)**2)) / (2 * scaled**2) * after
    momentum = length * after
  end subroutine turn_freely

  ! Computes the direction of the momentum after a time, and the angle chi; n3 isn't negative.
  pure subroutine move_direction(top, swapped, time, n, after, angle)
    type(top_t), intent(in) :: top
    logical, intent(in) :: swapped
    real(wp), intent(in) :: time             ! times L
    real(wp), intent(in) :: n(3)
    real(wp), intent(out) :: after(3), angle
    type(motion_t) :: motion
    real(wp) :: third, difference, a1, ratio, scale, direction, mean

    third = merge(top%gap(1), top%gap(2), swapped)           ! |J3 - J2|
    difference = merge(top%gap(2), top%gap(1), swapped)      ! |J2 - J1|
    direction = merge(-1.0_wp, 1.0_wp, swapped)
    associate (m => motion, whole => top%gap(3))
      ratio = sqrt(whole / third)                            ! a2 / a1
      a1 = sqrt(n(1)**2 + (n(2) / ratio)**2)
      m = motion_t(0.0_wp, 1.0_wp, sqrt(n(3)**2 + n(2)**2 * (difference / whole)), &
                   0.0_wp, 1.0_wp, 1.0_wp)
      if (a1 > 0) then
        m%sn = n(2) / (ratio * a1)
        m%cn = n(1) / a1
      end if
      scale = m%a3**2 * third
      if (scale > 0) then
        m%m = a1**2 * difference / scale
        m%complement = max(n(3)**2 * third - n(1)**2 * difference, 0.0_wp) / scale
        m%dn = n(3) / m%a3
      else
        m%a3 = 0.0_wp                        ! the momentum is at rest
      end if
      call follow(direction * time * m%a3 * sqrt(third * whole), motion, mean)
      angle = time * (merge(top%inverse(1), top%inverse(3), swapped) &
                      + direction * a1**2 * whole * mean)
      after = [a1 * m%cn, a1 * ratio * m%sn, m%a3 * m%dn]
    end associate
  end subroutine move_direction

  ! Moves the functions by u, and computes the mean of 1 / (1 + a3 dn) on the way.
  pure subroutine follow(u, motion, mean)
    real(wp), intent(in) :: u
    type(motion_t), intent(inout) :: motion
    real(wp), intent(out) :: mean
    type(motion_t) :: start
    real(wp) :: quarter, periods, integral, rest

    integral = 0.0_wp
    rest = u
    if (abs(u) > max_piece .and. motion%complement > 0) then
      quarter = quarter_period(motion%complement)
      periods = anint(u / (4 * quarter))
      if (periods /= 0) then
        start = motion_t(motion%m, motion%complement, motion%a3, 0.0_wp, 1.0_wp, 1.0_wp)
        call follow_pieces(quarter, start, integral)
        integral = 4 * periods * integral
        rest = u - 4 * periods * quarter
      end if
    end if
    call follow_pieces(rest, motion, integral)
    if (abs(u) > 0) then
      mean = integral / u
    else
      mean = 1 / (1 + motion%a3 * motion%dn)
    end if
  end subroutine follow

  ! Moves the functions by u in equal pieces, and adds to the integral of 1 / (1 + a3 dn).
  pure subroutine follow_pieces(u, motion, integral)
    real(wp), intent(in) :: u
    type(motion_t), intent(inout) :: motion
    real(wp), intent(inout) :: integral
    real(wp) :: half, sn, cn, dn, error
    integer(int64) :: i, pieces

    if (.not. (abs(u) > 0 .and. abs(u) <= huge(u))) return
    pieces = int(abs(u) / max_piece, int64) + 1
    half = u / (2 * real(pieces, wp))
    sn = small_sn(half, motion%m, motion%complement)
    cn = sqrt(1 - sn**2)
    dn = sqrt(1 - motion%m * sn**2)
    do i = 1, pieces
      if (.not. max(abs(motion%cn), abs(motion%dn)) > tiny(1.0_wp)) then  ! on the second axis
        integral = integral + 2 * half * real(pieces - i + 1, wp)
        exit
      end if
      call add(motion, sn, cn, dn)
      integral = integral + even_integral(motion, sn)
      call add(motion, sn, cn, dn)
      if (pieces == 1) exit
      ! near the separatrix errors of the squares would grow as exp(u)
      error = (1 - motion%sn**2 - motion%cn**2) / 2
      motion%sn = motion%sn + error * motion%sn
      motion%cn = motion%cn + error * motion%cn
      motion%dn = sqrt(motion%complement + motion%m * motion%cn**2)
    end do
  end subroutine follow_pieces

  ! Moves the functions by a small argument. Changes are added, which round less near 1.
  pure subroutine add(motion, sn, cn, dn)
    type(motion_t), intent(inout) :: motion
    real(wp), intent(in) :: sn, cn, dn
    real(wp) :: s, c, d, less, rest_c, rest_d

    s = motion%sn
    c = motion%cn
    d = motion%dn
    less = motion%m * (s * sn)**2            ! 1 less the denominator
    rest_c = sn**2 / (1 + cn)                ! 1 - cn
    rest_d = motion%m * sn**2 / (1 + dn)     ! 1 - dn
    motion%sn = s + (sn * c * d - s * (rest_c + cn * rest_d - less)) / (1 - less)
    motion%cn = c - (s * d * sn * dn + c * (rest_c - less)) / (1 - less)
    motion%dn = d - (motion%m * s * c * sn * cn + d * (rest_d - less)) / (1 - less)
  end subroutine add

  ! The integral of 1 / (1 + a3 dn) over arguments from u - v to u + v, where `motion` is at u and
  ! sn is that of v: two halves added are a function of the square of sn.
  pure real(wp) function even_integral(motion, sn)
    type(motion_t), intent(in) :: motion
    real(wp), intent(in) :: sn
    real(wp), dimension(7) :: y, dn, denominator
    real(wp) :: d, s2, c2

    d = motion%a3 * motion%dn
    s2 = motion%m * motion%sn**2
    c2 = motion%m * (motion%a3 * motion%cn)**2
    y = sn**2 * node_square
    dn = sqrt(1 - motion%m * y)
    denominator = 1 - s2 * y
    even_integral = 2 * sn * sum(weight * (denominator + d * dn) &
                    / ((denominator + 2 * d * dn + (d**2 - c2 * y)) * (dn * sqrt(1 - y))))
  end function even_integral

  ! Jacobi's sn of a small argument, by Landen's descending transformation
  pure recursive real(wp) function small_sn(u, m, complement) result(sn)
    real(wp), intent(in) :: u, m, complement
    real(wp), parameter :: negligible = sqrt(epsilon(1.0_wp)) / 4   ! its square is rounding
    real(wp) :: k, modulus

    if (complement < epsilon(1.0_wp) / 4) then
      sn = tanh(u)
    else if (m <= negligible) then
      sn = sin(u)
      sn = sn - m / 4 * (u - sn * cos(u)) * cos(u)
    else
      k = sqrt(complement)
      modulus = m / (1 + k)**2
      sn = small_sn(u * (1 + k) / 2, modulus**2, 4 * k / (1 + k)**2)
      sn = (1 + modulus) * sn / (1 + modulus * sn**2)
    end if
  end function small_sn

  ! The complete elliptic integral of the first kind, by the arithmetic-geometric mean
  pure real(wp) function quarter_period(complement)
    real(wp), intent(in) :: complement
    real(wp) :: a, b, mean

    a = 1.0_wp
    b = sqrt(complement)
    do while (abs(a - b) > sqrt(epsilon(1.0_wp)) * a)
      mean = (a + b) / 2
      b = sqrt(a * b)
      a = mean
    end do
    quarter_period = pi / (a + b)
  end function quarter_period

  ! The quaternion B(n) (rotation by the angle about the third axis) B(after)^-1
  pure function turned(n, angle, after) result(q)
    real(wp), intent(in) :: n(3), angle, after(3)
    real(wp) :: q(4), length, sine, cosine, g(4), r(2), w

    length = sqrt(2 * (1 + n(3)))
    sine = sin(angle / 2) / length
    cosine = cos(angle / 2) / length
    g = [n(1) * sine - n(2) * cosine, n(2) * sine + n(1) * cosine, (1 + n(3)) * sine, &
         (1 + n(3)) * cosine]
    length = sqrt(2 * (1 + after(3)))
    r = [after(2), -after(1)] / length
    w = (1 + after(3)) / length
    q = [g(4) * r(1) + w * g(1) - g(3) * r(2), g(4) * r(2) + w * g(2) + g(3) * r(1), &
         w * g(3) + g(1) * r(2) - g(2) * r(1), w * g(4) - g(1) * r(1) - g(2) * r(2)]
  end function turned

end module rigid_body_m
