! Explicit stages: each point is reached from coefficients that are known. On the Lie algebra
! coefficients become derivatives of the coordinates u of a point, y = exp(u) y_0. Methods of two
! registers have Z_i = a_i Z_(i-1) + f_i, y_i = exp(h b_i Z_i) y_(i-1), with the register Z in place
! of coefficients at stages, and y_i in place of the ends of paths; the last one is the result.
module explicit_m
  use algebra_m, only: dexpinv
  use frames_m, only: apply_flows, restore
  use method_m, only: kind_algebra, kind_registers
  use paths_m, only: combine_coordinates, follow_paths
  use phases_m
  use requests_m, only: reject_stage, request
  use trajectory_m, only: trajectory_t
  use shared_numbers, only: finished, step_too_long
  implicit none
  private
  public :: request_explicit, start_explicit, store_explicit

contains

  ! Takes the coefficients at the start for those of the first stage.
  subroutine start_explicit(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%slope
    if (x%method%kind == kind_registers) then
      x%y(:, 1) = x%y(:, 0)
      call move_along_register(x)
    end if
    x%stage = 2
  end subroutine start_explicit

  ! Moves to the point of a stage and requests the coefficients there. Functions of time need no
  ! points.
  subroutine request_explicit(x)
    type(trajectory_t), intent(inout) :: x
    integer :: path

    associate (t => x%t + x%method%c(x%stage) * x%h)
      if (x%method%kind == kind_registers) then
        path = merge(0, 1, x%problem%of_time)
        call request(x, t, x%y(:, path), phase_stage_received, x%request%received)
      else
        path = merge(0, x%method%stage_path(x%stage), x%problem%of_time)
        call follow_paths(x, path)
        if (x%status /= finished) return
        call request(x, t, x%y(:, path), phase_stage_received, x%f(:, x%stage), &
                     x%method%goes_on(path))
      end if
    end associate
  end subroutine request_explicit

  ! Stores the coefficients at a stage.
  subroutine store_explicit(x)
    type(trajectory_t), intent(inout) :: x
    logical :: exists

    if (x%method%kind == kind_registers) then
      x%f(:, 1) = x%method%a(x%stage) * x%f(:, 1) + x%request%received
      call move_along_register(x)
    else
      if (.not. associated(x%problem%field)) x%f(:, x%stage) = x%request%received
      if (x%stage == x%method%final_stage .or. &
          (x%problem%of_time .and. .not. abs(x%method%c(x%stage) - 1) > 0)) then
        x%end_slope(:) = x%f(:, x%stage)
        x%end_known = .true.
      end if
    end if
    if (x%method%kind == kind_algebra .and. x%method%stage_path(x%stage) > 0) then
      if (x%path_of_u /= x%method%stage_path(x%stage)) &
        call combine_coordinates(x, x%method%stage_path(x%stage))
      if (allocated(x%added)) x%added(:, x%stage) = x%f(:, x%stage)
      call dexpinv(x%frame, x%method%series, x%u, x%f(:, x%stage), exists)
      if (allocated(x%added)) x%added(:, x%stage) = x%f(:, x%stage) - x%added(:, x%stage)
      if (.not. exists) then
        call reject_stage(x, step_too_long, x%t)
        return
      end if
    end if
    x%stage = x%stage + 1
    x%phase = phase_next_stage
  end subroutine store_explicit

  ! Moves the point along h b Z.
  subroutine move_along_register(x)
    type(trajectory_t), intent(inout) :: x

    x%u = (x%h * x%method%b(x%stage)) * x%f(:, 1)
    call apply_flows(x%frame, 1, x%u, x%y(:, 1))
    call restore(x%frame, x%y(:, 1))
    x%counts%nexp = x%counts%nexp + 1
  end subroutine move_along_register

end module explicit_m
