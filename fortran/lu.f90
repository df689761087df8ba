! Gaussian elimination with partial pivoting, of real and of complex matrices.
module lu_m
  use kinds, only: wp
  implicit none
  private
  public :: lu_factor, lu_solve

  interface lu_factor
    procedure :: factor_real, factor_complex
  end interface lu_factor

  interface lu_solve
    procedure :: solve_real, solve_complex
  end interface lu_solve

contains

  ! Replaces a matrix by its factors. Row k was exchanged with row pivot(k).
  pure subroutine factor_real(a, pivot, singular)
    real(wp), contiguous, intent(inout) :: a(:, :)     ! (n, n)
    integer, intent(out) :: pivot(:)                   ! (n)
    logical, intent(out) :: singular                   ! or not finite
    integer :: j, k

    singular = .false.
    do k = 1, size(a, 1)
      pivot(k) = k - 1 + maxloc(abs(a(k:, k)), dim=1)
      if (.not. (abs(a(pivot(k), k)) > 0 .and. abs(a(pivot(k), k)) <= huge(1.0_wp))) then
        singular = .true.
        return
      end if
      if (pivot(k) /= k) a([k, pivot(k)], :) = a([pivot(k), k], :)
      a(k + 1:, k) = a(k + 1:, k) / a(k, k)
      do j = k + 1, size(a, 1)
        if (abs(a(k, j)) > 0) a(k + 1:, j) = a(k + 1:, j) - a(k, j) * a(k + 1:, k)
      end do
    end do
  end subroutine factor_real

  ! The same of a complex matrix
  pure subroutine factor_complex(a, pivot, singular)
    complex(wp), contiguous, intent(inout) :: a(:, :)
    integer, intent(out) :: pivot(:)
    logical, intent(out) :: singular
    integer :: j, k

    singular = .false.
    do k = 1, size(a, 1)
      pivot(k) = k - 1 + maxloc(abs(a(k:, k)%re) + abs(a(k:, k)%im), dim=1)
      if (.not. (abs(a(pivot(k), k)) > 0 .and. abs(a(pivot(k), k)) <= huge(1.0_wp))) then
        singular = .true.
        return
      end if
      if (pivot(k) /= k) a([k, pivot(k)], :) = a([pivot(k), k], :)
      a(k + 1:, k) = a(k + 1:, k) / a(k, k)
      do j = k + 1, size(a, 1)
        if (abs(a(k, j)) > 0) a(k + 1:, j) = a(k + 1:, j) - a(k, j) * a(k + 1:, k)
      end do
    end do
  end subroutine factor_complex

  ! Solves a linear system by the factors of its matrix.
  pure subroutine solve_real(a, pivot, b)
    real(wp), contiguous, intent(in) :: a(:, :)        ! (n, n)
    integer, intent(in) :: pivot(:)                    ! (n)
    real(wp), contiguous, intent(inout) :: b(:)        ! (n)
    integer :: k

    do k = 1, size(b)
      b([k, pivot(k)]) = b([pivot(k), k])
    end do
    do k = 1, size(b)
      b(k + 1:) = b(k + 1:) - b(k) * a(k + 1:, k)
    end do
    do k = size(b), 1, -1
      b(k) = b(k) / a(k, k)
      b(:k - 1) = b(:k - 1) - b(k) * a(:k - 1, k)
    end do
  end subroutine solve_real

  ! The same of a complex system
  pure subroutine solve_complex(a, pivot, b)
    complex(wp), contiguous, intent(in) :: a(:, :)
    integer, intent(in) :: pivot(:)
    complex(wp), contiguous, intent(inout) :: b(:)
    integer :: k

    do k = 1, size(b)
      b([k, pivot(k)]) = b([pivot(k), k])
    end do
    do k = 1, size(b)
      b(k + 1:) = b(k + 1:) - b(k) * a(k + 1:, k)
    end do
    do k = size(b), 1, -1
      b(k) = b(k) / a(k, k)
      b(:k - 1) = b(:k - 1) - b(k) * a(:k - 1, k)
    end do
  end subroutine solve_complex

end module lu_m
