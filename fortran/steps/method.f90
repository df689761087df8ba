! A method as paths of flows from one point to another. The points are stages, results, and points
! from which more than one path starts.
module method_m
  use blocks_m, only: flow_sequence_t
  use kinds, only: wp
  use newton_m, only: transformation_t
  implicit none
  private
  public :: method_t, make_method

  type :: method_t
    ! paths, in an order in which each can be followed when it is reached
    ! (paths) the path to its start, 0 for the start of the step
    integer, allocatable :: origin(:)
    integer, allocatable :: path_first(:)    ! (paths + 1) the first flow of each
    type(flow_sequence_t) :: flows           ! of all paths; their fields are those of the stages
    ! stages
    integer, allocatable :: stage_path(:)    ! (stages) the path to each, 0 for the start
    real(wp), allocatable :: c(:)            ! (stages) abscissae
    ! results
    integer :: result = 0                    ! the path to it
    integer :: embedded = 0                  ! the path to the second one of a pair
    integer :: third = 0                     ! the path to a third one, 0 if there is none
    logical, allocatable :: leads(:)         ! (0:paths) whether results are on or beyond it
    integer :: final_stage = 0               ! the stage at the end of the step, 0 if there is none
    ! of a splitting method, whose flows are kicks, each followed by a drift, that is, free motion
    logical :: splitting = .false.
    real(wp), allocatable :: drift(:)        ! (flows) in steps
    ! of a method of two registers, Z_i = a_i Z_(i-1) + f_i, y_i = exp(h b_i Z_i) y_(i-1)
    logical :: two_registers = .false.
    real(wp), allocatable :: a(:), b(:)      ! (stages)
    logical :: on_algebra = .false.
    logical :: polynomial = .false.          ! whether the flows of a path are one, see frames_m
    ! whether coefficients depend on time alone, at three nodes or more, of a Magnus method
    logical :: has_nodes = .false.
    logical :: implicit = .false.            ! whether it is another implicit method
    integer :: blocks = 0                    ! of stages that an implicit method solves together
    logical :: collocation = .false.         ! on_algebra; all stages but the first are implicit
    type(transformation_t) :: transformation ! of a collocation method
    integer :: series = 0                    ! order up to which the series of dexp^-1 is needed
    integer :: power = 1                     ! of the quotient of two error estimates
    real(wp) :: factor = 1.0_wp              ! of the second one in the quotient
    ! weights of the stages in error estimates that need no flow
    real(wp), allocatable :: error(:, :)     ! (stages, estimates)
  end type method_t

contains

  ! Makes a method. All its integers come as one list, as cg/integration/step/paths.py writes them:
  ! the numbers of paths, flows, terms and stages, then the components of the type in their order, 1
  ! if the method has two registers, a number that isn't zero if it is one on a Lie algebra, the
  ! power, the number of its error estimates by weights, the number of blocks of stages of an implicit
  ! method, 1 if the flows of a path are one along a polynomial, and 1 for a splitting method. The
  ! weights are followed by a and b of registers, by those of errors, by the entries of
  ! transformation_t, by the factor, and by drifts.
  subroutine make_method(list, weight, c, method)
    integer, intent(in) :: list(:)
    real(wp), intent(in) :: weight(:)        ! (terms + 1) or more
    real(wp), intent(in) :: c(:)             ! (stages)
    type(method_t), intent(out) :: method
    integer :: used, k

    used = 4
    associate (paths => list(1), flows => list(2), terms => list(3), stages => list(4))
      call take(paths, method%origin)
      call take(paths + 1, method%path_first)
      call take(flows + 1, method%flows%first)
      call take(terms, method%flows%stage)
      call take(stages, method%stage_path)
      method%flows%weight = weight(:terms)
      method%result = list(used + 1)
      method%embedded = list(used + 2)
      method%third = list(used + 3)
      method%final_stage = list(used + 4)
      method%two_registers = list(used + 5) == 1
      if (method%two_registers) then
        method%a = weight(terms + 1:terms + stages)
        method%b = weight(terms + stages + 1:terms + 2 * stages)
      end if
      method%series = list(used + 6)
      method%on_algebra = method%series > 0
      method%power = list(used + 7)
      k = terms
      if (method%two_registers) k = k + 2 * stages
      method%error = reshape(weight(k + 1:k + stages * list(used + 8)), [stages, list(used + 8)])
      k = k + size(method%error)
      method%blocks = list(used + 9)
      method%collocation = method%blocks > 0 .and. method%on_algebra
      method%implicit = method%blocks > 0 .and. .not. method%on_algebra
      if (method%collocation) then
        associate (scheme => method%transformation)
          scheme%inverse = reshape(weight(k + 1:k + 9), [3, 3])
          scheme%t = reshape(weight(k + 10:k + 18), [3, 3])
          scheme%t_inverse = reshape(weight(k + 19:k + 27), [3, 3])
          scheme%integral = reshape(weight(k + 28:k + 36), [3, 3])
          scheme%gamma = weight(k + 37)
          scheme%mu = weight(k + 38:k + 39)
        end associate
        k = k + 39
      end if
      method%factor = weight(k + 1)
      method%splitting = list(used + 11) == 1
      if (method%splitting) method%drift = weight(k + 2:k + 1 + flows)
    end associate
    method%c = c
    method%polynomial = list(used + 10) == 1
    method%has_nodes = method%blocks == 0 .and. size(c) > 2 .and. all(method%stage_path == 0)
    allocate (method%leads(0:size(method%origin)), source=.false.)
    method%leads([method%result, method%embedded, method%third]) = .true.
    do k = size(method%origin), 1, -1
      if (method%leads(k)) method%leads(method%origin(k)) = .true.
    end do

  contains

    subroutine take(length, part)
      integer, intent(in) :: length
      integer, allocatable, intent(out) :: part(:)

      part = list(used + 1:used + length)
      used = used + length
    end subroutine take

  end subroutine make_method

end module method_m
