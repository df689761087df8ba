! Flows on isospectral orbits: symmetric matrices with given eigenvalues, moved by y -> g y g^T with
! rotations g. A point is its own transpose, so that the order of storage doesn't matter. Rounding
! changes eigenvalues; they are replaced, in the eigenvectors of the rounded point, which Jacobi's
! rotations compute to full relative accuracy for few rows and LAPACK's dsyevd for many.
module isospectral_m
  use kinds, only: wp
  use bases_m, only: skew_coefficients, skew_matrix
  use lapack_m, only: dsyevd
  use orthogonal_m, only: largest_own, move_orthogonal, multiply, multiply_symmetric, to_orthogonal
  use vectors_m, only: nan
  implicit none
  private
  public :: isospectral_coefficients, isospectral_tangent, move_isospectral, restore_isospectral

  integer, parameter :: max_sweeps = 30

contains

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
    call multiply_symmetric(n, g, product, y)
    if (n > largest_own) y = (y + transpose(y)) / 2
  end subroutine move_isospectral

  ! x y - y x for the skew matrix x with coefficients v, which is x y and its transpose
  subroutine isospectral_tangent(n, v, y, tangent)
    integer, intent(in) :: n
    real(wp), intent(in) :: v(:)                 ! (dimension)
    real(wp), intent(in) :: y(n, n)
    real(wp), intent(out) :: tangent(n, n)
    real(wp) :: x(n, n), product(n, n)

    call skew_matrix(n, v, x)
    call multiply(n, x, y, product)
    tangent = product + transpose(product)
  end subroutine isospectral_tangent

  ! Replaces the eigenvalues, which rounding has changed, by the given ones.
  subroutine restore_isospectral(n, spectrum, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n)          ! increasing
    real(wp), intent(inout) :: y(n, n)
    real(wp) :: vectors(n, n), scaled(n, n), own(n)
    integer :: k

    if (.not. all(abs(y) <= huge(y))) return     ! no eigenvalues
    call decompose(n, spectrum, y, own, vectors)
    do k = 1, n
      scaled(k, :) = own(k) * vectors(:, k)
    end do
    vectors = transpose(vectors)
    call multiply_symmetric(n, vectors, scaled, y)
    if (n > largest_own) y = (y + transpose(y)) / 2
  end subroutine restore_isospectral

  ! The coefficients of a derivative, without isotropy, and the square of the length of the rest. In
  ! eigenvectors an entry of the derivative is that of the generator times a gap of eigenvalues.
  subroutine isospectral_coefficients(n, spectrum, y, slope, v, dropped)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n), y(n, n), slope(n, n)
    real(wp), intent(out) :: v(:)                ! (dimension)
    real(wp), intent(out) :: dropped
    real(wp) :: vectors(n, n), x(n, n), product(n, n), own(n)
    integer :: i, j

    v = nan
    dropped = 0.0_wp
    if (.not. all(abs(y) <= huge(y))) return
    call decompose(n, spectrum, y, own, vectors)
    call multiply(n, slope, vectors, product)
    call multiply(n, transpose(vectors), product, x)
    do j = 1, n
      do i = 1, n
        if (abs(own(j) - own(i)) > real(n, wp) * epsilon(1.0_wp) * maxval(abs(spectrum))) then
          x(i, j) = x(i, j) / (own(j) - own(i))
        else
          x(i, j) = 0.0_wp
        end if
      end do
    end do
    call multiply(n, vectors, x, product)
    call multiply(n, product, transpose(vectors), x)
    call skew_coefficients(n, (x - transpose(x)) / 2, v)
    call isospectral_tangent(n, v, y, product)
    dropped = sum((slope - product)**2)
  end subroutine isospectral_coefficients

  ! Orthonormal eigenvectors of a point, and the given eigenvalue of each
  subroutine decompose(n, spectrum, y, own, vectors)
    integer, intent(in) :: n
    real(wp), intent(in) :: spectrum(n), y(n, n)
    real(wp), intent(out) :: own(n), vectors(n, n)
    real(wp) :: values(n)
    integer :: k

    if (n > largest_own) then
      block
        real(wp) :: work(1 + 6 * n + 2 * n**2)
        integer :: iwork(3 + 5 * n), info
        vectors = y
        call dsyevd('V', 'U', n, vectors, n, values, work, size(work), iwork, size(iwork), info)
      end block
    else
      call diagonalise(n, y, values, vectors)
    end if
    call to_orthogonal(n, vectors)
    do k = 1, n
      own(k) = spectrum(1 + count(values(:k - 1) <= values(k)) + count(values(k + 1:) < values(k)))
    end do
  end subroutine decompose

  ! Eigenvalues and eigenvectors by cyclic Jacobi rotations, until all entries off the diagonal are
  ! rounding
  subroutine diagonalise(n, matrix, values, vectors)
    integer, intent(in) :: n
    real(wp), intent(in) :: matrix(n, n)
    real(wp), intent(out) :: values(n)           ! relative to the largest entry
    real(wp), intent(out) :: vectors(n, n)       ! columns
    real(wp) :: a(n, n), column(n), largest, cosine, sine, tangent
    integer :: i, p, q, sweep
    logical :: done

    vectors = 0.0_wp
    do i = 1, n
      vectors(i, i) = 1.0_wp
    end do
    largest = maxval(abs(matrix))
    a = 0.0_wp
    if (largest > 0) a = matrix / largest
    do sweep = 1, max_sweeps
      done = .true.
      do q = 2, n
        do p = 1, q - 1
          if (abs(a(p, q)) <= epsilon(largest) / 16) cycle
          done = .false.
          tangent = (a(q, q) - a(p, p)) / (2 * a(p, q))
          tangent = sign(1 / (abs(tangent) + sqrt(tangent**2 + 1)), tangent)
          cosine = 1 / sqrt(tangent**2 + 1)
          sine = tangent * cosine
          column = a(:, p)
          a(:, p) = cosine * column - sine * a(:, q)
          a(:, q) = sine * column + cosine * a(:, q)
          column = a(p, :)
          a(p, :) = cosine * column - sine * a(q, :)
          a(q, :) = sine * column + cosine * a(q, :)
          column = vectors(:, p)
          vectors(:, p) = cosine * column - sine * vectors(:, q)
          vectors(:, q) = sine * column + cosine * vectors(:, q)
        end do
      end do
      if (done) exit
    end do
    values = [(a(i, i), i=1, n)]
  end subroutine diagonalise

end module isospectral_m
