! The highest divided difference of coefficients at the nodes of two steps in a row.
!
! Results of a Magnus method share nodes, and sums of weights on them, so that their difference
! doesn't see what the nodes of a step don't: a jump, a kink, an oscillation. The polynomial that
! interpolates coefficients at the n nodes of this step and the one before has the leading
! coefficient
!     D = sum_k f_k / prod_(j /= k) (t_k - t_j),
! and D prod_j (t - t_j), which is O(h^(n - 1)) for smooth coefficients, estimates how much they
! differ from it within the step.
module node_difference_m
  use kinds, only: wp
  implicit none
  private
  public :: node_difference

  real(wp), parameter :: roundings = 64 * epsilon(1.0_wp)

contains

  ! Computes the largest of these differences between nodes of the step, without those that rounding
  ! explains. Times are in units of the step, from its start.
  pure subroutine node_difference(c, f, ratio, f_before, v)
    real(wp), intent(in) :: c(:)             ! (nodes) in a step
    real(wp), intent(in) :: f(:, :)          ! (dimension, nodes)
    real(wp), intent(in) :: ratio            ! of the size of the step before to that of this one
    real(wp), intent(in) :: f_before(:, :)   ! (dimension, nodes)
    real(wp), intent(out) :: v(:)            ! (dimension)
    real(wp) :: t(2 * size(c)), sizes(size(v)), largest
    integer :: j, k, s

    s = size(c)
    t = [(c - 1) * ratio, c]
    v = 0.0_wp
    sizes = 0.0_wp
    largest = 0.0_wp
    do k = 1, 2 * s
      if (.not. counts(k)) cycle
      associate (weight => 1 / product(t(k) - t, mask=[(j /= k .and. counts(j), j=1, 2 * s)]))
        if (k <= s) then
          v = v + weight * f_before(:, k)
          sizes = sizes + abs(weight * f_before(:, k))
        else
          v = v + weight * f(:, k - s)
          sizes = sizes + abs(weight * f(:, k - s))
        end if
      end associate
    end do
    do k = s + 1, 2 * s - 1
      associate (middle => (t(k) + t(k + 1)) / 2)
        largest = max(largest, abs(product(middle - t, mask=[(counts(j), j=1, 2 * s)])))
      end associate
    end do
    v = largest * merge(v, 0.0_wp, abs(v) > roundings * sizes)

  contains

    ! Whether a node counts: the end of the step before is the start of this one.
    pure logical function counts(j)
      integer, intent(in) :: j

      counts = j > s .or. abs(t(j) - c(1)) > 0
    end function counts

  end subroutine node_difference

end module node_difference_m
