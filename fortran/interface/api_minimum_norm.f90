! Interface for f2py of the minimum-norm solver, in double precision.
! The addresses of LAPACK are set once.

subroutine set_lapack(addresses)
  use, intrinsic :: iso_c_binding, only: c_intptr_t
  use vectors_m, only: set_addresses
  implicit none
  integer(c_intptr_t), intent(in) :: addresses(11)

  call set_addresses(addresses)
end subroutine set_lapack

! The caller has set the addresses of LAPACK.
subroutine fit_minimum_norm(order, l, layout, n, x0, m, trees, owner, k, moving, ftol, damping, &
                            max_iterations, accurate, stop_flag, x, f, iterations, evaluations, &
                            status)
  !f2py threadsafe
  use kinds, only: wp
  use conditions_m, only: order_conditions_t
  use minimum_norm_m, only: minimise_norm
  implicit none
  integer, intent(in) :: order, l, n, m, k, layout(l)    ! layout: see read_layout
  real(wp), intent(in) :: x0(n)         ! packed weights
  integer, intent(in) :: trees(m)       ! none of them zero
  integer, intent(in) :: owner(m)       ! zero for the first result, see order_conditions_t
  integer, intent(in) :: moving(k)      ! indices of the unknowns that may move, from 1
  real(wp), intent(in) :: ftol, damping
  integer, intent(in) :: max_iterations, accurate        ! accurate: zero or one
  integer, intent(inout), target :: stop_flag(1)  ! zero; set by another thread, never copied
  real(wp), intent(out) :: x(n), f
  integer, intent(out) :: iterations, evaluations, status
  type(order_conditions_t) :: conditions

  call conditions%set_up(order, layout, trees, owner)
  conditions%stop_flag => stop_flag(1)
  x = x0
  call minimise_norm(conditions, x, m, moving, ftol, damping, max_iterations, accurate /= 0, f, &
                     iterations, evaluations, status)
end subroutine fit_minimum_norm
