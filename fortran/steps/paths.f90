! The ends of the paths of method_t: y_path = exp(h sum_k weight_k f_stage(k)) ... y_origin, by flows
! of the frame. On a path the flow of the lowest stage comes first. How a path is followed depends on
! the kind of the method.
module paths_m
  use kinds, only: wp
  use algebra_m, only: bracket
  use blocks_m, only: combine_flows
  use frames_m, only: apply_flows, restore
  use free_motion_m, only: move_by_kicks
  use heat_bath_m, only: exchange_heat
  use method_m, only: kind_algebra, kind_collocation, kind_polynomial, kind_splitting, middle_path
  use rattle_m, only: move_with_joints
  use shared_numbers, only: finished
  use trajectory_m, only: trajectory_t
  use vectors_m, only: copy
  use iso_fortran_env, only: int64
  implicit none
  private
  public :: add_brackets, combine_coordinates, follow_paths

contains

  ! Computes the ends of all paths up to one. Rounding off the manifold is removed from results only,
  ! since it doesn't accumulate in stages.
  subroutine follow_paths(x, last)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: last
    integer :: i, begin, end

    do i = x%paths + 1, last
      if (x%problem%of_time .and. .not. x%method%leads(i)) cycle
      begin = x%method%path_first(i)
      end = x%method%path_first(i + 1)
      call copy(x%frame%point_size, x%y(:, x%method%origin(i)), x%y(:, i))
      select case (x%method%kind)
      case (kind_algebra, kind_collocation)
        call combine_coordinates(x, i)
        call apply_flows(x%frame, 1, x%u, x%y(:, i))
      case (kind_splitting)
        if (x%frame%jointed) then
          call move_with_joints(x, i, x%y(:, i))
          if (x%status /= finished) return
          cycle
        end if
        if (x%problem%bath%present .and. i == middle_path(x%method)) then
          call exchange_within(x, i)
        else
          call move_by_kicks(x%frame, x%method%flows, x%weight, x%h * x%method%drift, begin, &
                             end - 1, x%f, x%y(:, i))
        end if
      case (kind_polynomial)
        call combine_flows(x%method%flows, x%weight, begin, end - 1, x%frame%dimension, x%f, x%v)
        x%frame%blocks%action%granted = abs(x%h) / max(abs(x%h), x%problem%duration)
        call apply_flows(x%frame, end - begin, x%v, x%y(:, i))
        x%frame%blocks%action%granted = 0.0_wp
        end = begin + 1                      ! they are one flow
      case default
        call combine_flows(x%method%flows, x%weight, begin, end - 1, x%frame%dimension, x%f, x%v)
        call apply_flows(x%frame, end - begin, x%v, x%y(:, i))
      end select
      if (i == x%method%result .or. i == x%method%embedded) call restore(x%frame, x%y(:, i))
      x%counts%nexp = x%counts%nexp + int(end - begin, int64)
    end do
    x%paths = max(x%paths, last)
  end subroutine follow_paths

  ! Follows the path with the middle of a step of a splitting method, and exchanges heat in the middle
  ! of its drift, or of its kick if a kick is in the middle of the step.
  subroutine exchange_within(x, path)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path
    real(wp) :: kicked, moved                ! parts before the middle

    associate (y => x%y(:, path))
      kicked = merge(1.0_wp, 0.5_wp, modulo(size(x%method%c), 2) == 0)
      moved = kicked - 0.5_wp
      call move_by_kicks(x%frame, x%method%flows, kicked * x%weight, moved * x%h * x%method%drift, &
                         path, path, x%f, y)
      call exchange_heat(x%problem%bath, x%frame, x%member, x%t, x%h, y)
      call move_by_kicks(x%frame, x%method%flows, (1 - kicked) * x%weight, &
                         (1 - moved) * x%h * x%method%drift, path, path, x%f, y)
    end associate
  end subroutine exchange_within

  ! Computes the coordinates of the end of a path that has one flow.
  subroutine combine_coordinates(x, path)
    type(trajectory_t), intent(inout) :: x
    integer, intent(in) :: path

    x%path_of_u = path
    associate (flow => x%method%path_first(path))
      call combine_flows(x%method%flows, x%weight, flow, flow, size(x%u), x%f, x%u)
    end associate
  end subroutine combine_coordinates

  ! Computes the brackets of the fields at the stages, times the step size.
  subroutine add_brackets(x)
    type(trajectory_t), intent(inout) :: x
    real(wp), dimension(x%frame%dimension) :: u, v
    integer :: j, k

    do j = 1, size(x%method%bracket, 3)
      u = 0.0_wp
      v = 0.0_wp
      do k = 1, size(x%method%c) + j - 1
        u = u + (x%h * x%method%bracket(k, 1, j)) * x%f(:, k)
        v = v + x%method%bracket(k, 2, j) * x%f(:, k)
      end do
      call bracket(x%frame, u, v, x%f(:, size(x%method%c) + j))
    end do
  end subroutine add_brackets

end module paths_m
