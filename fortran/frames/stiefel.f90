! Matrices y of k orthonormal columns, with the fields y' = v - y v^T y for matrices v of the same
! shape. They are stored by rows, as transposes. Formulas are in cg/frames/stiefel.py.
!
! Flows on isospectral orbits: symmetric matrices with given eigenvalues, moved by y -> g y g^T with
! rotations g. A point is its own transpose, so that the order of storage doesn't matter. Rounding
! changes eigenvalues; they are replaced, in the eigenvectors of the rounded point.
module stiefel_m
  use blocks_m, only: algebra_coefficients, algebra_matrix
  use kinds, only: wp
  use vectors_m, only: dgetrf, dgetrs, dsyevd, nan
  use orthogonal_m, only: move_orthogonal, multiply, restore_orthogonal
  implicit none
  private
  public :: isospectral_coefficients, isospectral_tangent, move_isospectral, move_stiefel, &
            restore_isospectral, restore_stiefel, stiefel_coefficients, stiefel_tangent

  real(wp), parameter :: max_length = 1e4_wp

contains

  ! Moves y along one flow, in parts of length at most 1: to x z^-1 with z = 1 + m d + s a, x = y +
  ! v (s + d a), where a = v^T y, and s and d are series in m = v^T v. Too large v make it NaN.
  subroutine move_stiefel(k, n, v, y)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: v(k, n)
    real(wp), intent(inout) :: y(k, n)
    real(wp), dimension(k, k) :: m, s, d, c, a, z
    real(wp) :: length, part
    integer :: i, info, j, parts, pivot(k)

    length = norm2(v)
    if (.not. length <= max_length) then
      y = nan
      return
    end if
    parts = max(1, ceiling(length))
    part = 1 / real(parts, wp)
    m = part**2 * matmul(v, transpose(v))
    call sum_series(k, (part * length)**2, m, s, d)
    c = matmul(m, d)
    do i = 1, k
      c(i, i) = 1 + c(i, i)
    end do
    do j = 1, parts
      a = part * matmul(v, transpose(y))
      z = transpose(c) + matmul(transpose(a), s)
      y = y + part * matmul(transpose(s + matmul(d, a)), v)
      call dgetrf(k, k, z, k, pivot, info)
      call dgetrs('N', k, n, z, k, pivot, y, k, info)
    end do
  end subroutine move_stiefel

  ! The sums of m^j / (2 j + 1)! and m^j / (2 j + 2)!
  subroutine sum_series(k, bound, m, s, d)
    integer, intent(in) :: k
    real(wp), intent(in) :: bound                  ! the norm's, at most 1
    real(wp), intent(in) :: m(k, k)
    real(wp), intent(out) :: s(k, k), d(k, k)
    real(wp) :: power(k, k), factor, size_of_term
    integer :: i, j

    power = 0.0_wp
    do i = 1, k
      power(i, i) = 1.0_wp
    end do
    s = power
    d = power / 2
    size_of_term = 1.0_wp
    j = 0
    do while (size_of_term > epsilon(size_of_term) / 8)
      j = j + 1
      factor = 1 / real(2 * j * (2 * j + 1), wp)
      power = factor * matmul(m, power)
      size_of_term = size_of_term * bound * factor
      s = s + power
      d = d + power / real(2 * j + 2, wp)
    end do
  end subroutine sum_series

  ! One Newton-Schulz step
  subroutine restore_stiefel(k, n, y)
    integer, intent(in) :: k, n
    real(wp), intent(inout) :: y(k, n)

    y = 1.5_wp * y - 0.5_wp * matmul(matmul(y, transpose(y)), y)
  end subroutine restore_stiefel

  ! v - y v^T y
  subroutine stiefel_tangent(k, n, v, y, tangent)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: v(k, n), y(k, n)
    real(wp), intent(out) :: tangent(k, n)

    tangent = v - matmul(matmul(y, transpose(v)), y)
  end subroutine stiefel_tangent

  ! The coefficients x - y (y^T x) / 2 of a derivative x, and the square of the length of the rest
  subroutine stiefel_coefficients(k, n, y, x, v, dropped)
    integer, intent(in) :: k, n
    real(wp), intent(in) :: y(k, n), x(k, n)
    real(wp), intent(out) :: v(k, n), dropped
    real(wp) :: tangent(k, n)

    v = x - 0.5_wp * matmul(matmul(x, transpose(y)), y)
    call stiefel_tangent(k, n, v, y, tangent)
    dropped = sum((x - tangent)**2)
  end subroutine stiefel_coefficients

  ! Moves a point by the product of the rotations of all flows.
  subroutine move_isospectral(n, f, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: f(:, :)              ! (dimension, flows) coefficients of the flows
    real(wp), intent(inout) :: y(n, n)
    real(wp) :: g(n, n), product(n, n)           ! g is the transpose of the rotation
    integer :: i

    g = 0.0_wp
    do i = 1, n
      g(i, i) = 1.0_wp
    end do
    call move_orthogonal(n, .true., f, g)
    call multiply(n, y, g, product)
    call multiply(n, transpose(g), product, y)
    y = (y + transpose(y)) / 2
  end subroutine move_isospectral

  ! x y - y x for the skew matrix x with coefficients v, which is x y and its transpose
  subroutine isospectral_tangent(n, v, y, tangent)
    integer, intent(in) :: n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    real(wp), intent(in) :: y(n, n)
    real(wp), intent(out) :: tangent(n, n)
    real(wp) :: x(n, n), product(n, n)

    call algebra_matrix(n, v, x)
    call multiply(n, x, y, product)
    tangent = product + transpose(product)
  end subroutine isospectral_tangent

  ! Replaces the eigenvalues, which rounding has changed, by the given ones.
  subroutine restore_isospectral(n, spectrum, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n)          ! increasing
    real(wp), intent(inout) :: y(n, n)
    real(wp) :: vectors(n, n), lambda(n)

    if (.not. all(abs(y) <= huge(y))) return     ! no eigenvalues
    call decompose(n, spectrum, y, lambda, vectors)
    call multiply(n, vectors, spread(lambda, 2, n) * transpose(vectors), y)
    y = (y + transpose(y)) / 2
  end subroutine restore_isospectral

  ! The coefficients of a derivative, without isotropy, and the square of the length of the rest. In
  ! eigenvectors an entry of the derivative is that of the generator times a gap of eigenvalues.
  subroutine isospectral_coefficients(n, spectrum, y, slope, v, dropped)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n), y(n, n), slope(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    real(wp), intent(out) :: dropped
    real(wp) :: vectors(n, n), x(n, n), product(n, n), lambda(n)
    integer :: j

    v = nan
    dropped = 0.0_wp
    if (.not. all(abs(y) <= huge(y))) return
    call decompose(n, spectrum, y, lambda, vectors)
    call multiply(n, slope, vectors, product)
    call multiply(n, transpose(vectors), product, x)
    do j = 1, n
      where (abs(lambda(j) - lambda) > real(n, wp) * epsilon(1.0_wp) * maxval(abs(spectrum)))
        x(:, j) = x(:, j) / (lambda(j) - lambda)
      elsewhere
        x(:, j) = 0.0_wp
      end where
    end do
    call multiply(n, vectors, x, product)
    call multiply(n, product, transpose(vectors), x)
    call algebra_coefficients(n, x, v)
    call isospectral_tangent(n, v, y, product)
    dropped = sum((slope - product)**2)
  end subroutine isospectral_coefficients

  ! Computes orthonormal eigenvectors of a point; the given eigenvalue of each has the same rank.
  subroutine decompose(n, spectrum, y, lambda, vectors)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n), y(n, n)
    real(wp), intent(out) :: lambda(n), vectors(n, n)
    real(wp) :: mu(n), work(1 + 6 * n + 2 * n**2)      ! mu: the rounded eigenvalues
    integer :: iwork(3 + 5 * n), info, k

    vectors = y
    call dsyevd('V', 'U', n, vectors, n, mu, work, size(work), iwork, size(iwork), info)
    call restore_orthogonal(n, vectors)
    do k = 1, n
      lambda(k) = spectrum(1 + count(mu(:k - 1) <= mu(k)) + count(mu(k + 1:) < mu(k)))
    end do
  end subroutine decompose

end module stiefel_m
