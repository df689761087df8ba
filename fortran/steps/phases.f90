! The phases of a trajectory. Names say what `resume` does next, or what it has received.
module phases_m
  implicit none
  public
  enum, bind(c)
    enumerator :: phase_begin_segment
    enumerator :: phase_guess_size, phase_guess_shared, phase_curvature_received, phase_size_shared
    enumerator :: phase_choose_step, phase_start_received
    enumerator :: phase_next_stage, phase_stage_received, phase_column_received
    enumerator :: phase_finish_step, phase_error_received, phase_decide_step, phase_accepted
    enumerator :: phase_request_ends, phase_interpolant_start_received, phase_end_received
    enumerator :: phase_next_node, phase_node_received
    enumerator :: phase_detect_events, phase_complete_step, phase_step_shared
    enumerator :: phase_store_output, phase_ended
  end enum
end module phases_m
