! Blocks, of which frames are products, and sequences of flows; bases of the Lie algebras of SO(n),
! SU(n) and U(n), those of cg/frames/rotations.py and matrix_groups.py.
module blocks_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_loc
  use kinds, only: wp
  use linear_action_m, only: linear_action_t
  use rigid_body_m, only: top_t
  use shared_numbers, only: commuting_roundings
  use vectors_m, only: add_multiple
  implicit none
  private
  public :: algebra_coefficients, algebra_matrix, as_complex, block_t, body_t, combine_flows, &
            find_velocities, flow_sequence_t, velocities

  ! Of dexp^-1, see algebra_m: |B_2k| / (2 k)! for k = 1, 2, ..., with Bernoulli's numbers
  real(wp), parameter, public :: beta(11) = [1 / 12.0_wp, 1 / 720.0_wp, 1 / 30240.0_wp, &
    1 / 1209600.0_wp, 1 / 47900160.0_wp, 691 / 1307674368000.0_wp, 1 / 74724249600.0_wp, &
    3617 / 10670622842880000.0_wp, 43867 / 5109094217170944000.0_wp, &
    174611 / 802857662698291200000.0_wp, 77683 / 1.4101100039391805e22_wp]
  ! Terms decrease by a factor 4 pi^2: those left out are below rounding in double precision.
  integer, parameter, public :: last_term = 11
  ! its radius of convergence; from half of it on dexp^-1 amplifies the rounding of zero brackets
  real(wp), parameter, public :: full_turn = 8 * atan(1.0_wp), half_turn = full_turn / 2
  real(wp), parameter, public :: series_below = 1.0_wp             ! the largest square of an angle
  ! relative brackets below this are rounding, sums of weights up to 40 in DOP853
  real(wp), parameter, public :: zero_bracket = commuting_roundings * epsilon(1.0_wp)
  real(wp), parameter, public :: min_length = sqrt(tiny(1.0_wp))   ! whose square doesn't underflow

  ! The element of a Lie algebra with given coefficients, and the coefficients of the orthogonal
  ! projection of a matrix onto it: real matrices for SO(n), complex ones for SU(n) and U(n)
  interface algebra_matrix
    module procedure skew_matrix, unitary_matrix
  end interface algebra_matrix
  interface algebra_coefficients
    module procedure coefficients_of_skew, coefficients_of_unitary
  end interface algebra_coefficients

  type :: block_t
    integer :: kind = 0
    logical :: space = .false., scalar_first = .false., polynomial = .false.
    integer :: n = 0            ! n of R^n, SO(n), SU(n), U(n), rows of matrices
    integer :: k = 0            ! columns of matrices that aren't square, translations of SE(3)
    integer :: constants = 0    ! constants of the blocks before
    integer :: v1 = 1, v2 = 0   ! the first and the last of its coefficients among all
    integer :: p1 = 1, p2 = 0   ! the first and the last of its entries of a point
    integer :: dimension = 0    ! number of coefficients
    integer :: point_size = 0   ! number of entries of a point
    type(linear_action_t) :: action
  end type block_t

  ! The inertia of a block of a mechanical system
  type :: body_t
    real(wp), allocatable :: inverse(:, :)   ! (n, n), or (n, 1) if it is diagonal
    real(wp), allocatable :: root(:, :)      ! R of the inertia, with J = R R', (n, n) or (n, 1)
    ! matrix of a force linear in the velocity, if any; whether its flow commutes with free motion
    real(wp), allocatable :: gyroscopic(:, :)
    logical :: commutes = .true.
    logical :: turns = .false.               ! whether it is a rigid body that turns about any axis
    type(top_t) :: top                       ! if it turns
  end type body_t

  ! Time-1 flows one after the other; flow j is along the sum of weight(k) times the field stage(k),
  ! over its terms k = first(j), ..., first(j + 1) - 1, at least one. For a polynomial block all
  ! are one flow: the sum of flow j is the coefficient of (2 t - 1)^(j - 1) in the field at time t.
  type :: flow_sequence_t
    integer, allocatable :: first(:)         ! (flows + 1)
    real(wp), allocatable :: weight(:)       ! (terms)
    integer, allocatable :: stage(:)         ! (terms)
  end type flow_sequence_t

contains

  ! The complex matrix that is held in real numbers
  function as_complex(n, numbers) result(view)
    integer, intent(in) :: n
    real(wp), contiguous, target, intent(in) :: numbers(:)
    complex(wp), pointer, contiguous :: view(:, :)

    call c_f_pointer(c_loc(numbers), view, [n, n])
  end function as_complex

  ! The skew matrix with coefficients v of cg/frames/rotations.py
  pure subroutine skew_matrix(n, v, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    real(wp), intent(out) :: x(n, n)
    integer :: i, j, k

    k = size(v)
    do i = 1, n
      x(i, i) = 0.0_wp
      do j = i + 1, n
        x(j, i) = merge(v(k), -v(k), modulo(i + j, 2) == 1)
        x(i, j) = -x(j, i)
        k = k - 1
      end do
    end do
  end subroutine skew_matrix

  ! The coefficients of the skew part of a matrix
  pure subroutine coefficients_of_skew(n, x, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    integer :: i, j, k

    k = size(v)
    do i = 1, n
      do j = i + 1, n
        v(k) = merge(0.5_wp, -0.5_wp, modulo(i + j, 2) == 1) * (x(j, i) - x(i, j))
        k = k - 1
      end do
    end do
  end subroutine coefficients_of_skew

  ! The element of the Lie algebra of SU(n) or U(n) with coefficients v
  pure subroutine unitary_matrix(n, v, x)
    integer, intent(in) :: n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    complex(wp), intent(out) :: x(n, n)
    real(wp) :: d
    integer :: i, j, k

    x = cmplx(0.0_wp, 0.0_wp, wp)
    k = 1
    do j = 2, n
      do i = 1, j - 1
        x(i, j) = cmplx(-v(k + 1) / 2, -v(k) / 2, wp)
        x(j, i) = cmplx(v(k + 1) / 2, -v(k) / 2, wp)
        k = k + 2
      end do
      d = diagonal(j) * v(k) / 2
      do i = 1, j - 1
        x(i, i) = x(i, i) - cmplx(0.0_wp, d, wp)
      end do
      x(j, j) = x(j, j) + cmplx(0.0_wp, real(j - 1, wp) * d, wp)
      k = k + 1
    end do
    if (size(v) == n**2) then                    ! U(n)
      d = sqrt(2 / real(n, wp)) * v(k) / 2
      do i = 1, n
        x(i, i) = x(i, i) - cmplx(0.0_wp, d, wp)
      end do
    end if
  end subroutine unitary_matrix

  ! The coefficients of the projection of a matrix
  pure subroutine coefficients_of_unitary(n, x, v)
    integer, intent(in) :: n
    complex(wp), intent(in) :: x(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    real(wp) :: total
    integer :: i, j, k

    k = 1
    total = 0.0_wp
    do j = 2, n
      total = total + aimag(x(j - 1, j - 1))
      do i = 1, j - 1
        v(k) = -aimag(x(i, j) + x(j, i))
        v(k + 1) = real(x(j, i) - x(i, j), wp)
        k = k + 2
      end do
      v(k) = -diagonal(j) * (total - real(j - 1, wp) * aimag(x(j, j)))
      k = k + 1
    end do
    if (size(v) == n**2) v(k) = -sqrt(2 / real(n, wp)) * (total + aimag(x(n, n)))
  end subroutine coefficients_of_unitary

  ! The normalisation of the diagonal basis matrix j
  pure real(wp) function diagonal(j)
    integer, intent(in) :: j

    diagonal = sqrt(2 / (real(j - 1, wp) * real(j, wp)))
  end function diagonal

  ! Computes the velocities of a body. The result of a function would be allocated for each call.
  pure subroutine find_velocities(body, n, momentum, velocities)
    type(body_t), intent(in) :: body
    integer, intent(in) :: n
    real(wp), intent(in) :: momentum(n)
    real(wp), intent(out) :: velocities(n)
    integer :: i

    if (size(body%inverse, 2) == 1) then
      velocities = body%inverse(:, 1) * momentum
    else
      velocities = body%inverse(:, 1) * momentum(1)
      do i = 2, n
        velocities = velocities + body%inverse(:, i) * momentum(i)
      end do
    end if
  end subroutine find_velocities

  ! Computes the velocities J^-1 mu of some bodies.
  pure subroutine velocities(blocks, bodies, span, momenta, omega)
    type(block_t), intent(in) :: blocks(:)
    type(body_t), intent(in) :: bodies(:)
    integer, intent(in) :: span(2)                     ! the first and the last block
    real(wp), intent(in) :: momenta(:)                 ! those of these bodies
    real(wp), intent(out) :: omega(:)
    integer :: i

    do i = span(1), span(2)
      associate (v => blocks(i)%v1 - blocks(span(1))%v1, n => blocks(i)%dimension)
        call find_velocities(bodies(i), n, momenta(v + 1:v + n), omega(v + 1:v + n))
      end associate
    end do
  end subroutine velocities

  ! Computes the coefficients of some flows from those of the fields.
  pure subroutine combine_flows(flows, weight, begin, last, m, f, v)
    type(flow_sequence_t), intent(in) :: flows
    integer, intent(in) :: begin, last, m
    real(wp), intent(in) :: weight(*), f(m, *)         ! weight: those of the flows times the step
    real(wp), intent(out) :: v(m, begin:last)
    integer :: i, j

    do j = begin, last
      associate (k => flows%first(j), terms => flows%first(j + 1) - flows%first(j))
        select case (m)                      ! frequent sizes, which the compiler then knows
        case (3)
          call add_terms(3, terms, weight(k), flows%stage(k), f, v(1, j))
        case (6)
          call add_terms(6, terms, weight(k), flows%stage(k), f, v(1, j))
        case default
          v(:, j) = weight(k) * f(:, flows%stage(k))
          do i = k + 1, k + terms - 1
            call add_multiple(m, weight(i), f(1, flows%stage(i)), v(1, j))
          end do
        end select
      end associate
    end do
  end subroutine combine_flows

  ! Adds some of the columns of f with weights, of a length that is known where it is called.
  pure subroutine add_terms(m, terms, weight, stage, f, v)
    integer, intent(in) :: m, terms, stage(terms)
    real(wp), intent(in) :: weight(terms), f(m, *)
    real(wp), intent(out) :: v(m)
    integer :: k

    v = weight(1) * f(:, stage(1))
    do k = 2, terms
      v = v + weight(k) * f(:, stage(k))
    end do
  end subroutine add_terms

end module blocks_m
