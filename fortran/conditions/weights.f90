! Elementary weights of a method, which is a tree of points, for all ordered trees up to an order.
!
! cg/construction/conditions/__init__.py has the formulas. E_m(v) = l_m(v_1) ... l_m(v_n) / n! is
! the character of the flow to point m, and chi_m(w), the weight of a word there, is the sum over
! w = u v of chi_parent(m)(u) E_m(v). Vectors run over the points. Points that follow each other
! without a branch, a stage or a result between them make a segment; weights are kept at the ends of
! segments. The rows of a Crouch-Grossman tableau are segments.
module weights_m
  use kinds, only: wp
  use tree_tables, only: child_start, first, head, rest, split_start, tail, tree_start
  implicit none
  private
  public :: weights_t

  type :: pattern_t  ! the shape of a method; numbers 0 of points and segments mean the start
    integer :: stages = 0, points = 0, unknowns = 0, segments = 0
    integer :: results(2) = 0                 ! points; the second is 0 where there is none
    integer, allocatable :: parent(:)         ! (points) a point before
    integer, allocatable :: weight_start(:)   ! (points + 1) where a point's weights begin
    integer, allocatable :: source(:)         ! (unknowns) segment at whose end their stages are
    integer, allocatable :: point(:)          ! (unknowns) their points
    integer, allocatable :: segment(:)        ! (unknowns) their segments
    integer, allocatable :: stage_segment(:)  ! (stages) segment at whose end they are
    integer, allocatable :: segment_start(:)  ! (segments + 1) first point
    integer, allocatable :: origin(:)         ! (segments) segment at whose end it begins
    integer, allocatable :: segment_at(:)     ! (0:points) that ends there, where one does
    integer :: inner = 0                      ! segments on the paths to stages are among the first
  end type pattern_t

  type :: weights_t                           ! workspace, and what evaluate_trees computes
    type(pattern_t) :: pattern
    integer :: order = 0
    integer :: stage_trees = 0                ! trees with at most order nodes
    integer, allocatable :: result_path(:)    ! points on the way to the first result
    integer, allocatable :: second_path(:)    ! points on the way to the second result
    real(wp), allocatable :: x(:)             ! (unknowns)
    real(wp), allocatable :: e(:, :)          ! (points, stage_trees) exponential of the flow
    real(wp), allocatable :: left(:, :)       ! (points, stage_trees) weight at the parent
    real(wp), allocatable :: letter(:, :)     ! (points, stage_trees)
    real(wp), allocatable :: chi(:, :)        ! (0:segments, stage_trees) weight at their ends
  contains
    procedure :: set_up, evaluate_trees, weight
  end type weights_t

contains

  ! Reads the code of a cg.construction.layouts.Layout: numbers of stages and points, both results,
  ! the points of stages, the parents, the number of weights of each point, and their stages.
  pure subroutine read_layout(layout, pattern)
    integer, intent(in) :: layout(:)
    type(pattern_t), intent(inout) :: pattern
    integer :: m, k, begin, stage_point(layout(1))       ! stage_point: (stages)
    logical :: ends(0:layout(2))       ! (0:points) whether a segment must end at a point

    pattern%stages = layout(1)
    pattern%points = layout(2)
    pattern%results = layout(3:4)
    begin = 4
    stage_point = layout(begin + 1:begin + pattern%stages)
    begin = begin + pattern%stages
    pattern%parent = layout(begin + 1:begin + pattern%points)
    begin = begin + pattern%points
    pattern%weight_start = [(1 + sum(layout(begin + 1:begin + m)), m=0, pattern%points)]
    pattern%unknowns = pattern%weight_start(pattern%points + 1) - 1
    pattern%point = [(spread(m, 1, layout(begin + m)), m=1, pattern%points)]
    begin = begin + pattern%points
    ends = [(any(m == [stage_point, pattern%results, pattern%points]), m=0, pattern%points)]
    do m = 1, pattern%points
      if (pattern%parent(m) == m - 1) cycle
      ends(pattern%parent(m)) = .true.
      ends(m - 1) = .true.
    end do
    ends(0) = .false.
    pattern%segments = count(ends)
    pattern%segment_start = [1, 1 + pack([(m, m=1, pattern%points)], ends(1:))]
    allocate (pattern%segment_at(0:pattern%points))
    pattern%segment_at(:) = unpack([(k, k=1, pattern%segments)], ends, 0)
    pattern%segment = [(count(pattern%segment_start <= pattern%point(k)), k=1, pattern%unknowns)]
    pattern%origin = pattern%segment_at(pattern%parent(pattern%segment_start(:pattern%segments)))
    pattern%stage_segment = pattern%segment_at(stage_point)
    pattern%source = pattern%stage_segment(layout(begin + 1:))
    pattern%inner = maxval([0, pattern%stage_segment])
  end subroutine read_layout

  ! The points from the start to a point, in this order.
  pure function path(pattern, point) result(points)
    type(pattern_t), intent(in) :: pattern
    integer, intent(in) :: point
    integer, allocatable :: points(:)
    integer :: m

    points = [integer ::]
    m = point
    do while (m > 0)
      points = [m, points]
      m = pattern%parent(m)
    end do
  end function path

  ! Takes the shape of a method, and the weights of the empty word, which are 1.
  subroutine set_up(self, order, layout)
    class(weights_t), intent(inout) :: self
    integer, intent(in) :: order, layout(:)              ! layout: see read_layout
    integer :: n

    call read_layout(layout, self%pattern)
    self%order = order
    self%result_path = path(self%pattern, self%pattern%results(1))
    self%second_path = path(self%pattern, self%pattern%results(2))
    self%stage_trees = tree_start(order + 1) - 1
    n = self%pattern%points
    allocate (self%chi(0:self%pattern%segments, self%stage_trees), self%e(n, self%stage_trees), &
              self%left(n, self%stage_trees), self%letter(n, self%stage_trees), source=0.0_wp)
    self%e(:, 1) = 1.0_wp
    self%left(:, 1) = 1.0_wp
    self%chi(:, 1) = 1.0_wp
  end subroutine set_up

  ! Computes the weights of all trees with at most `order` nodes at the ends of all segments.
  subroutine evaluate_trees(self, x)
    class(weights_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)  ! (unknowns)
    real(wp), dimension(self%pattern%points) :: e, change
    real(wp) :: total
    integer :: t, k, m

    self%x = x
    associate (pattern => self%pattern)
      call letters(pattern, x, self%chi(:, 1), self%letter(:, 1))
      do t = 2, self%stage_trees
        call flow(self, t, 1, pattern%points, e, change)
        self%e(:, t) = e
        do k = 1, pattern%segments
          total = self%chi(pattern%origin(k), t)
          do m = pattern%segment_start(k), pattern%segment_start(k + 1) - 1
            self%left(m, t) = total
            total = total + change(m)
          end do
          self%chi(k, t) = total
        end do
        call letters(pattern, x, self%chi(:, t), self%letter(:, t))
      end do
    end associate
  end subroutine evaluate_trees

  ! Computes the letters l_m(t) = sum_k alpha_mk Phi_k(t) of one tree at all points.
  pure subroutine letters(pattern, x, chi, letter)
    type(pattern_t), intent(in) :: pattern
    real(wp), intent(in) :: x(:)                   ! (unknowns)
    real(wp), intent(in), contiguous :: chi(0:)    ! (0:segments)
    real(wp), intent(out), contiguous :: letter(:) ! (points)
    real(wp) :: total
    integer :: m, k

    do m = 1, pattern%points
      total = 0.0_wp
      do k = pattern%weight_start(m), pattern%weight_start(m + 1) - 1
        total = total + x(k) * chi(pattern%source(k))
      end do
      letter(m) = total
    end do
  end subroutine letters

  ! Phi(t) of a result after evaluate_trees, for any tree with at most order + 1 nodes.
  function weight(self, t, second) result(phi)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t
    logical, intent(in) :: second  ! whether of the second result
    real(wp) :: phi

    if (t <= self%stage_trees) then
      phi = self%chi(self%pattern%segment_at(self%pattern%results(merge(2, 1, second))), t)
    else if (second) then
      phi = along(self, t, self%second_path)
    else
      phi = along(self, t, self%result_path)
    end if
  end function weight

  ! The weight at the end of a path, of a tree with order + 1 nodes
  function along(self, t, path) result(phi)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t, path(:)                    ! path: points, increasing
    real(wp) :: phi
    real(wp), dimension(self%pattern%points) :: e, change

    phi = 0.0_wp
    if (size(path) == 0) return
    associate (begin => path(1), last => path(size(path)))
      call flow(self, t, begin, last, e(begin:last), change(begin:last))
    end associate
    phi = sum(change(path))
  end function along

  ! Computes E_m(t) of a tree, the exponential of the letters, at some points, and what the flow
  ! adds to the weight: products over all splits of the word, one part before a point, one at it.
  pure subroutine flow(self, t, begin, last, e, change)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t, begin, last
    real(wp), intent(out), dimension(begin:last) :: e, change
    integer :: children, i

    children = child_start(t + 1) - child_start(t)
    if (iand(children, children - 1) == 0) then        ! a product is exact, too, and faster
      e = self%e(begin:last, rest(t)) * self%letter(begin:last, first(t)) &
          * (1.0_wp / real(children, wp))
    else
      e = self%e(begin:last, rest(t)) * self%letter(begin:last, first(t)) / real(children, wp)
    end if
    change = e
    do i = split_start(t) + 1, split_start(t + 1) - 2
      change = change + self%left(begin:last, head(i)) * self%e(begin:last, tail(i))
    end do
  end subroutine flow
end module weights_m
