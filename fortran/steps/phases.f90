! The phases of a trajectory. Each is named after what `resume` does next, or after the
! coefficients or the shared number that it has received.
module phases_m
  implicit none
  public

  enum, bind(c)
    enumerator :: phase_begin_segment = 1, phase_guess_size, phase_guess_shared, &
                  phase_curvature_received, phase_size_shared, phase_choose_step, &
                  phase_start_received, phase_next_stage, phase_stage_received, &
                  phase_finish_step, phase_decide_step, phase_accepted, phase_request_ends, &
                  phase_end_received, phase_next_node, phase_node_received, phase_store_output, &
                  phase_column_received, phase_error_received, phase_detect_events, &
                  phase_begin_received, phase_complete_step, phase_step_shared, &
                  phase_ended
  end enum

end module phases_m
