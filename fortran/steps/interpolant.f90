! The solution within one step, on the manifold and as accurate as the step, in one of two forms:
! by flows (flow_interpolant.f90), or on a Lie algebra, where the coordinates of y = exp(u) y0 are a
! polynomial,
!
!   u(theta) = h sum_d phi_d(theta) sum_j basis_jd k_j,
!   phi_d = theta, theta (1 - theta), theta^2 (1 - theta), theta^2 (1 - theta)^2, ...,
!
! in derivatives k_j of coordinates: those at the stages of a flat method, or that at the start and
! the mean u(1) / h, then that at the end, and those at further nodes, each evaluated where the ones
! before it lead. One flow reaches a point. cg/construction/methods/interpolant.py derives the
! coefficients of both forms.
module interpolant_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use constrained_motion_m, only: without_opening
  use flow_interpolant_m, only: add_flow_node, begin_flows, difference_nearby, follow_flows, &
                                interpolant_t, next_count
  use frames_m, only: apply_flows
  use linear_action_m, only: inner_points_t
  use shared_numbers, only: nearby_operation
  use vectors_m, only: combine
  implicit none
  private
  public :: add_node, begin_interpolant, evaluate_inner, evaluate_interpolant, &
            flows_of_evaluation, make_cubic, next_node

  integer, parameter :: iterations = 20
  real(wp), parameter :: converged = sqrt(epsilon(1.0_wp)) / 8   ! its square is below rounding

contains

  ! Starts an interpolant from the ends and the stages of its step.
  subroutine begin_interpolant(unique_flows, stages, self, exists)
    logical, intent(in) :: unique_flows      ! whether coordinates are known from the ends
    real(wp), intent(in) :: stages(:, :)     ! (dimension, stages) of a flat method, derivatives
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists           ! false if the step is too long for coordinates

    exists = .true.
    self%nexp = 0
    self%complete = .false.
    self%on_algebra = .not. (self%scheme%at_stages .or. allocated(self%scheme%drift)) &
                      .and. (self%scheme%flat .or. unique_flows)
    if (self%scheme%at_stages) then
      self%known = self%scheme%nodes
      self%field(:, :self%scheme%nodes) = stages
      self%field(:, self%scheme%nodes + 1) = 0.0_wp  ! there is no last flow
      self%complete = .true.
      return
    end if
    if (.not. self%on_algebra) then
      call begin_flows(self)
      return
    end if
    associate (k => self%next, final => self%scheme%final, h => self%h, &
               first => self%field(:, 1), last => self%field(:, 2))
      if (self%scheme%flat) then
        k(:, :size(stages, 2)) = stages
        self%known = max(size(stages, 2), final)
        if (final > size(stages, 2)) then
          k(:, final) = last
          self%weight(:size(stages, 2)) = h * self%scheme%basis(:size(stages, 2), 1)
          call combine(self%frame%dimension, size(stages, 2), self%weight, k, self%u)
          call dexpinv(self%frame, self%scheme%series, self%u, k(:, final), exists)
        end if
      else
        k(:, 1) = first
        self%known = final
        call find_mean(self, exists)
        k(:, final) = last
        if (exists) call dexpinv(self%frame, self%scheme%series, h * k(:, 2), k(:, final), exists)
      end if
    end associate
    call finish_or_fall_back(self, exists)
  end subroutine begin_interpolant

  ! Finishes an interpolant in coordinates if all derivatives are known. If the step is too long for
  ! coordinates and the method doesn't need them, the other form is used.
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
      call begin_flows(self)
    end if
  end subroutine finish_or_fall_back

  ! Computes the coordinates of y1 by Newton's method, starting from the mean of the coefficients at
  ! both ends, which selects the branch of the logarithm that the solution follows.
  subroutine find_mean(self, exists)
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists
    real(wp) :: u(self%frame%dimension), v(self%frame%dimension), y(self%frame%point_size)
    integer :: i

    u = self%h * (self%field(:, 1) + self%field(:, 2)) / 2
    do i = 1, iterations
      y = self%y0
      call apply_flows(self%frame, 1, u, y)
      self%nexp = self%nexp + 1
      call difference_nearby(self%frame, y, self%y1, nearby_operation, v)
      call dexpinv(self%frame, self%scheme%series, u, v, exists)
      if (.not. exists) return
      u = u + v
      exists = all(abs(v) <= converged * max(1.0_wp, maxval(abs(u))))   ! not if v is NaN
      if (exists) exit
    end do
    self%next(:, 2) = u / self%h
  end subroutine find_mean

  ! Lets an interpolant that has begun be evaluated before it is complete. Coordinates are then the
  ! cubic of Hermite, or a multiple of those of y1 where the derivative at the end doesn't exist.
  subroutine make_cubic(exists, self)
    logical, intent(in) :: exists            ! as from begin_interpolant
    type(interpolant_t), intent(inout) :: self

    if (.not. self%on_algebra) return           ! it has two nodes already
    self%field = 0.0_wp
    call sum_terms(merge(3, 1, exists), self)
  end subroutine make_cubic

  ! Computes the first coefficients of the polynomial from the derivatives.
  subroutine sum_terms(terms, self)
    integer, intent(in) :: terms
    type(interpolant_t), intent(inout) :: self
    integer :: d

    do d = 1, terms
      self%weight(:self%known) = self%h * self%scheme%basis(:self%known, d)
      call combine(size(self%u), self%known, self%weight, self%next, self%field(:, d))
    end do
  end subroutine sum_terms

  ! Computes the point of the next node.
  subroutine next_node(self, theta)
    type(interpolant_t), intent(inout) :: self        ! its y becomes the point
    real(wp), intent(out) :: theta

    if (self%on_algebra) then
      associate (extra => self%known - size(self%scheme%basis, 1) + size(self%scheme%theta) + 1)
        theta = self%scheme%theta(extra)
        self%weight(:self%known) = self%h * self%scheme%row(:self%known, extra)
        call combine(self%frame%dimension, self%known, self%weight, self%next, self%u)
      end associate
      self%y(:) = self%y0
      call apply_flows(self%frame, 1, self%u, self%y)
    else
      theta = self%scheme%node(self%node, next_count(self))
      call evaluate_interpolant(self, theta, self%y)
    end if
  end subroutine next_node

  ! Stores the coefficients at the node.
  subroutine add_node(f, self, exists)
    real(wp), contiguous, intent(in) :: f(:)                 ! (dimension)
    type(interpolant_t), intent(inout) :: self
    logical, intent(out) :: exists

    exists = .true.
    if (.not. self%on_algebra) then
      call add_flow_node(f, self)
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

    flows_of_evaluation = 1
    if (self%on_algebra .or. self%scheme%at_stages) return
    flows_of_evaluation = size(self%scheme%weight, 2) + 1
  end function flows_of_evaluation

  ! Evaluates the interpolant at a fraction of the step.
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
      call combine(self%frame%dimension, size(self%scheme%basis, 2), self%weight, self%field, &
                   self%u)
      call apply_flows(self%frame, 1, self%u, y)
    else
      call follow_flows(self, theta, y)
    end if
    call without_opening(self%frame, y)
  end subroutine evaluate_interpolant

  ! Evaluates the interpolant at some fractions by one flow along a polynomial.
  subroutine evaluate_inner(self, inner, theta, y)
    type(interpolant_t), intent(inout) :: self
    type(inner_points_t), intent(inout) :: inner       ! that of the frame
    real(wp), intent(in) :: theta(:)         ! between 0 and 1
    real(wp), intent(out) :: y(:, :)         ! (point_size, fractions)
    real(wp) :: reached(self%frame%point_size)
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
    call evaluate_interpolant(self, 1.0_wp, reached)
    y(:, order) = inner%y
  end subroutine evaluate_inner

end module interpolant_m
