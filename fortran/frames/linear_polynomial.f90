! Solutions of linear equations y' = X(t) y whose coefficients are polynomials in time, by Taylor
! polynomials.
module linear_polynomial_m
  use, intrinsic :: iso_fortran_env, only: int64
  use kinds, only: wp
  use lapack_m, only: dgemm
  use linear_action_m, only: linear_action_t, max_parts, max_terms, multiply, products
  use vectors_m, only: nan
  implicit none
  private
  public :: move_polynomially

  ! Norm of the parts into which the exponent is divided. At 1.5 times this norm Taylor polynomials
  ! lose up to three digits to cancellation.
  real(wp), parameter :: part_norm = 6.0_wp
  real(wp), parameter :: roundings = 128 * epsilon(1.0_wp)
  real(wp), parameter :: omitted = 0.1_wp    ! part of a tolerance that terms left out early share

contains

  ! Moves y along the solution of y' = sum_j (2 t - 1)^(j - 1) X_j y from t = 0 to 1, where X_j has
  ! the coefficients v(:, j). Time is divided so that Taylor polynomials lose few digits to
  ! cancellation; the parts share the tolerance that the step is granted, since their errors add up.
  ! Skew-Hermitian matrices preserve the norm of y, as the polynomials do to their tolerance only.
  subroutine move_polynomially(action, v, y)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: v(:, :)          ! (generators, degree + 1)
    real(wp), intent(inout) :: y(:)          ! (point_size)
    real(wp) :: d(size(v, 1), size(v, 2)), norm, length
    integer :: first, i, last, part, parts

    length = norm2(y)
    norm = dot_product(sum(abs(v), dim=2), action%norm) / part_norm
    if (.not. norm <= max_parts) then
      y = nan
      return
    end if
    parts = max(1, ceiling(norm))
    do while (max(bound(1), bound(parts)) > 1.5_wp * part_norm)
      parts = parts + (parts + 1) / 2
    end do
    last = 0
    do part = 1, parts
      d = coefficients(part)
      do i = 1, size(d, 1)                   ! rounding errors, such as those of constants
        where (abs(d(i, :)) <= roundings * maxval(abs(d(i, :)))) d(i, :) = 0.0_wp
      end do
      first = last + 1
      if (associated(action%inner)) then
        if (action%inner%wanted) last = count(action%inner%theta(:action%inner%count) &
                                              <= real(part, wp) / real(parts, wp))
      end if
      if (last < first) then
        call apply_polynomial(action, d, action%granted / real(parts, wp), y)
      else
        call apply_polynomial(action, d, action%granted / real(parts, wp), y, &
                              real(parts, wp) * action%inner%theta(first:last) &
                              - real(part - 1, wp), action%inner%y(:, first:last))
        if (.not. (action%skew .and. length > 0)) cycle
        do i = first, last
          action%inner%y(:, i) = action%inner%y(:, i) * (length / length_of(action%inner%y(:, i)))
        end do
      end if
    end do
    if (associated(action%inner)) action%inner%wanted = .false.
    if (action%skew .and. length > 0) y = y * (length / norm2(y))

  contains

    ! The coefficients in a part, by powers of its own time from 0 to 1
    pure function coefficients(part)
      integer, intent(in) :: part
      real(wp) :: coefficients(size(v, 1), size(v, 2))

      coefficients = shifted(v, 2 * real(part - 1, wp) / real(parts, wp) - 1, 2 / real(parts, wp)) &
                     / real(parts, wp)
    end function coefficients

    ! The sum of their norms, largest at an end of the step
    pure real(wp) function bound(part)
      integer, intent(in) :: part

      bound = dot_product(sum(abs(coefficients(part)), dim=2), action%norm)
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

  ! The coefficients of a polynomial in t, of which v has those in s = start + slope t
  pure function shifted(v, start, slope) result(d)
    real(wp), intent(in) :: v(:, :), start, slope
    real(wp) :: d(size(v, 1), size(v, 2))
    integer :: j, k

    d = v
    do j = 1, size(v, 2) - 1                           ! synthetic division by s - start
      do k = size(v, 2) - 1, j, -1
        d(:, k) = d(:, k) + start * d(:, k + 1)
      end do
    end do
    do j = 2, size(v, 2)
      d(:, j) = d(:, j) * slope**(j - 1)
    end do
  end function shifted

  ! Applies a Taylor polynomial. With y' = sum_m t^(m - 1) D_m y its coefficients are
  !     y_k = sum_i G_i sum_m d(i, m) y_(k - m) / k,
  ! one product of each generator. It ends when the next terms, as many as lead to all later ones,
  ! are negligible by bounds of their norms. Points at other times are sums of the same y_k.
  subroutine apply_polynomial(action, d, granted, y, times, inner)
    type(linear_action_t), intent(in) :: action
    real(wp), intent(in) :: d(:, :)          ! (generators, degree + 1)
    real(wp), intent(in) :: granted          ! part of the tolerance
    real(wp), intent(inout) :: y(action%point_size)
    real(wp), optional, intent(in) :: times(:)         ! from 0 to 1
    real(wp), optional, contiguous, intent(inout) :: inner(:, :)   ! (point_size, times)
    real(wp) :: terms(size(y), size(d, 2))   ! y_k in column 1 + modulo(k, degree + 1)
    real(wp) :: argument(size(y)), product(size(y)), term(size(y))
    real(wp) :: norms(size(d, 2))            ! of y_k, y_(k - 1), ...
    real(wp) :: bounds(size(d, 2)), start, tolerance, negligible
    integer :: i, k, m, n

    n = size(d, 2)
    bounds = [(dot_product(action%norm, abs(d(:, k))), k=1, n)]
    terms(:, 1) = y
    norms = 0.0_wp
    norms(1) = maxval(abs(y))
    start = norms(1) * epsilon(y) / 8
    tolerance = granted * (action%atol + action%rtol * norm2(y) / sqrt(real(action%n, wp)))
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
        call multiply(action, action%row(:, i), action%term_column, action%value, argument, product)
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
    products = products + int(min(k, max_terms), int64)

  contains

    ! Adds the terms up to y_k since the last call, which begin in the first column. Early times,
    ! for which they are negligible, are left out.
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
                   powers(:, early + 1:), m, merge(0.0_wp, 1.0_wp, k < n), inner(:, early + 1:), &
                   size(y))
      end associate
    end subroutine add_to_inner

  end subroutine apply_polynomial

  ! A bound of the sum of the norms of the terms after y_k, as many as have coefficients of their
  ! own, and up to those from where bounds halve with each term
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

end module linear_polynomial_m
