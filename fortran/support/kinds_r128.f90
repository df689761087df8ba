! The kind of all real numbers of a target.
! Each target compiles one of kinds_r64.f90 and kinds_r128.f90; all other sources are shared.
module kinds
  use, intrinsic :: iso_fortran_env, only: real128
  implicit none
  private
  integer, parameter, public :: wp = real128
end module kinds
