! The solution within one step, on the manifold and as accurate as the step, in one of two forms:
! by flows (flow_interpolant.f90), or on a Lie algebra, where the coordinates of y = exp(u) y0 are a
! polynomial,
!
!   u(theta) = h sum_d phi_d(theta) sum_j basis_jd k_j,
!   phi_d = theta, theta (1 - theta), theta^2 (1 - theta), theta^2 (1 - theta)^2, ...,
!
! in derivatives k_j of coordinates: those at the stages of a flat method, or that at the start and
! the mean u(1) / h, then that at the end, and those at further nodes, each evaluated where the ones
! before it lead. One flow reaches a point. cg/integration/step/interpolant.py derives the
! coefficients of both forms.
module interpolant_m
  use kinds, only: wp
  use algebra_m, only: dexpinv
  use flow_interpolant_m, only: add_flow_node, begin_flows, difference_nearby, follow_flows, &
                                interpolant_t, scheme_t
  use frames_m, only: apply_flows, frame_t
  use linear_action_m, only: inner_points_t
  use vectors_m, only: combine
  implicit none
  private
  public :: add_node, begin_interpolant, evaluate_inner, evaluate_interpolant, &
            flows_of_evaluation, make_cubic, next_node

  integer, parameter :: iterations = 20
  real(wp), parameter :: converged = sqrt(epsilon(1.0_wp)) / 8   ! its square is below rounding

contains

  ! Starts an interpolant from the ends and the stages of its step.
  subroutine begin_interpolant(frame, scheme, unique_flows, stages, interpolant, exists)
    type(frame_t), intent(in) :: frame
    type(scheme_t), intent(in) :: scheme
    logical, intent(in) :: unique_flows      ! whether coordinates are known from the ends
    real(wp), intent(in) :: stages(:, :)     ! (dimension, stages) of a flat method, derivatives
    type(interpolant_t), intent(inout) :: interpolant
    logical, intent(out) :: exists           ! false if the step is too long for coordinates

    interpolant%nexp = 0
    interpolant%complete = .false.
    interpolant%on_algebra = .not. scheme%at_stages .and. (scheme%flat .or. unique_flows)
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
      call apply_flows(frame, 1, u, y)
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
      call apply_flows(frame, 1, interpolant%u, interpolant%y)
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
    if (.not. interpolant%on_algebra) then
      call add_flow_node(frame, scheme, f, interpolant)
      return
    end if
    associate (n => interpolant%known)
      interpolant%next(:, n + 1) = f
      call dexpinv(frame, scheme%series, interpolant%u, interpolant%next(:, n + 1), exists)
      n = n + 1
    end associate
    call finish_or_fall_back(frame, scheme, interpolant, exists)
  end subroutine add_node

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
      call apply_flows(frame, 1, interpolant%u, y)
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

end module interpolant_m
