! Elementary weights of a method, which is a tree of points, for all ordered trees up to an order.
!
! A point m is reached from its parent by the flow of a combination of frozen fields, with weights
! alpha_mk on the fields of stages k. A tree is a word of trees, and the flow acts on words as the
! character E_m(v) = l_m(v_1) ... l_m(v_n) / n!, n the length of v, with the letters
! l_m(t) = sum_k alpha_mk Phi_k(t). So words have at a point the weight
!
!     chi_m(w) = sum over w = u v of chi_parent(m)(u) E_m(v),
!
! and Phi_k is the weight at the point where stage k is. Vectors run over the points. Points that
! follow each other without a branch, a stage or a result between them make a segment; weights are
! kept at the ends of segments. The rows of a Crouch-Grossman tableau are segments, with a weight
! a point.
module weights_m
  use kinds, only: wp
  use tree_tables, only: tree_start, child_start, first, rest, prefix
  implicit none
  private
  public :: weights_t, split_word

  type :: pattern_t  ! the shape of a method; numbers 0 of points and segments mean the start
    integer :: stages = 0, points = 0, unknowns = 0, segments = 0
    integer :: results(2) = 0                 ! points; the second is 0 where there is none
    logical :: one_weight = .false.           ! at each point
    integer, allocatable :: parent(:)         ! (points) a point before
    integer, allocatable :: weight_start(:)   ! (points + 1) where a point's weights begin
    integer, allocatable :: at(:)             ! (unknowns) segment at whose end their stages are
    integer, allocatable :: stage_point(:)    ! (stages)
    integer, allocatable :: segment_start(:)  ! (segments + 1) first point
    integer, allocatable :: origin(:)         ! (segments) segment at whose end it begins
    integer, allocatable :: segment_at(:)     ! (0:points) that ends there, where one does
    integer :: inner = 0                      ! segments on the paths to stages are among the first
  contains
    procedure :: path
    procedure :: segment_of_stage
  end type pattern_t

  type :: weights_t  ! workspace, and the result of evaluate
    type(pattern_t) :: pattern
    integer :: order = 0
    integer :: stage_trees = 0                ! trees with at most order nodes
    integer, allocatable :: split_start(:)    ! (trees + 1) where a tree's proper splits begin
    integer, allocatable :: head(:), tail(:)  ! a word cut in two, for each place to cut
    integer, allocatable :: result_path(:)    ! points on the way to the first result
    integer, allocatable :: second_path(:)    ! and to the second
    real(wp), allocatable :: x(:)             ! (unknowns)
    real(wp), allocatable :: e(:, :)          ! (points, stage_trees) exponential of the flow
    real(wp), allocatable :: left(:, :)       ! (points, stage_trees) weight at the parent
    real(wp), allocatable :: letter(:, :)     ! (points, stage_trees)
    real(wp), allocatable :: chi(:, :)        ! (0:segments, stage_trees) weight at their ends
  contains
    procedure :: set_up
    procedure :: evaluate
    procedure :: weight
    procedure :: stage_weight
  end type weights_t

contains

  ! Reads what cg.structure.layout.Layout.code says: numbers of stages and points, both results,
  ! then the points of stages, the parents, how many weights each point has, and the stages of the
  ! weights.
  pure subroutine read_layout(layout, pattern)
    integer, intent(in) :: layout(:)
    type(pattern_t), intent(inout) :: pattern
    integer :: m, k, begin
    logical, allocatable :: ends(:)  ! (0:points) whether a segment must end at a point

    pattern%stages = layout(1)
    pattern%points = layout(2)
    pattern%results = layout(3:4)
    begin = 4
    pattern%stage_point = layout(begin + 1:begin + pattern%stages)
    begin = begin + pattern%stages
    pattern%parent = layout(begin + 1:begin + pattern%points)
    begin = begin + pattern%points
    allocate (pattern%weight_start(pattern%points + 1))
    pattern%weight_start(1) = 1
    do m = 1, pattern%points
      pattern%weight_start(m + 1) = pattern%weight_start(m) + layout(begin + m)
    end do
    pattern%unknowns = pattern%weight_start(pattern%points + 1) - 1
    pattern%one_weight = all(layout(begin + 1:begin + pattern%points) == 1)
    begin = begin + pattern%points

    allocate (ends(0:pattern%points), source=.false.)
    ends(pattern%stage_point) = .true.
    ends(pattern%results) = .true.
    if (pattern%points > 0) ends(pattern%points) = .true.
    do m = 1, pattern%points
      if (pattern%parent(m) == m - 1) cycle
      ends(pattern%parent(m)) = .true.
      ends(m - 1) = .true.
    end do
    ends(0) = .false.
    pattern%segments = count(ends)
    allocate (pattern%segment_start(pattern%segments + 1), pattern%origin(pattern%segments))
    allocate (pattern%segment_at(0:pattern%points), source=0)
    pattern%segment_start(1) = 1
    k = 0
    do m = 1, pattern%points
      if (.not. ends(m)) cycle
      k = k + 1
      pattern%segment_at(m) = k
      pattern%segment_start(k + 1) = m + 1
    end do
    do k = 1, pattern%segments
      pattern%origin(k) = pattern%segment_at(pattern%parent(pattern%segment_start(k)))
    end do
    pattern%at = pattern%segment_at(pattern%stage_point(layout(begin + 1:)))
    pattern%inner = 0
    if (pattern%stages > 0) pattern%inner = maxval(pattern%segment_at(pattern%stage_point))
  end subroutine read_layout

  ! The points from the start to a point, in this order.
  pure function path(self, point) result(points)
    class(pattern_t), intent(in) :: self
    integer, intent(in) :: point
    integer, allocatable :: points(:)
    integer :: m, length

    length = 0
    m = point
    do while (m > 0)
      length = length + 1
      m = self%parent(m)
    end do
    allocate (points(length))
    m = point
    do while (m > 0)
      points(length) = m
      length = length - 1
      m = self%parent(m)
    end do
  end function path

  ! The segment at whose end a stage is
  pure integer function segment_of_stage(self, stage) result(segment)
    class(pattern_t), intent(in) :: self
    integer, intent(in) :: stage

    segment = self%segment_at(self%stage_point(stage))
  end function segment_of_stage

  ! head(i), tail(i): the words of the first i children, and of the others, 0 <= i <= children.
  pure subroutine split_word(tree, children, head, tail)
    integer, intent(in) :: tree
    integer, intent(out) :: children
    integer, intent(out) :: head(0:), tail(0:)  ! (0:children) at least
    integer :: i

    children = child_start(tree + 1) - child_start(tree)
    head(children) = tree
    tail(0) = tree
    do i = 1, children
      tail(i) = rest(tail(i - 1))
      head(children - i) = prefix(head(children - i + 1))
    end do
  end subroutine split_word

  ! Allocates the workspace for a method and an order.
  subroutine set_up(self, order, layout)
    class(weights_t), intent(inout) :: self
    integer, intent(in) :: order
    integer, intent(in) :: layout(:)  ! see read_layout
    integer :: t, children, cuts, trees, n
    integer :: head(0:order), tail(0:order)

    call read_layout(layout, self%pattern)
    self%order = order
    self%result_path = self%pattern%path(self%pattern%results(1))
    self%second_path = self%pattern%path(self%pattern%results(2))
    self%stage_trees = tree_start(order + 1) - 1
    trees = tree_start(order + 2) - 1
    n = self%pattern%points
    allocate (self%split_start(trees + 1))
    self%split_start(1:2) = 1
    do t = 2, trees
      children = child_start(t + 1) - child_start(t)
      self%split_start(t + 1) = self%split_start(t) + children - 1
    end do
    cuts = self%split_start(trees + 1) - 1
    allocate (self%head(cuts), self%tail(cuts))
    do t = 2, trees
      call split_word(t, children, head, tail)
      associate (begin => self%split_start(t), last => self%split_start(t + 1) - 1)
        self%head(begin:last) = head(1:children - 1)
        self%tail(begin:last) = tail(1:children - 1)
      end associate
    end do
    allocate (self%x(self%pattern%unknowns))
    allocate (self%chi(0:self%pattern%segments, self%stage_trees), source=0.0_wp)
    allocate (self%e(n, self%stage_trees), source=0.0_wp)
    allocate (self%left(n, self%stage_trees), source=0.0_wp)
    allocate (self%letter(n, self%stage_trees), source=0.0_wp)
    self%e(:, 1) = 1.0_wp
    self%left(:, 1) = 1.0_wp
    self%chi(:, 1) = 1.0_wp
  end subroutine set_up

  ! Computes the weights of all trees with at most `order` nodes at the ends of all segments.
  subroutine evaluate(self, x)
    class(weights_t), intent(inout) :: self
    real(wp), intent(in) :: x(:)  ! (unknowns)
    real(wp) :: change(self%pattern%points)
    integer :: t

    self%x = x
    call letters(self, 1)
    do t = 2, self%stage_trees
      call exponential(self, t, 1, self%pattern%points, self%e(:, t))
      change = self%e(:, t)
      call add_splits(self, t, 1, self%pattern%points, change)
      call add_up(self%pattern%points, self%pattern%segments, self%pattern%segment_start, &
                  self%pattern%origin, change, self%left(:, t), self%chi(:, t))
      call letters(self, t)
    end do
  end subroutine evaluate

  ! Sums of what the flows add to a weight, along each segment. The weight at the start is given.
  pure subroutine add_up(points, segments, segment_start, origin, change, left, chi)
    integer, intent(in) :: points, segments
    integer, intent(in) :: segment_start(segments + 1), origin(segments)
    real(wp), intent(in) :: change(points)
    real(wp), intent(out) :: left(points)
    real(wp), intent(inout) :: chi(0:segments)
    real(wp) :: total
    integer :: k, m

    do k = 1, segments
      total = chi(origin(k))
      do m = segment_start(k), segment_start(k + 1) - 1
        left(m) = total
        total = total + change(m)
      end do
      chi(k) = total
    end do
  end subroutine add_up

  ! Computes the letters of a tree at all points.
  pure subroutine letters(self, t)
    class(weights_t), intent(inout) :: self
    integer, intent(in) :: t

    associate (pattern => self%pattern)
      if (pattern%one_weight) then
        call scale_by_weights(pattern%points, pattern%segments, self%x, pattern%at, self%chi(:, &
                                                                                             t), &
                   self%letter(:, t))
      else
        call combine(pattern%points, pattern%unknowns, pattern%segments, pattern%weight_start, &
                     self%x, pattern%at, self%chi(:, t), self%letter(:, t))
      end if
    end associate
  end subroutine letters

  ! Letters where each point has one weight
  pure subroutine scale_by_weights(points, segments, x, at, chi, letter)
    integer, intent(in) :: points, segments
    real(wp), intent(in) :: x(points), chi(0:segments)
    integer, intent(in) :: at(points)
    real(wp), intent(out) :: letter(points)
    integer :: m

    do m = 1, points
      letter(m) = x(m)*chi(at(m))
    end do
  end subroutine scale_by_weights

  ! Letters where points have several weights
  pure subroutine combine(points, unknowns, segments, weight_start, x, at, chi, letter)
    integer, intent(in) :: points, unknowns, segments
    integer, intent(in) :: weight_start(points + 1), at(unknowns)
    real(wp), intent(in) :: x(unknowns), chi(0:segments)
    real(wp), intent(out) :: letter(points)
    integer :: m, k

    do m = 1, points
      letter(m) = 0.0_wp
      do k = weight_start(m), weight_start(m + 1) - 1
        letter(m) = letter(m) + x(k)*chi(at(k))
      end do
    end do
  end subroutine combine

  ! Phi(t) of a result after evaluate, for any tree with at most order + 1 nodes.
  function weight(self, t, second) result(phi)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t
    logical, intent(in) :: second  ! of the second result
    real(wp) :: phi

    if (t <= self%stage_trees) then
      phi = self%chi(self%pattern%segment_at(self%pattern%results(merge(2, 1, second))), t)
    else
      phi = 0.0_wp
      if (second) then
        if (size(self%second_path) > 0) phi = along(self, t, self%second_path)
      else
        if (size(self%result_path) > 0) phi = along(self, t, self%result_path)
      end if
    end if
  end function weight

  ! The weight at the end of a path
  function along(self, t, path) result(phi)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t
    integer, intent(in) :: path(:)  ! points, increasing, at least one
    real(wp) :: phi
    real(wp) :: change(path(1):path(size(path)))
    integer :: i

    associate (begin => path(1), last => path(size(path)))
      call exponential(self, t, begin, last, change)
      call add_splits(self, t, begin, last, change)
    end associate
    if (size(change) == size(path)) then
      phi = sum(change)
    else
      phi = 0.0_wp
      do i = 1, size(path)
        phi = phi + change(path(i))
      end do
    end if
  end function along

  ! Phi_k(t) after evaluate, for trees with at most order nodes.
  pure function stage_weight(self, t, stage) result(phi)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t, stage
    real(wp) :: phi

    phi = self%chi(self%pattern%segment_of_stage(stage), t)
  end function stage_weight

  ! Computes E_m(t) of a tree, the exponential of the letters, at some points.
  pure subroutine exponential(self, t, begin, last, e)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t, begin, last
    real(wp), intent(out) :: e(begin:last)
    integer :: children

    children = child_start(t + 1) - child_start(t)
    if (children == 1) then
      e = self%letter(begin:last, first(t))
    else if (iand(children, children - 1) == 0) then  ! a product is exact, too, and faster
      e = self%e(begin:last, rest(t))*self%letter(begin:last, first(t))*(1.0_wp/real(children, wp))
    else
      e = self%e(begin:last, rest(t))*self%letter(begin:last, first(t))/real(children, wp)
    end if
  end subroutine exponential

  ! Adds the products over all proper splits of a word, one part before a point and one at it.
  pure subroutine add_splits(self, t, begin, last, change)
    class(weights_t), intent(in) :: self
    integer, intent(in) :: t, begin, last
    real(wp), intent(inout) :: change(begin:last)
    integer :: i

    do i = self%split_start(t), self%split_start(t + 1) - 1
      change = change + self%left(begin:last, self%head(i))*self%e(begin:last, self%tail(i))
    end do
  end subroutine add_splits
end module weights_m
