! Flows of linear vector fields y' = X y, X = sum_i v_i G_i with given sparse matrices G_i. The
! exponential of X is applied by Chebyshev polynomials if all G_i are skew-Hermitian, else by Taylor
! polynomials (cg/frames/linear_action.py), as are equations y' = X(t) y with polynomials in time.
!
! All G_i share one sparsity pattern, stored by rows. Entries of X are real (of points with real
! entries), imaginary, or complex; a complex number is stored as its real and its imaginary part.
module linear_action_m
  use kinds, only: wp
  use vectors_m, only: dgemm, nan
  implicit none
  private
  public :: inner_points_t, linear_action_t, linear_tangent, make_linear_action, move_linearly, &
            move_polynomially, spectral_bound

  integer, parameter :: real_entries = 0, imaginary_entries = 1, complex_entries = 2

  ! Points within a flow along a polynomial
  type :: inner_points_t
    integer :: owner = 0, count = 0          ! owner: the member of the step
    integer :: passed = 0                    ! output times before the first of them
    real(wp), allocatable :: theta(:)        ! (count) or more, fractions of the flow, increasing
    real(wp), allocatable :: y(:, :)         ! (point_size, count)
  end type inner_points_t

  type :: linear_action_t
    integer :: n = 0, generators = 0         ! n: entries of a point
    integer :: point_size = 0                ! real numbers of a point
    integer :: kind = real_entries
    integer :: reals_per_entry = 1           ! numbers for an entry of X, 2 if it is complex
    logical :: skew = .false.                ! whether all G_i are skew-Hermitian
    integer, allocatable :: first(:)         ! (n + 1) where rows of X begin
    integer, allocatable :: column(:)        ! (entries of X)
    ! (n generators + 1) the terms where rows of each generator begin, one generator after the other
    integer, allocatable :: row(:)
    integer, allocatable :: entry(:)         ! (reals_per_entry, terms) number in X that it adds to
    real(wp), allocatable :: value(:)        ! (reals_per_entry, terms) its coefficient
    integer, allocatable :: term_column(:)   ! (terms)
    real(wp), allocatable :: norm(:)         ! (generators) bounds of norms, sums of moduli in rows
    real(wp) :: rtol = 0.0_wp, atol = 0.0_wp ! tolerances of the point, zero if steps are fixed
  end type linear_action_t

  ! Largest norms of the pieces of an exponent, for which polynomials lose less than a digit
  real(wp), parameter :: taylor_norm = 2.0_wp, chebyshev_norm = 50.0_wp
  real(wp), parameter :: max_pieces = 1e7_wp
  integer, parameter :: max_terms = 200

  ! Norm of the pieces of flows along polynomials; at 1.5 times this norm three digits may be lost.
  real(wp), parameter :: polynomial_norm = 6.0_wp
  real(wp), parameter :: max_polynomial_norm = 1.5_wp * polynomial_norm
  real(wp), parameter :: roundings = 128 * epsilon(1.0_wp)   ! relative, of zero coefficients
  real(wp), parameter :: omitted = 0.1_wp    ! fraction of a tolerance for terms left out early

contains

  ! Makes an action from numbers as LinearAction of cg/frames/linear_action.py writes them, and
  ! counts them: n, generators, entries of X, terms, kind, 1 if skew; then the arrays of the type.
  subroutine make_linear_action(numbers, action, used)
    real(wp), intent(in) :: numbers(:)
    type(linear_action_t), intent(out) :: action
    integer, intent(out) :: used
    integer :: entries, i, j, m, terms

    action%n = nint(numbers(1))
    action%generators = nint(numbers(2))
    entries = nint(numbers(3))
    terms = nint(numbers(4))
    action%kind = nint(numbers(5))
    action%skew = numbers(6) > 0
    action%point_size = merge(1, 2, action%kind == real_entries) * action%n
    m = merge(2, 1, action%kind == complex_entries)
    action%reals_per_entry = m
    used = 6
    call take(action%n + 1, action%first)
    call take(entries, action%column)
    call take(action%n * action%generators + 1, action%row)
    call take(terms, action%term_column)
    call take(m * terms, action%entry)
    action%value = numbers(used + 1:used + m * terms)
    used = used + m * terms
    action%norm = [(maxval([(sum(abs(action%value( &
      m * (action%row(j) - 1) + 1:m * (action%row(j + 1) - 1)))), &
      j=(i - 1) * action%n + 1, i * action%n)]), i=1, action%generators)]

  contains

    ! Takes the next numbers as integers.
    subroutine take(length, array)
      integer, intent(in) :: length
      integer, allocatable, intent(out) :: array(:)

      array = nint(numbers(used + 1:used + length))
      used = used + length
    end subroutine take

  end subroutine make_linear_action

  ! Moves y along flows, the first one first; y is NaN if an exponent is too large or isn't finite.
  subroutine move_linearly(action, v, y)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:, :)          ! (generators, flows)
    real(wp), intent(inout) :: y(:)          ! (point_size)
    type(linear_action_t) :: whole           ! the action whose only generator is X
    real(wp), allocatable :: x(:)
    real(wp) :: norm
    integer :: j, piece, pieces

    do j = 1, size(v, 2)
      call combine_generators(action, v(:, j), x, norm)
      if (.not. (norm / chebyshev_norm <= max_pieces .and. all(abs(v(:, j)) <= huge(v)))) then
        y = nan
        return
      end if
      if (.not. action%skew) then
        whole = linear_action_t(n=action%n, generators=1, point_size=action%point_size, &
                                kind=action%kind, reals_per_entry=action%reals_per_entry, &
                                row=action%first, value=x, term_column=action%column, norm=[norm])
        call move_polynomially(whole, reshape([1.0_wp], [1, 1]), 0.0_wp, y)
        cycle
      end if
      pieces = max(1, ceiling(norm / chebyshev_norm))
      x = x / real(pieces, wp)
      do piece = 1, pieces
        call apply_chebyshev(action, x, max(norm / real(pieces, wp), epsilon(norm)), y)
      end do
    end do
  end subroutine move_linearly

  ! Computes X y.
  subroutine linear_tangent(action, v, y, tangent)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:), y(:)       ! (generators), (point_size)
    real(wp), intent(out) :: tangent(:)      ! (point_size)
    real(wp), allocatable :: x(:)
    real(wp) :: norm

    call combine_generators(action, v, x, norm)
    call multiply(action, action%first, action%column, x, y, tangent)
  end subroutine linear_tangent

  ! Computes the entries of X and a bound of its norm, the largest sum of moduli in a row.
  pure subroutine combine_generators(action, v, x, norm)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:)             ! (generators)
    real(wp), allocatable, intent(inout) :: x(:)   ! (reals_per_entry, entries)
    real(wp), intent(out) :: norm
    real(wp) :: row
    integer :: i, k, m

    m = action%reals_per_entry
    if (.not. allocated(x)) allocate (x(m * size(action%column)))
    x = 0.0_wp
    do i = 1, action%generators
      do k = m * action%row((i - 1) * action%n + 1) - m + 1, m * action%row(i * action%n + 1) - m
        x(action%entry(k)) = x(action%entry(k)) + v(i) * action%value(k)
      end do
    end do
    norm = 0.0_wp
    do i = 1, action%n
      row = sum(abs(x(m * action%first(i) - m + 1:m * action%first(i + 1) - m)))
      if (.not. row <= norm) norm = row
      if (.not. norm <= huge(norm)) return   ! a later row must not replace NaN
    end do
  end subroutine combine_generators

  ! A bound of the moduli of eigenvalues of X, by sums of rows or Frobenius' norm
  pure real(wp) function spectral_bound(action, v)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:)             ! (generators)
    real(wp), allocatable :: x(:)

    call combine_generators(action, v, x, spectral_bound)
    spectral_bound = min(spectral_bound, norm2(x))
  end function spectral_bound

  ! Applies exp(X) of skew-Hermitian X, whose norm is at most `norm`: with Bessel functions J_k,
  !     exp(X) = J_0(norm) + 2 sum_k J_k(norm) P_k,   P_(k + 1) = 2 X / norm P_k + P_(k - 1).
  subroutine apply_chebyshev(action, x, norm, y)
    type(linear_action_t), intent(in) :: action
    real(wp), contiguous, intent(in) :: x(:)
    real(wp), intent(in) :: norm
    real(wp), intent(inout) :: y(action%point_size)
    real(wp) :: p(size(y), 0:2)              ! P_k in column modulo(k, 3)
    real(wp) :: bessel(0:max_terms), bound
    integer :: k, last, next, now

    bound = 1.0_wp                           ! J_k(norm) is at most (norm / 2)^k / k!
    last = 0
    do while (last < max_terms .and. (bound > epsilon(norm) / 8 .or. last < 2))
      last = last + 1
      bound = bound * (norm / 2) / real(last, wp)
    end do
    bessel(:last) = bessel_jn(0, last, norm)
    last = max(1, findloc(abs(bessel(:last)) >= epsilon(norm) / 8, .true., 1, back=.true.) - 1)
    p(:, 0) = y
    call multiply(action, action%first, action%column, x, y, p(:, 1))
    p(:, 1) = p(:, 1) / norm
    y = bessel(0) * y + 2 * bessel(1) * p(:, 1)
    do k = 2, last
      now = modulo(k - 1, 3)
      next = modulo(k, 3)
      call multiply(action, action%first, action%column, x, p(:, now), p(:, next))
      p(:, next) = p(:, 3 - now - next) + (2 / norm) * p(:, next)
      y = y + 2 * bessel(k) * p(:, next)
    end do
  end subroutine apply_chebyshev

  ! Computes the product of a sparse matrix, stored by rows, and a point.
  pure subroutine multiply(action, first, column, x, y, product)
    type(linear_action_t), intent(in) :: action
    integer, intent(in) :: first(*)          ! (n + 1) or more, where rows begin
    integer, intent(in) :: column(*)         ! (entries)
    real(wp), intent(in) :: x(*)             ! (reals_per_entry, entries)
    real(wp), intent(in) :: y(*)             ! (point_size)
    real(wp), intent(inout) :: product(*)    ! (point_size)
    real(wp) :: a, b
    integer :: i, j, k

    select case (action%kind)
    case (real_entries)
      do i = 1, action%n
        a = 0.0_wp
        do k = first(i), first(i + 1) - 1
          a = a + x(k) * y(column(k))
        end do
        product(i) = a
      end do
    case (imaginary_entries)                 ! imaginary parts are stored
      do i = 1, action%n
        a = 0.0_wp
        b = 0.0_wp
        do k = first(i), first(i + 1) - 1
          j = 2 * column(k)
          a = a + x(k) * y(j - 1)
          b = b + x(k) * y(j)
        end do
        product(2 * i - 1) = -b
        product(2 * i) = a
      end do
    case (complex_entries)
      do i = 1, action%n
        a = 0.0_wp
        b = 0.0_wp
        do k = first(i), first(i + 1) - 1
          j = 2 * column(k)
          a = a + x(2 * k - 1) * y(j - 1) - x(2 * k) * y(j)
          b = b + x(2 * k - 1) * y(j) + x(2 * k) * y(j - 1)
        end do
        product(2 * i - 1) = a
        product(2 * i) = b
      end do
    end select
  end subroutine multiply

  ! Moves y along the solution of y' = sum_j (2 t - 1)^(j - 1) X_j y from t = 0 to 1, where X_j has
  ! the coefficients v(:, j). Time is divided so that Taylor polynomials lose few digits to
  ! cancellation; the pieces divide the share of the tolerances, since their errors add up.
  ! Skew-Hermitian matrices preserve the norm of y, which polynomials preserve up to the tolerance.
  subroutine move_polynomially(action, v, share, y, inner)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:, :)          ! (generators, degree + 1)
    real(wp), intent(in) :: share            ! of the tolerances; 0 for the level of rounding
    real(wp), intent(inout) :: y(:)          ! (point_size)
    type(inner_points_t), optional, intent(inout) :: inner   ! points to compute
    real(wp) :: d(size(v, 1), size(v, 2)), norm, length
    integer :: first, i, last, piece, pieces

    length = norm2(y)
    norm = dot_product(sum(abs(v), dim=2), action%norm) &
           / merge(taylor_norm, polynomial_norm, size(v, 2) == 1)
    if (.not. norm <= max_pieces) then
      y = nan
      return
    end if
    pieces = max(1, ceiling(norm))
    do while (max(bound(1), bound(pieces)) > max_polynomial_norm)
      pieces = pieces + (pieces + 1) / 2        ! by half
    end do
    last = 0
    do piece = 1, pieces
      d = coefficients(piece)
      do i = 1, size(d, 1)                   ! rounding errors, such as those of constants
        where (abs(d(i, :)) <= roundings * maxval(abs(d(i, :)))) d(i, :) = 0.0_wp
      end do
      first = last + 1
      if (present(inner)) &
        last = count(inner%theta(:inner%count) <= real(piece, wp) / real(pieces, wp))
      if (last < first) then
        call apply_polynomial(action, d, share / real(pieces, wp), y)
      else
        call apply_polynomial(action, d, share / real(pieces, wp), y, &
                              real(pieces, wp) * inner%theta(first:last) - real(piece - 1, wp), &
                              inner%y(:, first:last))
        if (.not. (action%skew .and. length > 0)) cycle
        do i = first, last
          inner%y(:, i) = inner%y(:, i) * (length / length_of(inner%y(:, i)))
        end do
      end if
    end do
    if (action%skew .and. length > 0) y = y * (length / norm2(y))

  contains

    ! The coefficients in a piece, by powers of its own time from 0 to 1
    pure function coefficients(piece) result(d)
      integer, intent(in) :: piece
      real(wp) :: d(size(v, 1), size(v, 2)), start
      integer :: j, k

      start = 2 * real(piece - 1, wp) / real(pieces, wp) - 1
      d = v
      do j = 1, size(v, 2) - 1                         ! synthetic division by 2 t - 1 - start
        do k = size(v, 2) - 1, j, -1
          d(:, k) = d(:, k) + start * d(:, k + 1)
        end do
      end do
      do j = 1, size(v, 2)
        d(:, j) = d(:, j) * (2 / real(pieces, wp))**(j - 1) / real(pieces, wp)
      end do
    end function coefficients

    ! The sum of their norms, largest at an end of the step
    pure real(wp) function bound(piece)
      integer, intent(in) :: piece

      bound = dot_product(sum(abs(coefficients(piece)), dim=2), action%norm)
    end function bound

  end subroutine move_polynomially

  ! The norm of a vector, whose squares don't overflow, by sums that vectorize
  pure real(wp) function length_of(y)
    real(wp), contiguous, intent(in) :: y(:)
    real(wp) :: sums(8)
    integer :: i

    sums = 0.0_wp
    do i = 1, size(y) - 7, 8
      sums = sums + y(i:i + 7)**2
    end do
    length_of = sqrt(sum(sums) + sum(y(size(y) - modulo(size(y), 8) + 1:)**2))
  end function length_of

  ! Applies a Taylor polynomial. With y' = sum_m t^(m - 1) D_m y its coefficients are
  !     y_k = sum_i G_i sum_m d(i, m) y_(k - m) / k,
  ! one product of each generator. It ends when the next terms, as many as lead to all later ones,
  ! are negligible by bounds of their norms. Points at other times are sums of the same y_k.
  subroutine apply_polynomial(action, d, share, y, times, inner)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: d(:, :)          ! (generators, degree + 1)
    real(wp), intent(in) :: share            ! of the tolerances
    real(wp), intent(inout) :: y(action%point_size)
    real(wp), optional, intent(in) :: times(:)         ! from 0 to 1
    real(wp), optional, contiguous, intent(inout) :: inner(:, :)   ! (point_size, times)
    real(wp) :: terms(size(y), size(d, 2))   ! y_k in column 1 + modulo(k, degree + 1)
    real(wp) :: argument(size(y)), product(size(y)), term(size(y))
    real(wp) :: norms(size(d, 2))            ! norms of y_k, y_(k - 1), ...
    real(wp) :: bounds(size(d, 2)), start, tolerance, negligible
    integer :: i, k, m, n

    n = size(d, 2)
    bounds = [(dot_product(action%norm, abs(d(:, k))), k=1, n)]
    terms(:, 1) = y
    norms = 0.0_wp
    norms(1) = maxval(abs(y))
    start = norms(1) * epsilon(y) / 8
    tolerance = share * (action%atol + action%rtol * norm2(y) / sqrt(real(action%n, wp)))
    negligible = omitted * max(start, tolerance) / real(size(d), wp)
    do k = 1, max_terms
      term = 0.0_wp
      do i = 1, action%generators
        argument = 0.0_wp
        do m = 1, min(k, n)
          if (abs(d(i, m)) * norms(m) * action%norm(i) > negligible) &
            argument = argument + d(i, m) * terms(:, 1 + modulo(k - m, n))
        end do
        if (.not. any(abs(d(i, :)) > 0)) cycle
        call multiply(action, action%row((i - 1) * action%n + 1:), action%term_column, &
                      action%value, argument, product)
        term = term + product
      end do
      term = term / real(k, wp)
      terms(:, 1 + modulo(k, n)) = term
      y = y + term
      norms = [maxval(abs(term)), norms(:n - 1)]
      if (modulo(k + 1, n) == 0) call add_to_inner(k)
      if (norms(1) > max(tolerance, start)) cycle
      if (rest(bounds, norms, k) &
          <= max(tolerance, min(start, maxval(abs(y)) * epsilon(y) / 8))) exit
    end do
    if (modulo(min(k, max_terms) + 1, n) > 0) call add_to_inner(min(k, max_terms))

  contains

    ! Adds the terms since the last call, but not at early times, where they are negligible.
    subroutine add_to_inner(k)
      integer, intent(in) :: k
      real(wp), allocatable :: powers(:, :)            ! (terms, times)
      integer :: early, i

      if (.not. present(times)) return
      associate (m => 1 + modulo(k, n), count_all => size(times))
        allocate (powers(m, count_all))
        powers(1, :) = times**(k - m + 1)
        early = 0
        if (k >= n) early = count(powers(1, :) * sum(norms(:m)) <= negligible)
        if (early == count_all) return
        do i = 2, m
          powers(i, :) = powers(i - 1, :) * times
        end do
        call dgemm('N', 'N', size(y), count_all - early, m, 1.0_wp, terms, size(y), &
          powers(:, early + 1:), m, merge(0.0_wp, 1.0_wp, k < n), inner(:, early + 1:), size(y))
      end associate
    end subroutine add_to_inner

  end subroutine apply_polynomial

  ! A bound of the sum of norms of the terms after y_k, up to where each is half of the last
  pure real(wp) function rest(bounds, norms, k)
    real(wp), intent(in) :: bounds(:)        ! (degree + 1) of the norms of D_m
    real(wp), intent(in) :: norms(:)         ! (degree + 1) of y_k, y_(k - 1), ...
    integer, intent(in) :: k
    real(wp) :: last(size(norms))
    integer :: j

    last = norms
    rest = 0.0_wp
    do j = 1, max(size(norms), ceiling(2 * sum(bounds)) - k)
      last = [dot_product(bounds, last) / real(k + j, wp), last(:size(last) - 1)]
      rest = rest + last(1)
    end do
  end function rest

end module linear_action_m
