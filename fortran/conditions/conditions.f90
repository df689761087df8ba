! The order conditions as a least-squares problem in a method's weights x: one residual
! f_i = Phi(t_i) - 1/gamma(t_i) for each ordered tree t_i (Owren and Marthinsen, Runge-Kutta methods
! adapted to manifolds and based on rigid frames, BIT 39, 1999), and its derivatives.
!
! The Jacobian of the elementary weights is computed by the reverse mode over trees. The
! adjoint of the weight of a word t at the end of a segment is carried on to what that weight
! is made of: to the weights of shorter words at the end of the segment before, and to those of
! the letters of t at the stages that the segment's flows use. Z(p, m) is the derivative of the
! weight of a segment by the letter of point p at position m of the word t, a sum over all subwords
! that the flow to p may take around position m, with i letters before it and j after:
!
!     Z(p, m) = sum_ij i! j! / (i + j + 1)! left_p(..) E_p(i letters) E_p(j letters) right_p(..),
!
! left_p and right_p being the weights of what the points before and after p take of the word. In
! the forward direction every weight would carry derivatives by all unknowns, most of them zero
! (A. Griewank, A. Walther, Evaluating Derivatives, SIAM, 2008).
!
! Results are at the ends of the last segments, and need single words, one for each condition:
! there Z runs over the whole path from the start, so that no adjoints of long words are kept.
module conditions_m
  use kinds, only: wp
  use linalg_m, only: least_squares_t
  use shared_numbers, only: first_result, middle_abscissa, second_result
  use tree_tables, only: child, child_start, density, head, node_count, split_start, tail, &
                         tree_start
  use weights_m, only: weights_t
  implicit none
  private
  public :: order_conditions_t

  integer, parameter :: abscissa = 2  ! the tree whose weight at a stage is c

  type, extends(least_squares_t) :: order_conditions_t
    type(weights_t) :: weights
    integer, allocatable :: trees(:)      ! (conditions) zero: discarded, its residual is zero
    integer, allocatable :: owner(:)      ! (conditions) see set_up
    real(wp), allocatable :: target(:)    ! (conditions) 1/gamma(t)
  contains
    procedure :: set_up, residual, jacobian
  end type order_conditions_t

contains

  ! Computes the weights of all words by the flows after each point of chains, and by whole chains.
  subroutine find_right(weights, start, e, right, whole)
    class(weights_t), intent(in) :: weights
    integer, intent(in) :: start(:)                    ! (chains + 1) first points of chains
    real(wp), intent(in), contiguous :: e(:, :)        ! (points, stage_trees), others may follow
    real(wp), intent(out), contiguous :: right(:, :)   ! (points, stage_trees)
    real(wp), intent(out), contiguous :: whole(:, :)   ! (chains, stage_trees)
    real(wp) :: change(size(right, 1)), total
    integer :: t, i, r, p, n

    n = size(right, 1)
    right(:, 1) = 1.0_wp
    whole(:, 1) = 1.0_wp
    do t = 2, weights%stage_trees
      change = e(1:n, t)
      do i = split_start(t) + 1, split_start(t + 1) - 2
        change = change + e(1:n, head(i)) * right(:, tail(i))
      end do
      do r = 1, size(start) - 1
        total = 0.0_wp
        do p = start(r + 1) - 1, start(r), -1
          right(p, t) = total
          total = total + change(p)
        end do
        whole(r, t) = total
      end do
    end do
  end subroutine find_right

  ! Adds derivatives of conditions on a result by x on its path, and adjoints at ends of segments.
  subroutine seed(weights, path, trees, selected, jac, adjoint)
    class(weights_t), intent(in) :: weights
    integer, intent(in) :: path(:)                 ! points on the way to the result
    integer, intent(in) :: trees(:)                ! (conditions)
    logical, intent(in) :: selected(:)             ! (conditions)
    real(wp), intent(inout) :: jac(:, :)           ! (conditions, unknowns)
    real(wp), intent(inout) :: adjoint(:, :, :)    ! (conditions, stage_trees, inner segments)
    real(wp), allocatable :: e(:, :), left(:, :), right(:, :)  ! (path, stage_trees)
    real(wp) :: whole(1, weights%stage_trees), z(size(path), weights%order)
    integer :: row, m, letter, i, k, n
    integer :: on_path(weights%pattern%points)     ! number of a point on the path, or 0

    n = size(path)
    if (n == 0 .or. .not. any(selected)) return
    on_path = 0
    on_path(path) = [(i, i=1, n)]
    e = weights%e(path, :)
    left = weights%left(path, :)
    allocate (right(n, weights%stage_trees))
    call find_right(weights, [1, n + 1], e, right, whole)
    do row = 1, size(trees)
      if (trees(row) == 0 .or. .not. selected(row)) cycle
      call letter_derivatives(e, left, right, trees(row), n, z)
      do m = 1, child_start(trees(row) + 1) - child_start(trees(row))
        letter = child(child_start(trees(row)) + m - 1)
        do k = 1, weights%pattern%unknowns
          i = on_path(weights%pattern%point(k))
          if (i == 0) cycle
          associate (source => weights%pattern%source(k))
            jac(row, k) = jac(row, k) + weights%chi(source, letter) * z(i, m)
            if (source > 0) &
              adjoint(row, letter, source) = adjoint(row, letter, source) + weights%x(k) * z(i, m)
          end associate
        end do
      end do
    end do
  end subroutine seed

  ! Sets the derivatives and the adjoints of simplifying assumptions on stages.
  subroutine seed_assumptions(weights, trees, owner, jac, adjoint)
    class(weights_t), intent(in) :: weights
    integer, intent(in) :: trees(:), owner(:)      ! (conditions)
    real(wp), intent(inout) :: jac(:, :)           ! (conditions, unknowns)
    real(wp), intent(inout) :: adjoint(:, :, :)    ! (conditions, stage_trees, inner segments)
    integer :: row, segment, k, begin

    do row = 1, size(trees)
      if (owner(row) <= 0) cycle
      segment = weights%pattern%stage_segment(owner(row))
      if (trees(row) == middle_abscissa) then
        begin = weights%pattern%weight_start(weights%result_path(1))
        adjoint(row, abscissa, segment) = 1.0_wp
        jac(row, begin:begin + owner(row) - 2) = -1.0_wp
        jac(row, begin + owner(row) - 1) = -0.5_wp
      else
        k = node_count(trees(row)) - 1
        adjoint(row, trees(row), segment) = 1.0_wp
        adjoint(row, abscissa, segment) = adjoint(row, abscissa, segment) &
          - real(k, wp) * weights%chi(segment, abscissa)**(k - 1) / real(density(trees(row)), wp)
      end if
    end do
  end subroutine seed_assumptions

  ! Carries adjoints on to the weights that weights at the ends of inner segments are made of, and
  ! computes the derivatives of these by x. Trees with many nodes come first: parts of a word have
  ! fewer nodes, so that this order serves explicit and implicit methods alike.
  subroutine sweep(weights, first_row, direct, adjoint)
    class(weights_t), intent(in) :: weights
    integer, intent(in) :: first_row(:)            ! (order)
    real(wp), intent(inout) :: direct(:, :)        ! (stage_trees, inner unknowns)
    real(wp), intent(inout) :: adjoint(:, :, :)    ! (conditions, stage_trees, inner segments)
    integer :: t, m, letter, first, k, i, s, inner
    real(wp), allocatable :: z(:, :)               ! (inner points, order)
    real(wp), allocatable :: right(:, :)           ! (inner points, stage_trees)
    real(wp), allocatable :: whole(:, :)           ! (inner segments, stage_trees)

    associate (pattern => weights%pattern)
      inner = pattern%segment_start(pattern%inner + 1) - 1
      allocate (z(inner, weights%order), right(inner, weights%stage_trees))
      allocate (whole(pattern%inner, weights%stage_trees))
      call find_right(weights, pattern%segment_start(:pattern%inner + 1), weights%e, right, whole)
      do t = weights%stage_trees, 2, -1
        first = first_row(node_count(t))
        ! a segment that begins elsewhere multiplies the weights of the one before by its own
        do s = pattern%inner, 1, -1
          associate (origin => pattern%origin(s))
            if (origin == 0) cycle
            adjoint(first:, t, origin) = adjoint(first:, t, origin) + adjoint(first:, t, s)
            do i = split_start(t) + 1, split_start(t + 1) - 2
              adjoint(first:, head(i), origin) = adjoint(first:, head(i), origin) &
                + whole(s, tail(i)) * adjoint(first:, t, s)
            end do
          end associate
        end do
        call letter_derivatives(weights%e, weights%left, right, t, inner, z)
        do m = 1, child_start(t + 1) - child_start(t)
          letter = child(child_start(t) + m - 1)
          do k = 1, size(direct, 2)
            associate (source => pattern%source(k), p => pattern%point(k), &
                       segment => pattern%segment(k))
              direct(t, k) = direct(t, k) + weights%chi(source, letter) * z(p, m)
              if (letter > 1 .and. source > 0) &
                adjoint(first:, letter, source) = adjoint(first:, letter, source) &
                  + (weights%x(k) * z(p, m)) * adjoint(first:, t, segment)
            end associate
          end do
        end do
      end do
    end associate
  end subroutine sweep

  ! Computes Z(p, m), the derivatives by the letter at position m of a word, at the first points.
  subroutine letter_derivatives(e, left, right, t, points, z)
    real(wp), intent(in), contiguous :: e(:, :), left(:, :), right(:, :)  ! (points.., stage_trees)
    integer, intent(in) :: t, points                     ! t: the word
    real(wp), intent(inout), contiguous :: z(:, :)   ! (points, order), columns 1..children set
    integer :: children, m, p, q, before, after, split
    real(wp) :: earlier(points)

    split = split_start(t)
    children = child_start(t + 1) - child_start(t)
    do m = 1, children
      z(:, m) = 0.0_wp
      do p = 0, m - 1
        before = head(split_start(tail(split + m - 1 - p)) + p)
        earlier = left(:points, head(split + m - 1 - p)) * e(:points, before)
        do q = 0, children - m
          after = head(split_start(tail(split + m)) + q)
          z(:, m) = z(:, m) + beta(p, q) * earlier * e(:points, after) &
                              * right(:points, tail(split + m + q))
        end do
      end do
    end do
  end subroutine letter_derivatives

  ! Euler's B(p + 1, q + 1) = p! q! / (p + q + 1)!, by which a letter between p and q others counts
  pure real(wp) function beta(p, q)
    integer, intent(in) :: p, q
    integer :: i

    beta = 1.0_wp / real(p + 1, wp)
    do i = 1, q
      beta = beta * real(i, wp) / real(p + 1 + i, wp)
    end do
  end function beta

  ! The owner of a condition is a result, zero for the first and -1 for the second. A positive one,
  ! k, asks stage k to be right at its own abscissa, Phi_k(t) = c_k^(|t| - 1) / gamma(t), a
  ! simplifying assumption of stage order |t| - 1; with `middle_abscissa` instead of a tree, it asks
  ! c_k to lie in the middle of its piece, c_k = sum_{j<k} b_j + b_k/2, in tableaux only.
  subroutine set_up(self, order, layout, trees, owner)
    class(order_conditions_t), intent(inout) :: self
    integer, intent(in) :: order, layout(:)    ! layout: see read_layout in weights_m
    integer, intent(in) :: trees(:)            ! (conditions) of stages: at most order nodes
    integer, intent(in) :: owner(:)            ! (conditions)

    call self%weights%set_up(order, layout)
    self%trees = trees
    self%owner = owner
    self%target = merge(1.0_wp / real(density(max(trees, 1)), wp), 0.0_wp, trees > 0)
  end subroutine set_up

  ! Computes Phi(t) - 1/gamma(t) of conditions, and the assumptions that set_up describes.
  subroutine residual(self, x, f, outcome)
    class(order_conditions_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)      ! (unknowns)
    real(wp), intent(out) :: f(:)     ! (conditions)
    integer, intent(inout) :: outcome
    integer :: i, begin, stage
    real(wp) :: c

    call self%weights%evaluate_trees(x)
    associate (weights => self%weights, pattern => self%weights%pattern, trees => self%trees)
      f = 0.0_wp
      do i = 1, size(trees)
        stage = self%owner(i)
        if (stage > 0) then
          c = weights%chi(pattern%stage_segment(stage), abscissa)
          if (trees(i) == middle_abscissa) then
            begin = pattern%weight_start(weights%result_path(1))
            f(i) = c - sum(x(begin:begin + stage - 2)) - x(begin + stage - 1) / 2.0_wp
          else
            f(i) = weights%chi(pattern%stage_segment(stage), trees(i)) &
                   - self%target(i) * c**(node_count(trees(i)) - 1)
          end if
        else if (trees(i) > 0) then
          f(i) = weights%weight(trees(i), stage == second_result) - self%target(i)
        end if
      end do
    end associate
    if (.not. all(abs(f) <= huge(f))) outcome = -1
  end subroutine residual

  ! Computes the derivatives of all residuals; a row of zeros where the list of trees has a zero.
  subroutine jacobian(self, x, jac, outcome)
    class(order_conditions_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)          ! (unknowns)
    real(wp), intent(out) :: jac(:, :)    ! (conditions, unknowns)
    integer, intent(inout) :: outcome
    real(wp), allocatable :: direct(:, :) ! (stage_trees, inner unknowns) by the weights themselves
    real(wp), allocatable :: adjoint(:, :, :)    ! (conditions, stage_trees, inner segments)
    integer :: s, k, t, first, unknowns
    ! first condition that weights of n nodes enter: one of n + 1 nodes, or an assumption of n
    integer :: first_row(self%weights%order)

    call self%weights%evaluate_trees(x)
    associate (weights => self%weights, pattern => self%weights%pattern, trees => self%trees, &
               owner => self%owner)
      first_row = [(findloc([trees >= tree_start(s + merge(0, 1, owner > 0)), .true.], .true., 1), &
                    s=1, weights%order)]
      unknowns = pattern%weight_start(pattern%segment_start(pattern%inner + 1)) - 1
      allocate (direct(weights%stage_trees, unknowns), source=0.0_wp)
      allocate (adjoint(size(trees), weights%stage_trees, pattern%inner), source=0.0_wp)
      jac = 0.0_wp
      call seed(weights, weights%result_path, trees, owner == first_result, jac, adjoint)
      call seed(weights, weights%second_path, trees, owner == second_result, jac, adjoint)
      call seed_assumptions(weights, trees, owner, jac, adjoint)
      if (unknowns > 0) call sweep(weights, first_row, direct, adjoint)
      do t = 2, weights%stage_trees
        first = first_row(node_count(t))
        do k = 1, unknowns
          jac(first:, k) = jac(first:, k) + direct(t, k) * adjoint(first:, t, pattern%segment(k))
        end do
      end do
    end associate
    if (.not. all(abs(jac) <= huge(jac))) outcome = -1
  end subroutine jacobian

end module conditions_m
