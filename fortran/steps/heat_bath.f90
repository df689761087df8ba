! A heat bath: friction and noise of momenta, by Langevin's equation (cg/integration/heat_bath.py),
! solved exactly in the middle of a step of a symmetric splitting method. The noise is a function of
! the seed, the member and the time of the step, so that neither the order of members nor an
! interruption changes it.
module heat_bath_m
  use kinds, only: wp
  use, intrinsic :: iso_c_binding, only: c_double, c_int64_t
  use, intrinsic :: iso_fortran_env, only: int64
  use frames_m, only: frame_t
  use free_motion_m, only: make_tangential
  use shared_numbers, only: record_t
  implicit none
  private
  public :: exchange_heat

  interface
    ! Four normal variates for a key and a counter
    subroutine normal_variates(key, counter, x) bind(c)
      import :: c_double, c_int64_t
      integer(c_int64_t), intent(in) :: key(2), counter(2)
      real(c_double), intent(out) :: x(4)
    end subroutine normal_variates
  end interface

contains

  ! Replaces momenta by e^(-gamma t) p + (T (1 - e^(-2 gamma t)) J)^(1/2) xi, xi normal.
  subroutine exchange_heat(record, frame, member, t, time, y)
    type(record_t), intent(in) :: record     ! record of the run, with gamma and k_B T of the bath
    type(frame_t), intent(in) :: frame
    integer, intent(in) :: member            ! number in the run, from 1
    real(wp), intent(in) :: t, time          ! t: of the step; time: how long heat is exchanged
    real(wp), intent(inout) :: y(frame%point_size)
    real(wp) :: noise(frame%forces + 3), decay, deviation
    integer(int64) :: tick                   ! the noise is a function of it
    integer :: i, k

    ! the time in units of h / 2^20, by which times that differ by rounding are equal
    tick = nint(modulo(t / record%h * 2.0_wp**20, 2.0_wp**62), int64)
    do k = 1, frame%forces, 4
      call normal_variates([record%seed, record%first_member + int(member - 1, int64)], &
                           [tick, int(k / 4, int64)], noise(k:k + 3))
    end do
    decay = exp(-record%friction * time)
    deviation = sqrt(record%temperature * (1 - decay) * (1 + decay))
    k = frame%momenta_offset
    do i = 1, size(frame%bodies)
      associate (root => frame%bodies(i)%root, xi => noise(frame%blocks(i)%v1:frame%blocks(i)%v2), &
                 momentum => y(k + frame%blocks(i)%v1:k + frame%blocks(i)%v2))
        if (size(root, 2) == 1) then
          momentum = decay * momentum + deviation * root(:, 1) * xi
        else
          momentum = decay * momentum + deviation * matmul(root, xi)
        end if
      end associate
    end do
    call make_tangential(frame, y(:k), y(k + 1:))
  end subroutine exchange_heat

end module heat_bath_m
