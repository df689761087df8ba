! A method as paths of flows between points: stages, results, and points where paths fork.
module method_m
  use, intrinsic :: iso_c_binding, only: c_f_pointer, c_int64_t, c_intptr_t, c_null_ptr
  use blocks_m, only: flow_sequence_t
  use kinds, only: wp
  use shared_numbers, only: algebra_kind, collocation_kind, method_record_t, registers_kind, &
                            parts_of_results_estimate, polynomial_kind, splitting_kind, &
                            whole_estimate
  implicit none
  private
  public :: method_t, make_method, reals, scheme_t

  ! Numbers of collocation_m, in the order in which Python has them
  type :: transformation_t
    sequence
    real(wp) :: inverse(3, 3) = 0.0_wp       ! A^-1
    real(wp) :: t(3, 3) = 0.0_wp, t_inverse(3, 3) = 0.0_wp
    real(wp) :: integral(3, 3) = 0.0_wp      ! (power, stage) of integrals of Lagrange's polynomials
    real(wp) :: gamma = 0.0_wp, mu(2) = 0.0_wp         ! mu: real and imaginary part
  end type transformation_t

  ! The coefficients of the interpolants of a method
  type :: scheme_t
    integer :: vectors = 0                   ! number of vectors of an interpolant
    logical :: at_stages = .false.           ! whether the stages are all nodes, at known times
    ! on a Lie algebra
    logical :: flat = .false.                ! whether the stages of a flat method are used
    integer :: final = 0                     ! number of the derivative at the end
    integer :: series = 0                    ! order up to which dexp^-1 is needed
    real(wp), allocatable :: theta(:)        ! (further) nodes
    real(wp), allocatable :: node_weights(:, :)        ! (derivatives, further) of k_j in u there
    real(wp), allocatable :: basis(:, :)     ! (derivatives, degree)
    ! by flows
    integer :: nodes = 2
    real(wp), allocatable :: node(:, :)      ! (nodes, 2:nodes) column n has n nodes
    real(wp), allocatable :: blend(:, :)     ! (0:nodes + 1, 2:nodes) coefficients of w for n nodes
    real(wp), allocatable :: c(:)            ! (stages) abscissae of those that lead to the result
    real(wp), allocatable :: weight(:, :)    ! (stages, flows)
    real(wp), allocatable :: drift(:)        ! (flows) in steps, of a splitting method, after kicks
  end type scheme_t

  type :: method_t
    integer :: kind = 0                      ! a StepKind: by it step.f90 and paths.f90 choose
    ! paths
    integer, allocatable :: origin(:)        ! (paths) the path before, 0 for the start of the step
    integer, allocatable :: path_first(:)    ! (paths + 1) first flow
    type(flow_sequence_t) :: flows           ! flows of all paths, with fields at the stages
    ! stages
    integer, allocatable :: stage_path(:)    ! (stages) the path to each, 0 for the start
    real(wp), allocatable :: c(:)            ! (stages) abscissae
    ! results
    integer :: result = 0                    ! the path to the result
    integer :: embedded = 0, third = 0       ! paths to a second and a third result, or 0
    logical, allocatable :: leads(:)         ! (0:paths) whether a path leads to a result
    integer :: final_stage = 0               ! the stage at the end of the step, 0 if there is none
    real(wp), allocatable :: a(:), b(:)      ! (stages) of a method of two registers
    logical :: uses_last_nodes = .false.     ! whether estimates use the nodes of the step before
    integer :: estimate = whole_estimate     ! an EstimateForm
    logical :: in_parts = .false.            ! whether error estimates are of two parts
    integer :: blocks = 0                    ! number of sets of stages solved together
    type(transformation_t) :: transformation ! of a collocation method
    integer :: series = 0                    ! order up to which the series of dexp^-1 is needed
    integer :: power = 1                     ! power of a quotient, see error_estimate_m
    real(wp) :: factor = 1.0_wp              ! factor of the second estimate in the quotient
    ! Summands are the coefficients at the stages, then their brackets.
    real(wp), allocatable :: error(:, :)     ! (summands, estimates) of errors that need no flow
    real(wp), allocatable :: bracket(:, :, :)          ! (summands, 2, brackets) of both sides
    type(scheme_t) :: scheme
  end type method_t

contains

  subroutine make_method(record, method)
    type(method_record_t), intent(in) :: record
    type(method_t), intent(out) :: method
    type(transformation_t), pointer :: transformation
    integer(c_int64_t) :: summands
    integer :: k

    method = method_t(kind=int(record%kind), result=int(record%result), &
      embedded=int(record%embedded), third=int(record%third), factor=record%factor, &
      final_stage=int(record%final_stage), blocks=int(record%blocks), power=int(record%power), &
      uses_last_nodes=record%kept_nodes > 0, series=int(record%series), &
      estimate=int(record%estimate))
    summands = record%stages + record%bracket_count
    method%origin = int(reals(record%origin, record%paths))
    method%path_first = int(reals(record%path_first, record%paths + 1))
    method%flows%first = int(reals(record%flow_first, record%flows + 1))
    method%flows%stage = int(reals(record%flow_stage, record%terms))
    method%flows%weight = reals(record%weight, record%terms)
    method%stage_path = int(reals(record%stage_path, record%stages))
    method%c = reals(record%c, record%stages)
    if (method%kind == registers_kind) then
      method%a = reals(record%registers, record%stages)
      method%b = reals(record%registers + 8 * record%stages, record%stages)
    end if
    method%error = reshape(reals(record%error, summands * record%errors), [summands, record%errors])
    method%bracket = reshape(reals(record%brackets, 2 * summands * record%bracket_count), &
                             [summands, 2_c_int64_t, record%bracket_count])
    if (method%kind == collocation_kind) then
      call c_f_pointer(transfer(record%transformation, c_null_ptr), transformation)
      method%transformation = transformation
    end if
    method%in_parts = method%estimate >= parts_of_results_estimate     ! the first such form
    allocate (method%leads(0:size(method%origin)), source=.false.)
    do k = size(method%origin), 1, -1
      if (any(k == [method%result, method%embedded, method%third])) method%leads(k) = .true.
      if (method%leads(k)) method%leads(method%origin(k)) = .true.
    end do
    call make_scheme(record, method%kind, method%scheme)
    if (method%kind == splitting_kind) method%scheme%drift = reals(record%drifts, record%flows)
  end subroutine make_method

  ! Makes the coefficients of interpolants from the record.
  subroutine make_scheme(record, kind, scheme)
    type(method_record_t), intent(in) :: record
    integer, intent(in) :: kind
    type(scheme_t), intent(out) :: scheme

    associate (n => record%nodes, m => record%derivatives, stages => record%result_stages)
      scheme = scheme_t(vectors=int(max(record%degree, n + 1)), nodes=int(n), &
        at_stages=kind == polynomial_kind, flat=any(kind == [algebra_kind, collocation_kind]), &
        final=int(record%final), series=int(record%output_series), &
        theta=reals(record%theta, record%further), c=reals(record%flow_c, stages))
      scheme%node_weights = reshape(reals(record%rows, m * record%further), [m, record%further])
      scheme%basis = reshape(reals(record%basis, m * record%degree), [m, record%degree])
      allocate (scheme%node(n, 2:n), scheme%blend(0:n + 1, 2:n))
      scheme%node(:, :) = transpose(reshape(reals(record%node, n * (n - 1)), [n - 1, n]))
      scheme%blend(:, :) = transpose(reshape(reals(record%blend, (n + 2) * (n - 1)), &
                                             [n - 1, n + 2]))
      scheme%weight = reshape(reals(record%flow_weights, stages * record%result_flows), &
                              [stages, record%result_flows])
    end associate
  end subroutine make_scheme

  function reals(address, count)
    integer(c_intptr_t), intent(in) :: address
    integer(c_int64_t), intent(in) :: count
    real(wp), allocatable :: reals(:)
    real(wp), pointer, contiguous :: array(:)

    call c_f_pointer(transfer(address, c_null_ptr), array, [count])
    reals = array
  end function reals

end module method_m
