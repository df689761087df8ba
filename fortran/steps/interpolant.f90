! The solution within one step, on the manifold and as accurate as the step, in one of two forms.
! cg/integration/step/interpolant.py derives their coefficients.
!
! On a Lie algebra the coordinates of y = exp(u) y0 are a polynomial,
!
!   u(theta) = h sum_d phi_d(theta) sum_j basis_jd k_j,
!   phi_d = theta, theta (1 - theta), theta^2 (1 - theta), theta^2 (1 - theta)^2, ...,
!
! in derivatives k_j of coordinates: those at the stages of a flat method, or that at the start and
! the mean u(1) / h, then that at the end, and those at further nodes, each evaluated where the ones
! before it lead. One flow reaches a point.
!
! Elsewhere the coefficients F(theta) = f(t0 + theta h, y(theta)) are interpolated by a polynomial P
! at nodes 0 = theta_1 < ... < theta_n = 1. The flows that lead to the method's result solve
! z' = h sum_i P_i(theta) E_i(z), z(0) = y0, to the order of the method, without evaluations of f.
! One more flow moves z(1) to y1:
!
!   y(theta) = exp(w(theta) v) z(theta),   exp(v) z(1) = y1,   w(theta) = W(theta) / W(1),
!
! where W is the integral of omega(s) = (s - theta_1) ... (s - theta_n). The error of P is omega
! times a constant in leading order, so that this flow removes it, and the error is O(h^(n + 2)).
! Nodes are added one at a time: the coefficients at n + 1 nodes are evaluated where the interpolant
! with n nodes leads. For linear equations with flows along polynomials, z with nodes at the stages
! is y, without a last flow.
module interpolant_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use coordinates_m, only: difference
  use blocks_m, only: flow_sequence_t
  use frames_m, only: apply_flows, flow_along, frame_t
  use linear_action_m, only: inner_points_t
  use shared_numbers, only: nearby_operation
  use vectors_m, only: combine
  implicit none
  private
  public :: scheme_t, interpolant_t, add_node, begin_interpolant, evaluate_inner, &
            evaluate_interpolant, &
            flows_of_evaluation, make_cubic, next_node, reserve_interpolant, set_ends

  ! The coefficients of the interpolants of a method
  type :: scheme_t
    integer :: columns = 0                   ! of an interpolant's coefficients; 0: not yet known
    logical :: at_stages = .false.           ! whether the stages are all nodes, at known times
    ! on a Lie algebra
    logical :: flat = .false.                ! whether the stages of a flat method are used
    integer :: final = 0                     ! the derivative at the end
    integer :: series = 0                    ! order up to which dexp^-1 is needed
    real(wp), allocatable :: theta(:)        ! (extra) further nodes
    real(wp), allocatable :: row(:, :)       ! (derivatives, extra) what leads there
    real(wp), allocatable :: basis(:, :)     ! (derivatives, degree)
    ! elsewhere
    integer :: nodes = 2
    real(wp), allocatable :: node(:, :)      ! (nodes, 2:nodes) column n has n nodes
    real(wp), allocatable :: blend(:, :)     ! (0:nodes + 1, 2:nodes) coefficients of w for n nodes
    real(wp), allocatable :: c(:)            ! (stages) abscissae of those that lead to the result
    real(wp), allocatable :: weight(:, :)    ! (stages, flows)
  end type scheme_t

  type :: interpolant_t
    logical :: on_algebra = .false.
    logical :: complete = .false.
    integer :: known = 0                     ! derivatives, or nodes of the interpolant so far
    integer :: node = 0                      ! the next one, of the interpolant with one node more
    integer :: nexp = 0                      ! flows that it took
    real(wp) :: t0 = 0.0_wp
    real(wp) :: h = 0.0_wp
    real(wp), allocatable :: y0(:), y1(:)    ! (point_size)
    ! workspace: coordinates (dimension), a point (point_size), weights (derivatives)
    real(wp), allocatable :: u(:), y(:), weight(:)
    type(flow_sequence_t) :: flows           ! to a point, along the columns of `field`
    ! (dimension, columns) those of h phi_d; or coefficients at nodes, and of the last flow
    real(wp), allocatable :: field(:, :)
    ! (dimension, derivatives) or (dimension, nodes) coefficients at the nodes of the next one
    real(wp), allocatable :: next(:, :)
  end type interpolant_t

  integer, parameter :: iterations = 20
  real(wp), parameter :: converged = sqrt(epsilon(1.0_wp)) / 8   ! its square is below rounding

contains

  ! Allocates the memory of an interpolant once.
  subroutine reserve_interpolant(frame, scheme, interpolant, memory)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    integer, intent(out) :: memory           ! nonzero if there isn't enough

    memory = 0
    if (allocated(interpolant%y0)) return
    allocate (interpolant%y0(frame%point_size), interpolant%y1(frame%point_size), &
              interpolant%u(frame%dimension), interpolant%y(frame%point_size), &
              interpolant%weight(max(1, size(scheme%basis, 1), size(scheme%basis, 2))), &
              interpolant%field(frame%dimension, scheme%columns), &
              interpolant%next(frame%dimension, max(scheme%nodes, size(scheme%basis, 1))), &
              interpolant%flows%first(size(scheme%weight, 2) + 2), &
              interpolant%flows%weight(size(scheme%weight, 2) * scheme%nodes + 1), &
              interpolant%flows%stage(size(scheme%weight, 2) * scheme%nodes + 1), stat=memory)
  end subroutine reserve_interpolant

  ! Gives an interpolant the ends of its step.
  pure subroutine set_ends(interpolant, t0, h, y0, y1, first, last)
    type(interpolant_t), intent(inout) :: interpolant
    real(wp), intent(in) :: t0, h
    real(wp), contiguous, intent(in) :: y0(:), y1(:)         ! (point_size)
    real(wp), contiguous, intent(in) :: first(:), last(:)    ! (dimension) coefficients at the ends

    interpolant%t0 = t0
    interpolant%h = h
    interpolant%y0(:) = y0
    interpolant%y1(:) = y1
    interpolant%field(:, 1) = first
    interpolant%field(:, 2) = last
  end subroutine set_ends

  ! Starts an interpolant from the ends and the stages of its step.
  subroutine begin_interpolant(frame, scheme, free, stages, interpolant, exists)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    logical, intent(in) :: free              ! whether coordinates are known from the ends
    real(wp), intent(in) :: stages(:, :)     ! (dimension, stages) of a flat method, derivatives
    type(interpolant_t), intent(inout) :: interpolant
    logical, intent(out) :: exists           ! false if the step is too long for coordinates

    interpolant%nexp = 0
    interpolant%complete = .false.
    interpolant%on_algebra = .not. scheme%at_stages .and. (scheme%flat .or. free)
    if (scheme%at_stages) then
      interpolant%known = scheme%nodes
      interpolant%field(:, :scheme%nodes) = stages
      interpolant%field(:, scheme%nodes + 1) = 0.0_wp  ! there is no last flow
      interpolant%complete = .true.
      exists = .true.
      return
    end if
    if (.not. interpolant%on_algebra) then
      call begin_flows(frame, scheme, interpolant)
      exists = .true.
      return
    end if
    associate (k => interpolant%next, final => scheme%final, h => interpolant%h, &
               first => interpolant%field(:, 1), last => interpolant%field(:, 2))
      if (scheme%flat) then
        k(:, :size(stages, 2)) = stages
        interpolant%known = max(size(stages, 2), final)
        exists = .true.
        if (final > size(stages, 2)) then
          k(:, final) = last
          interpolant%weight(:size(stages, 2)) = h * scheme%basis(:size(stages, 2), 1)
          call combine(frame%dimension, size(stages, 2), interpolant%weight, k, interpolant%u)
          call dexpinv(frame, scheme%series, interpolant%u, k(:, final), exists)
        end if
      else
        k(:, 1) = first
        interpolant%known = final
        call find_mean(frame, scheme, interpolant, exists)
        k(:, final) = last
        if (exists) call dexpinv(frame, scheme%series, h * k(:, 2), k(:, final), exists)
      end if
    end associate
    call finish_or_fall_back(frame, scheme, interpolant, exists)
  end subroutine begin_interpolant

  ! Finishes an interpolant in coordinates if all derivatives are known. If the step is too long for
  ! coordinates and the method doesn't need them, the other form is used.
  subroutine finish_or_fall_back(frame, scheme, interpolant, exists)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    logical, intent(inout) :: exists

    if (exists) then
      if (interpolant%known < size(scheme%basis, 1)) return
      call sum_terms(scheme, size(scheme%basis, 2), interpolant)
      interpolant%complete = .true.
    else if (.not. scheme%flat) then
      exists = .true.
      interpolant%on_algebra = .false.
      call begin_flows(frame, scheme, interpolant)
    end if
  end subroutine finish_or_fall_back

  ! Computes the coordinates of y1 by Newton's method, starting from the mean of the coefficients at
  ! both ends, which selects the branch of the logarithm that the solution follows.
  subroutine find_mean(frame, scheme, interpolant, exists)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    logical, intent(out) :: exists
    real(wp) :: u(frame%dimension), v(frame%dimension), y(frame%point_size)
    integer :: i

    u = interpolant%h * (interpolant%field(:, 1) + interpolant%field(:, 2)) / 2
    do i = 1, iterations
      y = interpolant%y0
      call flow_along(frame, u, y)
      interpolant%nexp = interpolant%nexp + 1
      call difference_nearby(frame, y, interpolant%y1, v)
      call dexpinv(frame, scheme%series, u, v, exists)
      if (.not. exists) return
      u = u + v
      exists = all(abs(v) <= converged * max(1.0_wp, maxval(abs(u))))   ! not if v is NaN
      if (exists) exit
    end do
    interpolant%next(:, 2) = u / interpolant%h
  end subroutine find_mean

  ! Computes a difference of nearby points on any frame.
  subroutine difference_nearby(frame, x, y, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: x(:), y(:)
    real(wp), contiguous, intent(out) :: v(:)

    call difference(frame, x, y, v)
    if (.not. all(abs(v) <= huge(v)) .and. associated(frame%callback)) then
      call frame%callback%apply(nearby_operation, x, y, v)
    end if
  end subroutine difference_nearby

  ! Lets an interpolant that has begun be evaluated before it is complete. Coordinates are then the
  ! cubic of Hermite, or a multiple of those of y1 where the derivative at the end doesn't exist.
  subroutine make_cubic(scheme, exists, interpolant)
    type(scheme_t), intent(in) :: scheme
    logical, intent(in) :: exists            ! as from begin_interpolant
    type(interpolant_t), intent(inout) :: interpolant

    if (.not. interpolant%on_algebra) return           ! it has two nodes already
    interpolant%field = 0.0_wp
    call sum_terms(scheme, merge(3, 1, exists), interpolant)
  end subroutine make_cubic

  ! Computes the first coefficients of the polynomial from the derivatives.
  subroutine sum_terms(scheme, terms, interpolant)
    type(scheme_t), intent(in) :: scheme
    integer, intent(in) :: terms
    type(interpolant_t), intent(inout) :: interpolant
    integer :: d

    associate (n => interpolant%known)
      do d = 1, terms
        interpolant%weight(:n) = interpolant%h * scheme%basis(:n, d)
        call combine(size(interpolant%u), n, interpolant%weight, interpolant%next, &
                     interpolant%field(:, d))
      end do
    end associate
  end subroutine sum_terms

  ! Computes the point of the next node.
  subroutine next_node(frame, scheme, interpolant, theta)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant        ! its y becomes the point
    real(wp), intent(out) :: theta

    if (interpolant%on_algebra) then
      associate (n => interpolant%known, &
                 extra => interpolant%known - size(scheme%basis, 1) + size(scheme%theta) + 1)
        theta = scheme%theta(extra)
        interpolant%weight(:n) = interpolant%h * scheme%row(:n, extra)
        call combine(frame%dimension, n, interpolant%weight, interpolant%next, interpolant%u)
      end associate
      interpolant%y(:) = interpolant%y0
      call flow_along(frame, interpolant%u, interpolant%y)
    else
      theta = scheme%node(interpolant%node, interpolant%known + 1)
      call evaluate_interpolant(frame, scheme, interpolant, theta, interpolant%y)
    end if
    interpolant%nexp = interpolant%nexp + flows_of_evaluation(scheme, interpolant)
  end subroutine next_node

  ! Stores the coefficients at the node.
  subroutine add_node(frame, scheme, f, interpolant, exists)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    real(wp), contiguous, intent(in) :: f(:)                 ! (dimension)
    type(interpolant_t), intent(inout) :: interpolant
    logical, intent(out) :: exists

    exists = .true.
    associate (n => interpolant%known)
      if (interpolant%on_algebra) then
        interpolant%next(:, n + 1) = f
        call dexpinv(frame, scheme%series, interpolant%u, interpolant%next(:, n + 1), exists)
        n = n + 1
        call finish_or_fall_back(frame, scheme, interpolant, exists)
        return
      end if
      interpolant%next(:, interpolant%node) = f
      interpolant%node = interpolant%node + 1
      if (interpolant%node <= n) return
      interpolant%field(:, n + 1) = interpolant%field(:, n)
      interpolant%field(:, 2:n) = interpolant%next(:, 2:n)
      n = n + 1
      call add_last_flow(frame, scheme, interpolant)
    end associate
  end subroutine add_node

  ! Starts an interpolant by flows.
  subroutine begin_flows(frame, scheme, interpolant)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant

    interpolant%known = 2
    call add_last_flow(frame, scheme, interpolant)
  end subroutine begin_flows

  ! Computes the last flow, which reaches the end of the step.
  subroutine add_last_flow(frame, scheme, interpolant)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    real(wp) :: reached(frame%point_size), v(frame%dimension)

    interpolant%field(:, interpolant%known + 1) = 0.0_wp
    call evaluate_interpolant(frame, scheme, interpolant, 1.0_wp, reached)
    call difference_nearby(frame, reached, interpolant%y1, v)
    interpolant%field(:, interpolant%known + 1) = v
    interpolant%nexp = interpolant%nexp + flows_of_evaluation(scheme, interpolant)
    interpolant%node = 2
    interpolant%complete = interpolant%known == scheme%nodes
  end subroutine add_last_flow

  ! The number of flows that one evaluation takes
  pure integer function flows_of_evaluation(scheme, interpolant)
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(in) :: interpolant

    flows_of_evaluation = 1
    if (interpolant%on_algebra .or. scheme%at_stages) return
    flows_of_evaluation = size(scheme%weight, 2) + 1
  end function flows_of_evaluation

  ! Evaluates the interpolant at a fraction of the step.
  subroutine evaluate_interpolant(frame, scheme, interpolant, theta, y)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    real(wp), intent(in) :: theta            ! 0 to 1
    real(wp), contiguous, intent(out) :: y(:)                ! (point_size)
    integer :: d

    y = interpolant%y0
    if (interpolant%on_algebra) then
      interpolant%weight(1) = theta
      do d = 2, size(scheme%basis, 2)
        interpolant%weight(d) = interpolant%weight(d - 1) &
                                * merge(theta, 1 - theta, modulo(d, 2) == 1)
      end do
      call combine(frame%dimension, size(scheme%basis, 2), interpolant%weight, interpolant%field, &
                   interpolant%u)
      call flow_along(frame, interpolant%u, y)
    else
      call follow_flows(frame, scheme, interpolant, theta, y)
    end if
  end subroutine evaluate_interpolant

  ! Evaluates the interpolant at some fractions by one flow along a polynomial.
  subroutine evaluate_inner(frame, scheme, interpolant, inner, theta, y)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    type(inner_points_t), intent(inout) :: inner       ! that of the frame
    real(wp), intent(in) :: theta(:)         ! between 0 and 1
    real(wp), intent(out) :: y(:, :)         ! (point_size, fractions)
    real(wp) :: reached(frame%point_size)
    logical :: left(size(theta))
    integer :: k, order(size(theta))

    left = .true.
    do k = 1, size(theta)
      order(k) = minloc(theta, 1, left)
      left(order(k)) = .false.
    end do
    inner%count = size(theta)
    inner%theta = theta(order)
    inner%y = y
    inner%wanted = .true.
    call evaluate_interpolant(frame, scheme, interpolant, 1.0_wp, reached)
    y(:, order) = inner%y
  end subroutine evaluate_inner

  ! Moves a point along the flows of the second form.
  subroutine follow_flows(frame, scheme, interpolant, theta, y)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    type(interpolant_t), intent(inout) :: interpolant
    real(wp), intent(in) :: theta
    real(wp), contiguous, intent(inout) :: y(:)
    real(wp) :: basis(interpolant%known, size(scheme%c))
    integer :: i, j, k

    associate (n => interpolant%known, last => size(scheme%weight, 2) + 1, &
               flows => interpolant%flows)
      call lagrange(scheme, n, theta, interpolant%h, basis)
      k = 0
      do i = 1, last - 1
        flows%first(i) = k + 1
        do j = 1, n
          k = k + 1
          flows%weight(k) = dot_product(basis(j, :), scheme%weight(:, i))
          flows%stage(k) = j
        end do
      end do
      flows%first(last:last + 1) = [k + 1, k + 2]
      flows%weight(k + 1) = blend_at(scheme, n, theta)
      flows%stage(k + 1) = n + 1
      call apply_flows(frame, flows, 1, last, interpolant%field, y)
    end associate
  end subroutine follow_flows

  ! Lagrange's polynomials at the abscissae of the stages, times the step from 0 to theta
  pure subroutine lagrange(scheme, n, theta, h, basis)
    type(scheme_t), intent(in) :: scheme
    integer, intent(in) :: n
    real(wp), intent(in) :: theta, h
    real(wp), intent(out) :: basis(:, :)                     ! (n, stages)
    integer :: i, j, k

    do k = 1, size(scheme%c)
      do j = 1, n
        basis(j, k) = theta * h
        do i = 1, n
          if (i == j) cycle
          basis(j, k) = basis(j, k) * ((theta * scheme%c(k) - scheme%node(i, n)) &
                                       / (scheme%node(j, n) - scheme%node(i, n)))
        end do
      end do
    end do
  end subroutine lagrange

  ! The polynomial w(theta) for n nodes
  pure real(wp) function blend_at(scheme, n, theta)
    type(scheme_t), intent(in) :: scheme
    integer, intent(in) :: n
    real(wp), intent(in) :: theta
    integer :: k

    blend_at = 0.0_wp
    do k = n + 1, 0, -1
      blend_at = blend_at * theta + scheme%blend(k, n)
    end do
  end function blend_at

end module interpolant_m
