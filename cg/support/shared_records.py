"""Records that Python and the compiled core share: names and kinds of entries."""

import ctypes
from typing import Any

RUN = {
    # all members
    "members": "integer",
    "lanes": "integer",  # members integrated at the same time
    "common": "flag",  # whether all members take the same steps
    "of_time": "flag",  # whether the right-hand side doesn't depend on the point
    "keep_last": "flag",  # whether the interpolant of the last step may be requested
    "goes_on": "flag",  # whether members may go on after terminal events
    "unique_flows": "flag",  # whether small coefficients determine the end of their flow
    "jacobian": "integer",  # a `JacobianKind`, of f
    "t0": "real",
    "segments": "integer",
    "stops": "address",  # ends of segments
    "limited": "integer",  # number of rows of `limits`
    "limits": "address",  # rows (t, limit): a step from t on is at most `limit` long
    # functions
    "context": "address",  # the `Callbacks`
    "function": "address",  # the right-hand side
    "vectorized": "flag",  # whether `function` takes many points, through the context
    "data": "address",
    "data_stride": "integer",  # bytes from one member's data to the next
    "curves": "integer",  # inputs of compiled functions
    "inputs": "address",  # `INPUT`
    "event_functions": "integer",  # number of functions whose zeros are events
    "event_width": "integer",  # numbers of a point that events depend on
    "event_table": "address",  # `EVENT`
    "observer": "address",  # `OBSERVER`, of what is evaluated at output times, or 0
    # steps
    "h": "real",  # size of equal steps, zero for adaptive ones
    "rtol": "real",  # the smallest relative tolerance
    "atol": "real",
    "tolerances": "address",  # rows rtol and atol of each coordinate or entry, 0 if all are alike
    "in_coordinates": "flag",  # whether differences of points are in coordinates, not in entries
    "reals_per_entry": "integer",  # doubles of an entry of points, two if they are complex
    "exponent": "real",  # power of an error that sizes are proportional to
    "max_step": "real",
    "first_step": "real",  # zero to choose it
    "max_steps": "integer",
    "step_function": "address",  # `OBSERVER`, of how steps vary, or 0
    # the heat bath of a splitting method, see fortran/steps/heat_bath.f90
    "heated": "flag",  # whether there is one
    "friction": "real",
    "temperature": "real",
    "seed": "integer",
    "first_member": "integer",  # number in the ensemble of the first member of this run
    # the inertia of each member, if it has its own
    "constants_per_member": "integer",  # constants of a member
    "bodies": "address",  # C integers, columns of the inertia of each body
    "body_constants": "address",
    "state_size": "integer",  # bytes of the saved state of a member, which opening the run sets
    "budget": "integer",  # steps that a call may try; when it returns, those that are left
    # output of each call
    "ended": "integer",  # trajectories that have ended
    "failed": "integer",  # trajectories that reached neither the final time nor a terminal event
    "raised": "flag",  # whether a function failed: by an exception, or an invalid number
    "step_size": "real",  # signed, of the first lane that no terminal event has ended
    "distance": "real",  # a bound of the distances of final points from the manifold, huge if none
    "residual": "real",  # residual of the stage equations in the last iteration of the first lane
    "dropped": "real",  # largest relative part of a derivative that no field has, and its time
    "dropped_at": "real",
    # one entry for each member
    "states": "address",  # points, at first the initial ones, then `STATE`
    "counters": "address",  # `COUNTERS`
    # points at output times
    "outputs": "integer",
    "times": "address",
    "y": "address",  # 0 to store no points
    "observed": "address",
    # ends of steps
    "every": "integer",  # each step whose number is a multiple, and the last one; 0 for none
    "keeps_points": "flag",  # whether their points are stored
    "dense": "flag",  # whether the interpolants of all steps are stored
    # numbers of rows that a call has stored, see fortran/steps/output.f90
    "steps": "integer",
    "interpolants": "integer",
    "events": "integer",
}
"""What the compiled loop over steps reads and writes."""

METHOD = {
    "kind": "integer",  # a `StepKind`
    # numbers of paths, of their flows, of terms of these, and of stages
    "paths": "integer",
    "flows": "integer",
    "terms": "integer",
    "stages": "integer",
    # arrays of doubles; the first five hold integers that count from 1
    "origin": "address",  # (paths) the path to the start of each, 0 for the start of the step
    "path_first": "address",  # (paths + 1) the first flow of each
    "flow_first": "address",  # (flows + 1) the first term of each
    "flow_stage": "address",  # (terms)
    "stage_path": "address",  # (stages) the path to each, 0 for the start
    "weight": "address",  # (terms)
    "c": "address",  # (stages)
    "registers": "address",  # A and B of a method of two registers
    "error": "address",  # (stages, errors) weights
    "transformation": "address",  # the numbers of transformation_t, of a collocation method
    "drifts": "address",  # (flows) of a splitting method, whose flows are kicks before them
    "errors": "integer",
    "brackets": "address",  # (stages + brackets, 2, brackets) weights of their sides
    "bracket_count": "integer",
    # the paths to the results, 0 where there is none, and the stage at the end of the step
    "result": "integer",
    "embedded": "integer",
    "third": "integer",
    "final_stage": "integer",
    "series": "integer",  # order up to which the series of dexp⁻¹ is needed, 0 for none
    "kept_nodes": "integer",  # coefficients of the step before that error estimates use
    "estimate": "integer",  # an `EstimateForm`
    "power": "integer",  # exponent of the quotient of two error estimates
    "factor": "real",  # factor of the second estimate in that quotient
    "blocks": "integer",  # groups of stages that an implicit method solves together
    # interpolants, see scheme_t: sizes of the arrays, which are rows of those in Fortran
    "further": "integer",
    "derivatives": "integer",
    "degree": "integer",
    "nodes": "integer",
    "result_stages": "integer",
    "result_flows": "integer",
    "final": "integer",
    "output_series": "integer",
    "theta": "address",
    "rows": "address",
    "basis": "address",
    "node": "address",
    "blend": "address",
    "flow_c": "address",
    "flow_weights": "address",
}
"""A method as paths of flows."""

COUNTERS = {
    "status": "integer",  # a `LoopStatus`
    "detail": "integer",  # what a compiled function returned, or what a failure was due to
    "nfev": "integer",
    "nexp": "integer",  # flows
    "njev": "integer",
    "nlu": "integer",
    "steps": "integer",
    "nrejected": "integer",
}
"""What is counted of a member."""

STATE = ("reached", "failed_at", "last_start", "next_step")
"""Numbers of a member after its point."""

COUNTS = tuple(COUNTERS)[2:]
"""Counts of each member in results, in the order of compiled code."""

EVENT = {
    "function": "address",  # in C, 0 for one in Python
    "data": "address",  # 0 for that of the member, -1 for none
    "direction": "integer",  # sign of the slope at an event, 0 for any
    "limit": "integer",  # the event of this number ends the trajectory
    "jumps": "integer",  # whether the solution jumps
    "period": "real",  # its multiples are zeros too; 0 without one
    "vectorized": "integer",  # whether the function takes many members at a time
}
"""A function whose zeros are events."""

INPUT = {
    "powers": "integer",
    "pieces": "integer",
    "width": "integer",
    "offset": "integer",  # numbers in the data of a member before the values
    "starts": "address",  # first times of the pieces
    "coefficients": "address",  # (powers, pieces, width)
    "stride": "integer",  # bytes from the coefficients of one member to those of the next
}
"""A curve whose values are written into the data of compiled functions."""

OBSERVER = {
    "count": "integer",  # numbers at a time
    "functions": "integer",  # functions in C, 0 for one in Python
    "table": "address",  # `EVENT`, of those in C
    "function": "address",  # the function in Python
    "data": "address",
    "stride": "integer",  # bytes from one member's data to the next
}
"""A function along the solution."""

VARIATION = {
    # functions in C (0: use differences) and their data (0: use the data of the members)
    "f": "address",
    "f_data": "address",
    "jac": "address",
    "jac_data": "address",
    "df_dp": "address",
    "df_dp_data": "address",
    "noise": "address",  # spectral density; without a function its data are the matrix
    "noise_data": "address",
    "along": "address",  # differences along directions, at a point with its derivatives
    "along_data": "address",
    "data": "address",  # data for functions without data of their own, if there are no parameters
    "frame": "address",  # the plan of the frame alone
    "dimension": "integer",
    "width": "integer",  # doubles of a point without its derivatives
    "parameters": "integer",  # numbers with respect to which there are derivatives
    "inputs": "integer",  # numbers after the parameters, or the last of these
    "noises": "integer",  # columns of the covariance of noise, 0 or `dimension`
    # chosen directions of derivatives, 0 for all, and their parts by parameters, a row each
    "directions": "integer",
    "by_parameters": "address",
    # structure constants that aren't zero: i, j, k and the coefficient along E_k of [E_i, E_j]
    "constants": "integer",
    "index": "address",
    "constant": "address",
    "step": "real",  # step of differences, relative
    "forces_alone": "flag",  # whether forces alone make coefficients, of a splitting method
    "one_sided": "flag",  # whether forward differences in place of central ones
    "scales": "address",  # least sizes of parameters for differences, those of inputs if not zero
    "failed_function": "integer",  # the last one, a `FailedFunction`
}
"""A right-hand side with derivatives."""

RECORDS = {
    "record_t": RUN,
    "method_record_t": METHOD,
    "counters_t": COUNTERS,
    "event_record_t": EVENT,
    "input_record_t": INPUT,
    "observer_record_t": OBSERVER,
    "variation_t": VARIATION,
}
"""The records by the names of their Fortran types."""

_KINDS: dict[str, tuple[Any, str]] = {
    "integer": (ctypes.c_int64, "integer(c_int64_t)"),
    "flag": (ctypes.c_bool, "logical(c_bool)"),
    "real": (ctypes.c_double, "real(c_double)"),
    "address": (ctypes.c_void_p, "integer(c_intptr_t)"),
}


def fields_of(entries: dict[str, str]) -> list[tuple[str, Any]]:
    """Return the entries of a record as fields of ctypes."""
    return [(name, _KINDS[kind][0]) for name, kind in entries.items()]


def columns_of(entries: dict[str, str]) -> list[tuple[str, str]]:
    """Return the entries of a record as fields of a type of NumPy."""
    return [(name, "f8" if kind == "real" else "i8") for name, kind in entries.items()]


def record_type(name: str, entries: dict[str, str]) -> list[str]:
    """Return the Fortran type of a record."""
    lines = [f"  type, bind(c) :: {name}"]
    for entry, kind in entries.items():
        zero = {"real": "0.0_c_double", "flag": ".false."}.get(kind, "0")
        lines.append(f"    {_KINDS[kind][1]} :: {entry} = {zero}")
    return [*lines, f"  end type {name}"]
