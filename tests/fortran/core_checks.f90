! Runs the core under run-time checks and floating-point traps, which act in a Fortran program
! only: weights, Jacobian and lmdif on order conditions of tableaux, explicit and implicit, and of
! points with several weights and branches.
program core_checks
  use kinds, only: wp
  use conditions_m, only: order_conditions_t
  use levenberg_marquardt_m, only: lmdif, lmdif_t
  use tree_tables, only: condition, tree_start
  implicit none
  integer :: first

  do first = 0, 2
    call check_jacobian(5, tableau(4, first, pair=first == 2), zeros=.false.)
  end do
  call check_jacobian(6, tableau(7, 0, pair=.false.), zeros=.false.)
  ! CF4: stages at 0, 1, 2, 3; parents 0, 0, 1, 0, 4; the second result is its fourth point
  call check_jacobian(5, [4, 5, 5, 4, 0, 1, 2, 3, 0, 0, 1, 0, 4, 1, 1, 2, 4, 4, &
                          1, 2, 1, 3, 1, 2, 3, 4, 1, 2, 3, 4], zeros=.true.)
  call check_fit()
  print '(a)', 'core_checks: passed'

contains

  ! The layout of a tableau, as cg.construction.layouts writes it: rows of length 0, 1, ... if
  ! `first` is 0, of length 1, 2, ... if it is 1, else all of them of full length.
  function tableau(stages, first, pair) result(layout)
    integer, intent(in) :: stages, first
    logical, intent(in) :: pair
    integer, allocatable :: layout(:)
    integer :: lengths(stages + 2), begin(stages + 3), r, j, n, m

    lengths = stages
    if (first < 2) lengths(:stages) = [(r - 1 + first, r=1, stages)]
    if (.not. pair) lengths(stages + 2) = 0
    begin(1) = 0
    do r = 1, stages + 2
      begin(r + 1) = begin(r) + lengths(r)
    end do
    n = begin(stages + 3)
    allocate (layout(4 + stages + 3*n), source=1)
    layout(1:2) = [stages, n]
    do r = 1, stages + 2
      m = merge(4 + r, 2 + r - stages, r <= stages)  ! results come first
      layout(m) = merge(0, begin(r + 1), lengths(r) == 0)
      do j = 1, lengths(r)
        layout(4 + stages + begin(r) + j) = merge(0, begin(r) + j - 1, j == 1)
        layout(4 + stages + 2*n + begin(r) + j) = j
      end do
    end do
  end function tableau

  subroutine check_jacobian(order, layout, zeros)
    integer, intent(in) :: order
    integer, intent(in) :: layout(:)
    logical, intent(in) :: zeros  ! whether zeros are among the trees
    type(order_conditions_t) :: problem
    integer :: trees(merge(2, 1, layout(4) > 0)*(tree_start(order + 2) - 2))
    integer :: owner(size(trees))
    real(wp), allocatable :: x(:), f(:), jac(:, :), ahead(:), behind(:)
    real(wp) :: h
    integer :: i, p, flag

    do i = 1, size(trees)
      trees(i) = 2 + modulo(i - 1, tree_start(order + 2) - 2)
      owner(i) = merge(0, -1, i < tree_start(order + 2) - 1)
    end do
    if (zeros) trees(3:5) = 0
    call problem%set_up(order, layout, trees, owner)
    allocate (x(problem%weights%pattern%unknowns))
    allocate (f(size(trees)), ahead(size(trees)), behind(size(trees)))
    allocate (jac(size(trees), size(x)))
    do p = 1, size(x)
      x(p) = sin(real(7*p, wp))
    end do
    flag = 0
    call problem%residual(x, f, flag)
    call problem%jacobian(x, jac, flag)
    h = epsilon(1.0_wp)**(1.0_wp/3.0_wp)
    do p = 1, size(x)
      x(p) = x(p) + h
      call problem%residual(x, ahead, flag)
      x(p) = x(p) - 2*h
      call problem%residual(x, behind, flag)
      x(p) = x(p) + h
      if (any(abs((ahead - behind)/(2*h) - jac(:, p)) > 100*h**2*(1 + maxval(abs(jac))))) &
        error stop 'the Jacobian is not the derivative of the residual'
    end do
    if (flag /= 0) error stop 'a flag was raised'
  end subroutine check_jacobian

  subroutine check_fit()
    integer, parameter :: order = 3, stages = 3
    type(order_conditions_t) :: problem
    type(lmdif_t) :: solver
    real(wp) :: x(6), f(8)

    call problem%set_up(order, tableau(stages, 0, pair=.false.), condition(2:9), spread(0, 1, 8))
    ! close to Crouch and Grossman's method of order three
    x = [0.75_wp, 0.55_wp, 0.16_wp, 0.25_wp, -0.67_wp, 1.41_wp]
    solver = lmdif_t(xtol=1.0e-15_wp, maxfev=2000)
    call lmdif(problem, x, f, solver)
    if (maxval(abs(f)) > 1000*epsilon(1.0_wp)) error stop 'lmdif did not reach a zero'
  end subroutine check_fit
end program core_checks
