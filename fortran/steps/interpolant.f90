! The solution within one step, on the manifold and as accurate as the step, in one of two forms
! that cg/construction/methods/interpolant.py explains: on a Lie algebra, or by flows.
!
! On a Lie algebra the coordinates are u(theta) = h sum_d phi_d(theta) sum_j basis_jd k_j.
!
! By flows, a polynomial P through the coefficients at nodes leads to z(theta), and one more flow
! moves it to y(theta) = exp(w(theta) v) z(theta), with exp(v) z(1) = y1. Nodes are added one at a
! time, with splitting methods two: the coefficients at them are evaluated where the interpolant
! with fewer nodes leads. For linear equations with flows along polynomials, z with nodes at the
! stages is y, without a last flow.
!
! Where there are many v, the shortest one may be far from the error of P. This happens if isotropy
! turns much within the step, as near singular matrices. There v composes in the group the flows to
! z(1), backward, and the flows of the step.
!
! Where noise is in the middle of a step, its second half is followed backward from y1. The last
! flow then moves positions alone, which meet in the middle: elsewhere they move with their momenta.
module interpolant_m
  use algebra_m, only: dexpinv
  use coordinates_m, only: difference
  use frames_m, only: apply_flows, frame_t
  use free_motion_m, only: make_tangential, move_by_impulses, try_close_joints
  use kinds, only: wp
  use linear_action_m, only: inner_points_t, move_polynomially
  use method_m, only: scheme_t
  use shared_numbers, only: nearby_operation, nearest_operation
  use vectors_m, only: combine
  implicit none
  private
  public :: add_node, begin_interpolant, evaluate_inner, evaluate_interpolant, &
            flows_of_evaluation, interpolant_t, make_cubic, next_node, reserve_interpolant

  type :: interpolant_t
    type(frame_t), pointer :: frame => null()
    type(scheme_t), pointer :: scheme => null()
    logical :: needed = .false.              ! whether a cubic isn't enough for output and events
    logical :: on_algebra = .false., complete = .false.
    logical :: noisy = .false.               ! whether noise is in the middle of the step
    integer :: known = 0                     ! derivatives or nodes so far, their number
    integer :: node = 0                      ! the next node, of the interpolant with more nodes
    integer :: nexp = 0                      ! flows followed that aren't counted yet
    real(wp) :: t0 = 0.0_wp, h = 0.0_wp
    real(wp), allocatable :: y0(:), y1(:)    ! (point_size)
    ! (dimension times flows) the flows of the step on a frame in Python, if f at stages is stored
    real(wp), allocatable :: step_flows(:)
    ! workspace: coordinates (dimension), a point (point_size), weights (derivatives)
    real(wp), allocatable :: u(:), y(:), weight(:)
    real(wp), allocatable :: v(:, :)         ! (dimension, flows) of the flows to a point
    ! (dimension, vectors) those that h phi_d multiply; or f at nodes, then v of the last flow
    real(wp), allocatable :: vectors(:, :)
    ! (dimension, derivatives) k_j; or (dimension, nodes) f at nodes of the next interpolant
    real(wp), allocatable :: next(:, :)
  end type interpolant_t

  integer, parameter :: max_iterations = 20                      ! of Newton's method in find_mean
  real(wp), parameter :: converged = sqrt(epsilon(1.0_wp)) / 8   ! with a square below rounding

contains

  ! Allocates the memory of an interpolant, and gives it its frame and scheme.
  subroutine reserve_interpolant(frame, scheme, self, alloc_status)
    type(frame_t), target, intent(in) :: frame
    type(scheme_t), target, intent(in) :: scheme
    type(interpolant_t), intent(inout) :: self
    integer, intent(out) :: alloc_status     ! nonzero if an allocation failed

    self%frame => frame
    self%scheme => scheme
    associate (n => frame%point_size, m => frame%dimension, derivatives => size(scheme%basis, 1))
      allocate (self%step_flows(0), self%y0(n), self%y1(n), self%u(m), self%y(n), &
                self%weight(max(1, derivatives, size(scheme%basis, 2))), &
                self%vectors(m, scheme%vectors), self%next(m, max(scheme%nodes, derivatives)), &
                self%v(m, size(scheme%weight, 2) + 1), stat=alloc_status)
    end associate
    if (alloc_status == 0) self%vectors = 0.0_wp  ! all are stored, whether they are used or not
  end subroutine reserve_interpolant

  ! The number of nodes of the next interpolant. Forces of splitting methods depend on the position
  ! alone, whose error is smaller by a power of the step, so that two nodes are added at a time.
  pure integer function next_count(self)
    type(interpolant_t), intent(in) :: self

    next_count = self%known + 1
    if (allocated(self%scheme%drift) .and. modulo(self%scheme%nodes - self%known, 2) == 0) &
      next_count = self%known + 2
  end function next_count

  ! Gives an interpolant by flows its number of nodes, and the last flow, from z(1) to y1.
  subroutine add_last_flow(nodes, self)
    integer, intent(in) :: nodes
    type(interpolant_t), intent(inout) :: self
    real(wp), dimension(self%frame%point_size) :: reached, aim         ! z(1) and y1
    real(wp) :: v(self%frame%dimension)

    self%known = nodes
    self%vectors(:, nodes + 1) = 0.0_wp
    reached = self%y0
    aim = self%y1
    call follow_flows(self, merge(nearest(0.5_wp, -1.0_wp), 1.0_wp, self%noisy), reached)
    if (self%noisy) call follow_flows(self, 0.5_wp, aim)
    if (size(self%step_flows) > 0) then
      call self%frame%callback%apply(nearest_operation, &
        [reached, -self%v(:, size(self%v, 2) - 1:1:-1), self%step_flows], aim, v)
    else
      call difference_nearby(self%frame, reached, aim, nearest_operation, v)
    end if
    if (self%noisy) v(self%frame%forces + 1:) = 0.0_wp
    if (all(abs(v) <= huge(v))) self%vectors(:, nodes + 1) = v
    self%nexp = self%nexp + size(self%v, 2)
    self%node = 2
    self%complete = nodes == self%scheme%nodes
  end subroutine add_last_flow

  ! Computes a difference of nearby points on any frame, in Python where it isn't known here.
  subroutine difference_nearby(frame, x, y, operation, v)
    type(frame_t), intent(in) :: frame
    real(wp), contiguous, intent(in) :: x(:), y(:)
    integer, intent(in) :: operation         ! nearby_operation or nearest_operation
    real(wp), contiguous, intent(out) :: v(:)

    call difference(frame, x, y, v)
    if (.not. all(abs(v) <= huge(v)) .and. associated(frame%callback)) &
      call frame%callback%apply(operation, x, y, v)
  end subroutine difference_nearby

  ! Moves y to the point at a fraction of the step; with `inner`, one flow leads to others too.
  subroutine follow_flows(self, theta, y, inner)
    type(interpolant_t), intent(inout) :: self
    real(wp), intent(in) :: theta
    real(wp), contiguous, intent(inout) :: y(:)
    type(inner_points_t), optional, intent(inout) :: inner
    real(wp) :: basis(self%known, size(self%scheme%c)), begin, w
    integer :: i

    begin = merge(1.0_wp, 0.0_wp, self%noisy .and. theta >= 0.5_wp)
    if (begin > 0) y = self%y1
    associate (n => self%known, last => size(self%scheme%weight, 2) + 1, v => self%v, &
               k => self%frame%momenta_offset)
      call lagrange(self%scheme, n, begin, theta - begin, self%h, basis)
      do i = 1, last - 1
        call combine(self%frame%dimension, n, matmul(basis, self%scheme%weight(:, i)), &
                     self%vectors, v(:, i))
      end do
      w = 0.0_wp
      do i = n + 1, 0, -1
        w = w * theta + self%scheme%blend(i, n)
      end do
      if (self%noisy) w = theta - begin
      v(:, last) = w * self%vectors(:, n + 1)
      if (allocated(self%scheme%drift)) then
        call move_by_impulses(self%frame, v, (theta - begin) * self%h * self%scheme%drift, y)
        call apply_flows(self%frame, 1, v(:, last), y)
        call make_tangential(self%frame, y(:k), y(k + 1:))
      else if (present(inner)) then
        call move_polynomially(self%frame%blocks(1)%action, v, 0.0_wp, y, inner)
      else
        call apply_flows(self%frame, last, v, y)
      end if
    end associate
  end subroutine follow_flows

  ! Lagrange's polynomials at the abscissae of the stages of a part of the step, times its size
  pure subroutine lagrange(scheme, n, begin, length, h, basis)
    type(scheme_t), intent(in) :: scheme
    integer, intent(in) :: n
    real(wp), intent(in) :: begin, length, h
    real(wp), intent(out) :: basis(:, :)                     ! (n, stages)
    integer :: i, j

    do j = 1, n
      basis(j, :) = length * h
      do i = 1, n
        if (i == j) cycle
        basis(j, :) = basis(j, :) * ((begin + length * scheme%c - scheme%node(i, n)) &
                                     / (scheme%node(j, n) - scheme%node(i, n)))
      end do
    end do
  end subroutine lagrange

  ! Starts an interpolant from the ends and the stages of its step.
  subroutine begin_interpolant(unique_flows, stages, self, exists)
    logical, intent(in) :: unique_flows      ! whether the ends determine coordinates
    real(wp), intent(in) :: stages(:, :)     ! (dimension, stages) of a flat method, derivatives
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists           ! false if the step is too long for coordinates

    exists = .true.
    self%nexp = 0
    self%complete = self%scheme%at_stages
    self%on_algebra = .not. (self%scheme%at_stages .or. allocated(self%scheme%drift)) &
                      .and. (self%scheme%flat .or. unique_flows)
    if (self%scheme%at_stages) then
      self%known = self%scheme%nodes
      self%vectors(:, :self%scheme%nodes) = stages
      self%vectors(:, self%scheme%nodes + 1) = 0.0_wp  ! there is no last flow
      return
    end if
    if (.not. self%on_algebra) then
      call add_last_flow(2, self)
      return
    end if
    associate (k => self%next, final => self%scheme%final, n => size(stages, 2))
      if (self%scheme%flat) then
        k(:, :n) = stages
        self%known = max(n, final)
        self%weight(:n) = self%h * self%scheme%basis(:n, 1)
        if (final > n) call combine(self%frame%dimension, n, self%weight, k, self%u)
      else
        k(:, 1) = self%vectors(:, 1)
        self%known = final
        call find_mean(self, exists)
      end if
      if (exists .and. (final > n .or. .not. self%scheme%flat)) then   ! the end isn't a stage
        k(:, final) = self%vectors(:, 2)
        call dexpinv(self%frame, self%scheme%series, self%u, k(:, final), exists)
      end if
    end associate
    call finish_or_fall_back(self, exists)
  end subroutine begin_interpolant

  ! Finishes an interpolant in coordinates, or takes the other form if the step is too long.
  subroutine finish_or_fall_back(self, exists)
    type(interpolant_t), intent(inout) :: self
    logical, intent(inout) :: exists

    if (exists) then
      if (self%known < size(self%scheme%basis, 1)) return
      call sum_terms(size(self%scheme%basis, 2), self)
      self%complete = .true.
    else if (.not. self%scheme%flat) then
      exists = .true.
      self%on_algebra = .false.
      call add_last_flow(2, self)
    end if
  end subroutine finish_or_fall_back

  ! Computes the coordinates of y1 by Newton's method, starting from the mean of the coefficients at
  ! both ends, which selects the branch of the logarithm that the solution follows.
  subroutine find_mean(self, exists)
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists
    integer :: i

    self%u = self%h * (self%vectors(:, 1) + self%vectors(:, 2)) / 2
    do i = 1, max_iterations
      self%y(:) = self%y0
      call apply_flows(self%frame, 1, self%u, self%y)
      self%nexp = self%nexp + 1
      call difference_nearby(self%frame, self%y, self%y1, nearby_operation, self%v(:, 1))
      call dexpinv(self%frame, self%scheme%series, self%u, self%v(:, 1), exists)
      if (.not. exists) return
      self%u = self%u + self%v(:, 1)
      ! not if a correction is NaN
      exists = all(abs(self%v(:, 1)) <= converged * max(1.0_wp, maxval(abs(self%u))))
      if (exists) exit
    end do
    self%next(:, 2) = self%u / self%h
    self%u = self%h * self%next(:, 2)        ! rounded as by evaluate_interpolant
  end subroutine find_mean

  ! Lets an interpolant that has begun be evaluated before it is complete. Coordinates are then the
  ! cubic of Hermite, or a multiple of those of y1 where the derivative at the end doesn't exist.
  subroutine make_cubic(exists, self)
    logical, intent(in) :: exists            ! the result of begin_interpolant
    type(interpolant_t), intent(inout) :: self

    if (.not. self%on_algebra) return           ! the interpolant has two nodes already
    self%vectors = 0.0_wp
    call sum_terms(merge(3, 1, exists), self)
  end subroutine make_cubic

  ! Computes the first coefficients of the polynomial from the derivatives.
  subroutine sum_terms(terms, self)
    integer, intent(in) :: terms
    type(interpolant_t), intent(inout) :: self
    integer :: d

    do d = 1, terms
      self%weight(:self%known) = self%h * self%scheme%basis(:self%known, d)
      call combine(size(self%u), self%known, self%weight, self%next, self%vectors(:, d))
    end do
  end subroutine sum_terms

  ! Finds the next node, and the point there.
  subroutine next_node(self, theta)
    type(interpolant_t), intent(inout) :: self        ! self%y becomes the point
    real(wp), intent(out) :: theta
    integer :: extra

    if (self%on_algebra) then
      extra = self%known - size(self%scheme%basis, 1) + size(self%scheme%theta) + 1
      theta = self%scheme%theta(extra)
      self%weight(:self%known) = self%h * self%scheme%node_weights(:self%known, extra)
      call combine(self%frame%dimension, self%known, self%weight, self%next, self%u)
      self%y(:) = self%y0
      call apply_flows(self%frame, 1, self%u, self%y)
    else
      theta = self%scheme%node(self%node, next_count(self))
      call evaluate_interpolant(self, theta, self%y)
    end if
  end subroutine next_node

  ! Stores the coefficients at the node. By flows, new nodes are used together.
  subroutine add_node(f, self, exists)
    real(wp), contiguous, intent(in) :: f(:)                 ! (dimension)
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists
    integer :: n

    exists = .true.
    if (.not. self%on_algebra) then
      n = next_count(self)
      self%next(:, self%node) = f
      self%node = self%node + 1
      if (self%node < n) return
      self%vectors(:, n) = self%vectors(:, self%known)
      self%vectors(:, 2:n - 1) = self%next(:, 2:n - 1)
      call add_last_flow(n, self)
      return
    end if
    self%known = self%known + 1
    self%next(:, self%known) = f
    call dexpinv(self%frame, self%scheme%series, self%u, self%next(:, self%known), exists)
    call finish_or_fall_back(self, exists)
  end subroutine add_node

  ! The number of flows that one evaluation takes
  pure integer function flows_of_evaluation(self)
    type(interpolant_t), intent(in) :: self

    flows_of_evaluation = merge(1, size(self%v, 2), self%on_algebra .or. self%scheme%at_stages)
  end function flows_of_evaluation

  ! Computes the point at a fraction of the step.
  subroutine evaluate_interpolant(self, theta, y)
    type(interpolant_t), intent(inout) :: self
    real(wp), intent(in) :: theta            ! 0 to 1
    real(wp), contiguous, intent(out) :: y(:)                ! (point_size)
    integer :: d

    y = self%y0
    if (self%on_algebra) then
      self%weight(1) = theta
      do d = 2, size(self%scheme%basis, 2)
        self%weight(d) = self%weight(d - 1) * merge(theta, 1 - theta, modulo(d, 2) == 1)
      end do
      call combine(self%frame%dimension, size(self%scheme%basis, 2), self%weight, self%vectors, &
                   self%u)
      call apply_flows(self%frame, 1, self%u, y)
    else
      call follow_flows(self, theta, y)
    end if
    if (self%frame%jointed) call try_close_joints(self%frame, y)
  end subroutine evaluate_interpolant

  ! Evaluates the interpolant at some fractions by one flow along a polynomial.
  subroutine evaluate_inner(self, inner, theta, y)
    type(interpolant_t), intent(inout) :: self
    type(inner_points_t), intent(inout) :: inner       ! workspace
    real(wp), intent(in) :: theta(:)         ! between 0 and 1
    real(wp), intent(inout) :: y(:, :)       ! (point_size, fractions)
    real(wp) :: reached(self%frame%point_size)
    integer :: k, rank(size(theta))          ! rank: of each fraction, the smallest first

    rank = [(count(theta < theta(k)) + count(theta(:k) == theta(k)), k=1, size(theta))]
    inner%count = size(theta)
    inner%theta = theta
    inner%theta(rank) = theta
    inner%y = y
    reached = self%y0
    call follow_flows(self, 1.0_wp, reached, inner)
    y = inner%y(:, rank)
  end subroutine evaluate_inner

end module interpolant_m
