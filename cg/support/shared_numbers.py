"""Numbers and records that Python and the compiled core share.

The build runs this file to write the Fortran module ``shared_numbers``, in which a member of an
enumeration has its own name in lower case, followed by the suffix of the enumeration.
"""

from __future__ import annotations

import argparse
from enum import IntEnum
from pathlib import Path


class Stop(IntEnum):
    """Why the compiled loop over steps returned."""

    FINISHED = 0
    STOPPED_BY_FIELD = 1  # it returned a nonzero flag
    FIELD_NOT_FINITE = 2
    STAGE_NOT_FINITE = 3  # the point at which the field was evaluated
    SOLUTION_NOT_FINITE = 4
    OUT_OF_MEMORY = 5
    PAUSED = 6  # call again to continue
    STEP_TOO_SMALL = 7
    SLOPE_NOT_FINITE = 8  # relative to the tolerances
    STEP_TOO_LONG = 9  # coordinates of a stage are beyond the radius of dexp⁻¹
    TOO_MANY_STEPS = 10
    STAGES_NOT_SOLVED = 11  # the stage equations of an implicit method
    TERMINAL_EVENT = 12
    JUMPS_WITHOUT_PROGRESS = 13
    RAISED = 14  # an exception of Python
    RESTING_CONTACT = 15  # a jump leaves its function at zero, and nothing moves it off
    # requests of a trajectory to its run
    NEEDS_FIELD = 20  # the coefficients at the requested time and point
    NEEDS_MINIMUM = 21  # of a step size over trajectories with common steps
    NEEDS_MAXIMUM = 22  # of an error over them
    BUFFER_FULL = 23  # the caller must empty the output arrays


class FieldFlag(IntEnum):
    """A return value of right-hand sides that is reserved."""

    RAISED_IN_PYTHON = -(2**31) + 1
    OBSERVER_FAILED = -(2**31) + 2  # of a run: not f, but what is evaluated at output times


class BlockKind(IntEnum):
    """The manifold of a block of a compiled frame."""

    EUCLIDEAN = 1  # R^n with the fields d/dx_i
    SO3 = 2  # rotation matrices, row by row
    QUATERNION = 3  # unit quaternions that turn by v
    SE3 = 4  # matrices of rotations of space and n translations, row by row
    SPHERE = 5  # the sphere in R^3: y' = v x y
    SU2 = 6  # complex 2 x 2 matrices, row by row
    SO = 7  # rotation matrices of any size, row by row
    SU = 8  # complex matrices of any size, row by row
    U = 9  # likewise, of any determinant
    ISOSPECTRAL = 10  # symmetric matrices with given eigenvalues, moved by SO(n)
    LINEAR_ACTION = 12  # vectors on which sparse matrices act
    STIEFEL = 13  # orthonormal columns, with fields for derivatives of them
    CALLBACK = 11  # any manifold, by functions outside of compiled code


class Operation(IntEnum):
    """Callbacks from compiled code to Python; see ``cg/integration/step/callbacks.py``."""

    FLOW = 1  # move a point along flows, the first one first
    RESTORE = 2
    COORDINATES = 3  # coefficients of the flow from one point to another
    NEARBY = 4  # the same by iteration, which every frame has
    SIZES = 5  # magnitudes that relative errors refer to
    TANGENT = 6  # the value of a field
    SHORTEST = 7  # coefficients without what leaves the point fixed
    DEXPINV = 8
    FIELDS = 9  # coefficients at points of several members
    EVENT = 10
    JUMP = 11
    JACOBIAN = 12  # of the right-hand side, for Newton's method
    FACTOR = 13  # the matrices of Newton's method, if they are sparse
    SOLVE = 14  # a linear system with one of them


class BlockOption(IntEnum):
    """Options of a block, which add up."""

    SPACE_AXES = 1  # v acts from the left, not in body axes
    SCALAR_FIRST = 2  # of a quaternion
    POLYNOMIAL = 4  # the flows of a path are the coefficients of a polynomial in time


class StageLimit(IntEnum):
    """The largest number of iterations for the stages of an implicit method."""

    NEWTON = 25
    FIXED_POINT = 100


class JacobianKind(IntEnum):
    """The Jacobian for Newton's method on implicit stages."""

    DIFFERENCES = 0
    MATRIX = 1  # evaluated in Python
    SPARSE = 2  # evaluated and factored in Python; or none, for the fixed-point iteration


class StateSize(IntEnum):
    """Numbers of a trajectory's state between steps; see ``fortran/steps/saved_state.f90``."""

    REALS = 14
    INTEGERS = 13


class Status(IntEnum):
    """MINPACK's ``info`` (Moré, Garbow, Hillstrom, User Guide for MINPACK-1, ANL-80-74, 1980)."""

    STOPPED_BY_USER = -1
    IMPROPER_INPUT = 0
    SMALL_REDUCTION = 1
    SMALL_STEP = 2
    SMALL_REDUCTION_AND_STEP = 3
    SMALL_GRADIENT = 4
    TOO_MANY_EVALUATIONS = 5
    FTOL_TOO_SMALL = 6
    XTOL_TOO_SMALL = 7
    GTOL_TOO_SMALL = 8

    @property
    def converged(self) -> bool:
        """Whether one of the requested convergence tests was met."""
        return Status.SMALL_REDUCTION <= self <= Status.SMALL_GRADIENT

    @property
    def message(self) -> str:
        """The status as a sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.STOPPED_BY_USER: "The function stopped the solver.",
    Status.IMPROPER_INPUT: "The solver refused its arguments.",
    Status.SMALL_REDUCTION: (
        "The actual and the predicted relative reduction of the sum of squares are at most ftol."
    ),
    Status.SMALL_STEP: "The relative change between two iterates is at most xtol.",
    Status.SMALL_REDUCTION_AND_STEP: (
        "The relative reductions of the sum of squares are at most ftol, "
        "and the relative change between two iterates is at most xtol."
    ),
    Status.SMALL_GRADIENT: (
        "The cosines between the residual and the columns of the Jacobian are at most gtol."
    ),
    Status.TOO_MANY_EVALUATIONS: "The number of evaluations has reached maxfev.",
    Status.FTOL_TOO_SMALL: "ftol is too small: the sum of squares can't be reduced further.",
    Status.XTOL_TOO_SMALL: "xtol is too small: the iterate can't be improved further.",
    Status.GTOL_TOO_SMALL: (
        "gtol is too small: the residual is orthogonal to the columns of the Jacobian "
        "to machine precision."
    ),
}


class MinimumNormStatus(IntEnum):
    """Why the minimum-norm solver stopped."""

    SOLVED = 1  # the sum of squares is at most ftol
    OUT_OF_ITERATIONS = 2
    NO_DESCENT = 3  # not even a tiny step reduces it
    NOT_FINITE = 4  # at the start
    STOPPED = 5  # by another thread


class ConditionOwner(IntEnum):
    """The owner of a condition; positive numbers are stages."""

    FIRST_RESULT = 0
    SECOND_RESULT = -1


class StageEquation(IntEnum):
    """Conditions on a stage that aren't given by a tree."""

    MIDDLE = -1  # its abscissa lies in the middle of its piece of the step


_SUFFIXES = {
    Stop: "",
    FieldFlag: "",
    BlockKind: "_block",
    BlockOption: "",
    Operation: "_operation",
    StageLimit: "_limit",
    JacobianKind: "_jacobian",
    StateSize: "_of_state",
    Status: "",
    MinimumNormStatus: "",
    ConditionOwner: "",
    StageEquation: "_abscissa",
}


RECORD = {
    # a run
    "members": "integer",
    "lanes": "integer",  # members integrated at the same time
    "common": "integer",  # whether all members take the same steps
    "of_time": "integer",  # whether the right-hand side doesn't depend on the point
    "keep_last": "integer",  # whether the interpolant of the last step may be requested
    "free": "integer",  # whether small coefficients determine the end of their flow
    "jacobian": "integer",  # of f, a `JacobianKind`
    "t0": "real",
    "segments": "integer",
    "stops": "address",  # ends of segments
    # functions
    "context": "address",  # the `Callbacks` of the run
    "function": "address",  # the right-hand side
    "vectorized": "integer",  # whether it takes many points, and is called through the context
    "data": "address",
    "data_stride": "integer",  # bytes from one member's data to the next
    "curves": "integer",  # inputs of compiled functions
    "inputs": "address",  # a row for each curve, see fortran/steps/inputs.f90
    "functions": "integer",  # number of events
    "event_width": "integer",  # numbers of a point that they depend on
    "event_table": "address",  # `EVENT`
    "observations": "integer",  # numbers that are evaluated at output times
    "observers": "integer",  # functions in C for them, 0 for one in Python
    "observer_table": "address",  # `EVENT`
    "observer": "address",  # the function in Python
    "observer_data": "address",
    "observer_stride": "integer",
    # steps
    "h": "real",  # size of equal steps, zero for adaptive ones
    "rtol": "real",  # the smallest one
    "tolerances": "integer",
    "rtols": "address",  # one tolerance, or one for each coordinate or entry
    "atol": "address",  # likewise
    "in_entries": "integer",
    "parts": "integer",  # of an entry: two if it is complex
    "exponent": "real",  # power of an error that sizes are proportional to
    "max_step": "real",
    "first_step": "real",  # zero to choose it
    "max_steps": "integer",
    # input of each call
    "budget": "integer",  # steps to try until the call returns
    # output of each call
    "ended": "integer",  # trajectories that have ended
    "failed": "integer",  # those that reached neither the final time nor a terminal event
    "raised": "integer",  # whether Python raised an exception
    "step_size": "real",  # signed, of the last step of a single trajectory
    "residual": "real",  # of the stage equations in the last iteration of a single trajectory
    # of each member
    "states": "address",  # its point (at first the initial one), its time, the time of a failure
    "counters": "address",  # `COUNTERS`
    # points at output times
    "outputs": "integer",
    "times": "address",
    "y": "address",  # 0 to store no points
    "observed": "address",
    # ends of steps
    "every": "integer",
    "step_capacity": "integer",
    "steps": "integer",
    "step_t": "address",
    "step_y": "address",  # 0 to store no points
    "step_observed": "address",
    # interpolants
    "dense": "integer",
    "dense_capacity": "integer",
    "interpolants": "integer",
    "dense_member": "address",
    "dense_t": "address",
    "dense_y": "address",
    "dense_field": "address",
    # events
    "event_capacity": "integer",
    "events": "integer",
    "event_of": "address",
    "event_t": "address",
    "event_y": "address",
}
"""The record shared by Python and the compiled loop over steps: names and kinds of entries."""

METHOD = {
    # numbers of paths, of their flows, of terms of these, and of stages
    "paths": "integer",
    "flows": "integer",
    "terms": "integer",
    "stages": "integer",
    # C integers from 1
    "origin": "address",  # (paths) the path to the start of each, 0 for the start of the step
    "path_first": "address",  # (paths + 1) the first flow of each
    "flow_first": "address",  # (flows + 1) the first term of each
    "flow_stage": "address",  # (terms)
    "stage_path": "address",  # (stages) the path to each, 0 for the start
    # doubles
    "weight": "address",  # (terms)
    "c": "address",  # (stages)
    "registers": "address",  # A and B of a method of two registers, else 0
    "error": "address",  # (stages, errors) weights
    "transformation": "address",  # the numbers of transformation_t, of a collocation method
    "drifts": "address",  # (flows) of a splitting method, whose flows are kicks before them, else 0
    "errors": "integer",
    # the paths to the results, 0 where there is none, and the stage at the end of the step
    "result": "integer",
    "embedded": "integer",
    "third": "integer",
    "final_stage": "integer",
    "series": "integer",  # on a Lie algebra, the order of that of dexp⁻¹, else 0
    "power": "integer",  # of the quotient of two error estimates
    "factor": "real",  # of the second one in it
    "blocks": "integer",  # of stages that an implicit method solves together
    "polynomial": "integer",  # whether the flows of a path are one along a polynomial
}
"""The record of a method as paths of flows: names and kinds of entries."""

COUNTERS = {
    "status": "integer",  # a `Stop`
    "flag": "integer",  # what a compiled function returned
    "nfev": "integer",
    "nexp": "integer",  # flows
    "njev": "integer",
    "nlu": "integer",
    "steps": "integer",
    "nrejected": "integer",
}
"""What is counted of a member: names and kinds of entries."""

EVENT = {
    "function": "address",  # in C, 0 for one in Python
    "data": "address",  # 0 for that of the member, -1 for none
    "direction": "integer",  # sign of the slope at an event, 0 for any
    "most": "integer",  # this event ends the trajectory
    "jumps": "integer",  # whether the solution jumps
}
"""A function whose zeros are events: names and kinds of entries."""

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
    "data": "address",  # of functions without data of their own, if there are no parameters
    "frame": "address",  # the plan of the frame alone
    "dimension": "integer",
    "width": "integer",  # doubles of a point without its derivatives
    "parameters": "integer",  # numbers with respect to which there are derivatives
    "inputs": "integer",  # numbers behind the parameters, or the last of these
    "moments": "integer",  # how many of the last derivatives are there a second time,
    "origin": "real",  # times the time from this one on
    "noises": "integer",  # columns of the covariance of noise, 0 or `dimension`
    # structure constants that aren't zero: i, j, k and the coefficient along E_k of [E_i, E_j]
    "constants": "integer",
    "index": "address",
    "constant": "address",
    "step": "real",  # of differences, relative
    "nan": "real",
    "failed": "integer",  # which function failed last: 0 f, 1 jac, 2 df_dp, 3 products, 4 noise
}
"""The record of a right-hand side with derivatives: names and kinds of entries."""

_KINDS = {
    "integer": "integer(c_int64_t)",
    "real": "real(c_double)",
    "address": "integer(c_intptr_t)",
}


def record_type(name: str, entries: dict[str, str]) -> list[str]:
    """Return the Fortran type of a record."""
    lines = [f"  type, bind(c) :: {name}"]
    for entry, kind in entries.items():
        zero = "0.0_c_double" if kind == "real" else "0"
        lines.append(f"    {_KINDS[kind]} :: {entry} = {zero}")
    return [*lines, f"  end type {name}"]


def fortran_module() -> str:
    """Return the Fortran module with all members as parameters."""
    lines = [
        "! Made from cg/support/shared_numbers.py",
        "module shared_numbers",
        "  use, intrinsic :: iso_c_binding, only: c_double, c_int64_t, c_intptr_t",
        "  implicit none",
        "  public",
    ]
    for enumeration, suffix in _SUFFIXES.items():
        for member in enumeration:
            name = member.name.lower() + suffix
            lines.append(f"  integer, parameter :: {name} = {member.value}")
    for name, entries in (
        ("record_t", RECORD),
        ("method_record_t", METHOD),
        ("counters_t", COUNTERS),
        ("event_record_t", EVENT),
        ("variation_t", VARIATION),
    ):
        lines += record_type(name, entries)
    return "\n".join([*lines, "end module shared_numbers", ""])


def c_header() -> str:
    """Return the C header with the numbers that C uses."""
    members = ", ".join(f"{flag.name} = {flag.value}" for flag in FieldFlag)
    return f"/* Made from cg/support/shared_numbers.py */\nenum {{ {members} }};\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("module", type=Path, help="the Fortran module to write")
    parser.add_argument("header", type=Path, help="the C header to write")
    files = parser.parse_args()
    files.module.write_text(fortran_module(), encoding="utf-8")
    files.header.write_text(c_header(), encoding="utf-8")
