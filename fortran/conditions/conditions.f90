! The order conditions as a least-squares problem in a method's weights x: one residual
! f_i = Phi(t_i) - 1/gamma(t_i) for each ordered tree t_i (Owren and Marthinsen, Runge-Kutta methods
! adapted to manifolds and based on rigid frames, BIT 39, 1999), and its derivatives.
module conditions_m
  use kinds, only: wp
  use tree_tables, only: density, node_count
  use least_squares_m, only: least_squares_t
  use weights_m, only: weights_t
  use gradient_m, only: weights_jacobian, abscissa
  use shared_numbers, only: middle_abscissa, second_result
  implicit none
  private
  public :: order_conditions_t

  type, extends(least_squares_t) :: order_conditions_t
    type(weights_t) :: weights
    integer, allocatable :: trees(:)      ! (conditions) zero: discarded, its residual is zero
    integer, allocatable :: owner(:)      ! (conditions) see set_up
    real(wp), allocatable :: target(:)    ! (conditions) 1/gamma(t)
  contains
    procedure :: set_up
    procedure :: residual
    procedure :: jacobian
  end type order_conditions_t

contains

  ! The owner of a condition is a result, zero for the first and -1 for the second. A positive one,
  ! k, asks stage k to be right at its own abscissa, Phi_k(t) = c_k^(|t| - 1) / gamma(t), a
  ! simplifying assumption of stage order |t| - 1; with `middle_abscissa` instead of a tree, it asks
  ! c_k to lie in the middle of its piece, c_k = sum_{j<k} b_j + b_k/2, in tableaux only.
  subroutine set_up(self, order, layout, trees, owner)
    class(order_conditions_t), intent(inout) :: self
    integer, intent(in) :: order, layout(:)              ! layout: see weights_t
    integer, intent(in) :: trees(:)            ! (conditions) of stages: at most order nodes
    integer, intent(in), optional :: owner(:)  ! (conditions) all zero by default
    integer :: i

    call self%weights%set_up(order, layout)
    self%trees = trees
    allocate (self%owner(size(trees)), source=0)
    if (present(owner)) self%owner = owner
    allocate (self%target(size(trees)), source=0.0_wp)
    do i = 1, size(trees)
      if (trees(i) > 0) self%target(i) = 1.0_wp/real(density(trees(i)), wp)
    end do
  end subroutine set_up

  ! Computes the residuals of all conditions.
  subroutine residual(self, x, f, flag)
    class(order_conditions_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)      ! (unknowns)
    real(wp), intent(out) :: f(:)     ! (conditions)
    integer, intent(inout) :: flag
    integer :: i, b, k
    real(wp) :: c

    call self%weights%evaluate(x)
    do i = 1, size(self%trees)
      f(i) = 0.0_wp
      if (self%owner(i) > 0) then
        k = self%owner(i)
        c = self%weights%chi(self%weights%pattern%stage_segment(k), abscissa)
        if (self%trees(i) == middle_abscissa) then
          b = self%weights%pattern%weight_start(self%weights%result_path(1))
          f(i) = c - sum(x(b:b + k - 2)) - x(b + k - 1)/2.0_wp
        else
          f(i) = self%weights%chi(self%weights%pattern%stage_segment(k), self%trees(i)) &
            - self%target(i)*c**(node_count(self%trees(i)) - 1)
        end if
      else if (self%trees(i) > 0) then
        f(i) = self%weights%weight(self%trees(i), self%owner(i) == second_result) - self%target(i)
      end if
    end do
    if (.not. all(abs(f) <= huge(f))) flag = -1
  end subroutine residual

  ! Computes the derivatives of all residuals.
  subroutine jacobian(self, x, jac, flag)
    class(order_conditions_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)        ! (unknowns)
    real(wp), intent(out) :: jac(:, :)  ! (conditions, unknowns)
    integer, intent(inout) :: flag

    call self%weights%evaluate(x)
    call weights_jacobian(self%weights, self%trees, self%owner, jac)
    if (.not. all(abs(jac) <= huge(jac))) flag = -1
  end subroutine jacobian
end module conditions_m
