! Stages of a method of two registers, Z_i = a_i Z_(i-1) + f_i, y_i = exp(h b_i Z_i) y_(i-1). The
! point of the last stage is the result.
module registers_m
  use frames_m, only: apply_flows, restore
  use phases_m
  use requests_m, only: request
  use trajectory_m, only: trajectory_t
  implicit none
  private
  public :: request_register, start_registers, store_register

contains

  ! Takes the coefficients at the start for those of the first stage.
  subroutine start_registers(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%slope
    x%y(:, 1) = x%y(:, 0)
    call advance(x)
  end subroutine start_registers

  ! Requests the coefficients at a stage.
  subroutine request_register(x)
    type(trajectory_t), intent(inout) :: x
    integer :: point

    point = merge(0, 1, x%problem%of_time)
    call request(x, x%t + x%problem%method%c(x%stage) * x%h, x%y(:, point), &
                 phase_stage_received, x%request%received)
  end subroutine request_register

  ! Adds the coefficients at a stage, and moves the point.
  subroutine store_register(x)
    type(trajectory_t), intent(inout) :: x

    x%f(:, 1) = x%problem%method%a(x%stage) * x%f(:, 1) + x%request%received
    call advance(x)
    x%phase = phase_next_stage
  end subroutine store_register

  ! Moves the point along h b Z.
  subroutine advance(x)
    type(trajectory_t), intent(inout) :: x

    x%u = (x%h * x%problem%method%b(x%stage)) * x%f(:, 1)
    call apply_flows(x%problem%frame, 1, x%u, x%y(:, 1))
    call restore(x%problem%frame, x%y(:, 1))
    x%counts%nexp = x%counts%nexp + 1
    x%stage = x%stage + 1
  end subroutine advance

end module registers_m
