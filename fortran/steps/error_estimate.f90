! The estimate of the error of a step, in tolerances. EstimateForm in cg/support/shared_numbers.py
! has the formulas: norms e_i of differences of results and of sums of stages make up quotients e1
! (e1 / hypot(e1, factor e2))^power, which have the order of the error. Parts, the quadratures and
! the commutators, have quotients of their own. Where f changes along its own direction, and hardly
! in others, e2 would be all quadrature and e1 all commutators, and one quotient of both would say
! nothing.
!
! The rest of e1 of a Magnus method may also vanish by chance, and the quotient with it. Another
! estimate is the rest of e2, O(h^3), times a power of the change of the angle.
!
! Results of a Magnus method share nodes, and sums of weights on them, so that their difference
! doesn't see what lies between the nodes: a jump, a kink, an oscillation. The polynomial through
! the coefficients at the n nodes of this step and the one before has the leading coefficient
!     D = sum_k f_k / prod_(j /= k) (t_k - t_j),
! and D prod_j (t - t_j), which is O(h^(n - 1)) for smooth coefficients, estimates how much they
! differ from it within the step. In the first step of all there are none before, and quotients say
! nothing if the nodes don't resolve the coefficients, such as several periods: e1 itself counts, or
! else e2, unless they are small compared with the variation of the coefficients.
module error_estimate_m
  use kinds, only: wp
  use collocation_m, only: damp_displacement
  use coordinates_m, only: difference, error_norm, error_scales, remove_isotropy, tangent
  use frames_m, only: turning
  use method_m, only: method_t
  use shared_numbers, only: at_end_estimate, collocation_kind, linear_action_block, linear_kind, &
                            max_angle, parts_of_results_estimate, parts_of_sums_estimate, &
                            polynomial_kind, resolved_first, resolved_second, roundings, &
                            unit_of_change
  use trajectory_m, only: trajectory_t
  use vectors_m, only: combine, finite
  implicit none
  private
  public :: estimate_error

  ! Change of the angle from which differences of results of Magnus methods may vanish by chance
  real(wp), parameter :: max_change = 3.0_wp
  real(wp), parameter :: max_collocated_angle = 3.0_wp  ! of a step
  real(wp), parameter :: min_excess = 0.1_wp           ! errors up to it let steps grow freely

contains

  ! Estimates the error of a step from differences, and from how its coefficients change.
  subroutine estimate_error(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: e(2, 3)                      ! (part, i) e_i of the quadratures and of the rest
    real(wp) :: part, change            ! part: the estimate by the second part

    call error_scales(x%frame, x%tolerances, x%y(:, 0), x%y(:, x%result), x%norms%difference, &
                      x%norms%scale)
    if (.not. finite(x%frame%point_size, x%y(:, x%method%embedded))) return      ! 0 is the start
    call difference_norms(x, e)
    x%estimate%error = combined(x%method, e(1, 1), e(1, 2))
    if (x%method%in_parts) then
      part = combined(x%method, e(2, 1), e(2, 2))
      if (x%method%kind /= linear_kind) then
        call take_larger(x%estimate%error, part)
      else
        x%estimate%error = x%estimate%error + part
        if (e(2, 2) > 1) call raise_by_change(x, e(2, 2))
      end if
    else if (x%method%estimate == at_end_estimate) then
      if (e(1, 3) > 0 .and. e(1, 3) <= huge(1.0_wp)) &
        e(1, 2) = e(1, 2) * (e(1, 2) / hypot(e(1, 2), e(1, 3)))
      x%estimate%error = e(1, 1)
      call take_larger(x%estimate%error, x%method%factor * e(1, 2))
    end if
    call raise_by_angle(x)
    if (.not. x%method%uses_last_nodes) return
    if (x%estimate%h_before /= 0) then
      call node_difference(x%method%c, x%f, x%estimate%h_before / x%h, x%estimate%f_before, &
                           x%norms%displacement)
      x%norms%displacement = x%h * x%norms%displacement
      call remove_isotropy(x%frame, x%y(:, x%result), x%norms%displacement)
      call take_larger(x%estimate%error, displacement_norm(x))
    else                                     ! of the first step, and after a breakpoint or a jump
      ! without parts e2 is no estimate of its own
      change = variation(x)
      if (e(1, 1) > resolved_first * change) then
        call take_larger(x%estimate%error, e(1, 1))
      else if (x%method%in_parts .and. e(1, 2) > resolved_second * change) then
        call take_larger(x%estimate%error, e(1, 2))
      end if
    end if
  end subroutine estimate_error

  ! The largest change of the coefficients from the start of the step to a node
  real(wp) function variation(x)
    type(trajectory_t), intent(inout) :: x
    integer :: k

    variation = 0.0_wp
    do k = 2, size(x%method%c)
      x%norms%displacement = x%h * (x%f(:, k) - x%f(:, 1))
      call take_larger(variation, displacement_norm(x))
    end do
  end function variation

  ! Computes the norms e_i. Each half of the sums belongs to one of them, but sums at the end of the
  ! step belong to e2 and e3.
  subroutine difference_norms(x, e)
    type(trajectory_t), intent(inout) :: x   ! norms%displacement is that of the last sum
    real(wp), intent(out) :: e(:, :)         ! (part, i)
    real(wp), allocatable :: weight(:)       ! (summands)
    real(wp) :: error
    integer :: i, k, part

    e = 0.0_wp
    associate (method => x%method, sums => size(x%method%error, 2), u => x%norms%displacement)
      if (method%embedded > 0 .and. .not. method%in_parts) e(1, 1) = distance(x, method%embedded)
      do k = 1, sums
        i = merge(1, 2, k <= (sums + 1) / 2)
        if (method%estimate == at_end_estimate) i = 1 + k
        part = merge(2 - mod(k, 2), 1, method%estimate == parts_of_sums_estimate)
        weight = x%h * method%error(:, k)
        if (size(x%estimate%added) > 0) then
          call combine(size(u), size(x%f, 2), weight, x%estimate%added, u)
          call remove_isotropy(x%frame, x%y(:, x%result), u)
          call take_larger(e(2, i), displacement_norm(x))
          x%v(:, 1) = u                      ! the rest; all flows have been followed
        end if
        call combine(size(u), size(x%f, 2), weight, x%f, u)
        if (method%kind == collocation_kind) call damp_displacement(x)
        call remove_isotropy(x%frame, x%y(:, x%result), u)
        if (size(x%estimate%added) > 0) u = u - x%v(:, 1)
        error = displacement_norm(x)
        if (method%kind == polynomial_kind) error = hypot(e(1, i), error)
        call take_larger(e(part, i), error)
        if (method%estimate /= parts_of_results_estimate) cycle
        if (k == 1) call take_larger(e(2, i), distance(x, method%embedded, x%norms%change))
        if (k == sums) call take_larger(e(2, i), distance(x, method%third, x%norms%change))
      end do
    end associate
  end subroutine difference_norms

  ! Replaces an error by a larger one; NaN is larger than any number.
  pure subroutine take_larger(error, other)
    real(wp), intent(inout) :: error
    real(wp), intent(in) :: other

    if (other > error .or. other /= other) error = other
  end subroutine take_larger

  ! Raises the error of a step of a Magnus method, whose differences may vanish by chance.
  subroutine raise_by_change(x, rest)
    type(trajectory_t), intent(inout) :: x
    real(wp), intent(in) :: rest    ! the rest of e2
    real(wp) :: change, power
    integer :: i

    change = 0.0_wp
    do i = 2, size(x%method%c)
      x%norms%displacement = x%f(:, i) - x%f(:, 1)
      change = max(change, abs(x%h) * turning(x%frame, x%norms%displacement, fields=.true.))
    end do
    power = 1 / x%tolerances%exponent
    ! rest = O(h^3), so that times change^(power - 3) it has the order of the error
    call take_larger(x%estimate%error, rest * (change / unit_of_change)**(power - 3))
    if (change > max_change) call take_larger(x%estimate%error, (change / max_change)**power)
  end subroutine raise_by_change

  ! The estimate e1 (e1 / hypot(e1, factor e2))^power
  pure real(wp) function combined(method, e1, e2)
    type(method_t), intent(in) :: method
    real(wp), intent(in) :: e1, e2

    combined = e1
    if (e1 > 0 .and. e2 <= huge(e2)) &
      combined = e1 * (e1 / hypot(e1, method%factor * e2))**method%power
  end function combined

  ! Raises the error of a step that turns by more than an angle, so that the next one is shorter:
  ! near 2 pi, where dexp^-1 doesn't exist, the stages of a collocation method can't be found. Those
  ! of others may turn further, by any angle if coefficients change by less than the tolerances.
  subroutine raise_by_angle(x)
    type(trajectory_t), intent(inout) :: x
    real(wp) :: excess
    logical :: collocates

    collocates = x%method%kind == collocation_kind
    if (x%method%kind == polynomial_kind .or. &
        collocates .and. any(x%frame%blocks%kind == linear_action_block)) return   ! may not turn
    excess = abs(x%h) * turning(x%frame, x%f(:, 1), fields=.true.) / max_angle
    if (collocates) &
      excess = turning(x%frame, x%collocation%z(:, 3), fields=.true.) / max_collocated_angle
    excess = excess**(1 / x%tolerances%exponent)
    if (excess <= max(x%estimate%error, min_excess)) return
    if (.not. collocates) then
      if (variation(x) <= 1) return
    end if
    x%estimate%error = excess
  end subroutine raise_by_angle

  ! Computes the largest value of D prod_j (t - t_j) between nodes of the step, without what
  ! rounding explains. Times are in units of the step, from its start.
  pure subroutine node_difference(c, f, ratio, f_before, v)
    real(wp), intent(in) :: c(:)             ! (nodes) in a step
    real(wp), intent(in) :: f(:, :)          ! (dimension, nodes)
    real(wp), intent(in) :: ratio            ! size of the step before over that of this one
    real(wp), intent(in) :: f_before(:, :)   ! (dimension, nodes)
    real(wp), intent(out) :: v(:)            ! (dimension)
    real(wp), allocatable :: t(:), nodal_f(:, :)       ! (nodes of both), (dimension, nodes of both)
    real(wp) :: moduli(size(v)), largest, weight       ! largest: of prod_j (t - t_j)
    integer, allocatable :: new_nodes(:)               ! nodes before that this step doesn't have
    integer :: j, k

    ! the end of the step before is the start of this one
    new_nodes = pack([(j, j=1, size(c))], (c - 1) * ratio /= c(1))
    t = [(c(new_nodes) - 1) * ratio, c]
    nodal_f = reshape([f_before(:, new_nodes), f(:, :size(c))], [size(v), size(t)])
    v = 0.0_wp
    moduli = 0.0_wp
    largest = 0.0_wp
    do k = 1, size(t)
      weight = 1 / product(t(k) - t, mask=[(j /= k, j=1, size(t))])
      v = v + weight * nodal_f(:, k)
      moduli = moduli + abs(weight * nodal_f(:, k))
    end do
    do k = size(new_nodes) + 1, size(t) - 1
      largest = max(largest, abs(product((t(k) + t(k + 1)) / 2 - t)))
    end do
    v = largest * merge(v, 0.0_wp, abs(v) > roundings * epsilon(v) * moduli)
  end subroutine node_difference

  ! The norm of the difference of the result from another one, without a part of it
  real(wp) function distance(x, path, part)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path
    real(wp), intent(in), optional :: part(:)          ! (width)

    if (x%tolerances%in_coordinates) then
      call difference(x%frame, x%y(:, path), x%y(:, x%result), x%norms%difference)
    else
      x%norms%difference(:) = x%y(:, x%result) - x%y(:, path)
    end if
    if (present(part)) x%norms%difference(:) = x%norms%difference - part(:size(x%norms%difference))
    distance = error_norm(x%tolerances, x%norms%difference, x%norms%scale)
  end function distance

  ! The norm of norms%displacement at the end of the step; norms%change is set on the way.
  real(wp) function displacement_norm(x)
    type(trajectory_t), intent(inout) :: x

    call tangent(x%frame, x%tolerances, x%norms%displacement, x%y(:, x%result), x%norms%change)
    displacement_norm = error_norm(x%tolerances, x%norms%change, x%norms%scale)
  end function displacement_norm

end module error_estimate_m
