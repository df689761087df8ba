"""Numbers that Python and the compiled core share.

The build runs this file to write the Fortran module ``shared_numbers``, in which a member of an
enumeration has its own name in lower case, followed by the suffix of the enumeration.
"""

import argparse
from enum import IntEnum
from pathlib import Path

if __package__:
    from cg.support.shared_records import RECORDS, STATE, record_type
else:  # run by the build, beside shared_records.py
    from shared_records import RECORDS, STATE, record_type  # type: ignore[import-not-found,no-redef]


class LoopStatus(IntEnum):
    """Why the compiled loop over steps returned."""

    NO_STOP = 0  # the loop goes on; as the result of a procedure: success
    STOPPED_BY_RHS = 1  # the right-hand side returned a nonzero flag
    RHS_NOT_FINITE = 2
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
    RESTING_CONTACT = 15  # a jump leaves the event's function at zero, and f doesn't move it off
    TIME_NOT_FINITE = 16  # a step without end leads beyond the range of numbers
    STEP_TOO_LONG_FOR_EVENTS = 17  # the step rotates by too many turns
    JOINTS_NOT_SOLVED = 18  # there are no forces of joints that keep them closed
    FINISHED = 19  # at the end of the integration
    # requests of a trajectory
    NEEDS_RHS = 20  # the coefficients at the requested time and point
    NEEDS_EVENTS = 24  # values of events at the requested times and points
    NEEDS_MAXIMUM = 22  # largest error, or negative step size, of trajectories with common steps


class RhsFlag(IntEnum):
    """A return value of right-hand sides that is reserved."""

    RAISED_IN_PYTHON = -(2**31) + 1
    OBSERVER_FAILED = -(2**31) + 2  # not f, but what is evaluated at output times
    STEP_FUNCTION_FAILED = -(2**31) + 3  # the function of step sizes


class StepKind(IntEnum):
    """How a method takes a step in compiled code: its `Kind`, or a special case of it."""

    GROUP = 1
    ALGEBRA = 2
    IMPLICIT = 3
    COLLOCATION = 4
    LINEAR = 5
    SPLITTING = 6
    REGISTERS = 7  # explicit stages by flows, of two registers
    POLYNOMIAL = 8  # a linear equation, whose flows are one along a polynomial


class EstimateForm(IntEnum):
    """What the error estimate of a method is made of.

    Let d1 and d2 be the differences of the result from the second and the third one, s_k the sums
    h Σ_i error_ki f_i, c_k the same sums of values of ``f`` before dexp⁻¹, all as tangents at the
    end of the step, and |.| their norms in tolerances. A quotient of two of them is

        Q(e1, e2) = |e1| (|e1| / hypot(|e1|, factor |e2|))^power, and Q(e1) = |e1|.

    DOP853 has the factor 1/10 and the power 1. With `kink_weights` the larger one of s1 and the sum
    after it takes the place of s1. Two quotients are those of the quadratures, where values of f
    commute, and of the commutators: the larger one counts, for Magnus methods their sum.
    """

    WHOLE = 0  # Q(d1) or Q(s1, s2)
    AT_END = 1  # the larger one of |d1| and factor |s1|, or factor |s1|² / hypot(|s1|, |s2|)
    PARTS_OF_RESULTS = 2  # Q(s1, s2) and Q(d1 - s1, d2 - s2)
    PARTS_OF_SUMS = 3  # Q(s1, s3) of stages and Q(s2, s4) of brackets
    PARTS_OF_SERIES = 4  # Q(c1, c2) and Q(s1 - c1, s2 - c2)


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
    U = 9  # complex matrices of any size and determinant, row by row
    ISOSPECTRAL = 10  # symmetric matrices with given eigenvalues, moved by SO(n)
    LINEAR_ACTION = 12  # vectors on which sparse matrices act
    STIEFEL = 13  # orthonormal columns, with fields for derivatives of them
    CALLBACK = 11  # any manifold, by functions outside of compiled code


class Operation(IntEnum):
    """Callbacks from compiled code to Python; see ``cg/integration/plan/callbacks.py``."""

    FLOW = 1  # move a point along flows, the first one first
    COORDINATES = 3  # coefficients of the flow from one point to another
    NEARBY = 4  # coefficients of a flow to a near point, by Gauss-Newton
    NEAREST = 15  # as NEARBY; where that fails, of the nearest tangent
    SIZES = 5  # magnitudes that relative errors refer to
    TANGENT = 6  # the value of a field
    WITHOUT_ISOTROPY = 7  # coefficients without what leaves the point fixed
    DEXPINV = 8
    RHS = 9  # coefficients at points of several members
    EVENT = 10
    EVENTS = 18  # values of an event at points of several members
    JUMP = 11
    JACOBIAN = 12  # derivatives of f, for Newton's method
    FACTOR = 13  # the matrices of Newton's method, if they are sparse
    SOLVE = 14  # a linear system with one of them
    BRACKET = 2  # bracket of two fields
    COEFFICIENTS = 16  # those of a derivative, and the length of the part that no field has
    CONSTRAINTS = 17  # values of the user's, and derivatives; see ``cg/frames/joints.py``
    RESIDUAL = 19  # the function that lmdif minimises


class RowForm(IntEnum):
    """The two vectors whose dot product is a row of a joint.

    They are two of these three: the axis of the first body, that of the second one, and the vector
    from the point of the second body to that of the first one.
    """

    ALONG_SPACE = 1  # an axis of space and the vector between points
    ALONG_BODY = 2  # the axis of the first body and the vector between points
    BETWEEN_AXES = 3  # their cosine
    COINCIDENT_AXES = 4  # the same, in three rows for axes that coincide
    FIXED_LENGTH = 5  # the vector between points and itself, less the square of a length


class BlockOption(IntEnum):
    """Options of a block, which add up."""

    SPACE_AXES = 1  # v acts from the left, not in body axes
    SCALAR_FIRST = 2  # order of a quaternion's entries
    POLYNOMIAL = 4  # the flows of a path are the coefficients of a polynomial in time


class StageLimit(IntEnum):
    """The largest number of iterations for the stages of an implicit method."""

    NEWTON = 25
    FIXED_POINT = 100


class JacobianKind(IntEnum):
    """The Jacobian for Newton's method on implicit stages."""

    DIFFERENCES = 0
    MATRIX = 1  # evaluated in Python
    OUTSIDE = 2  # no matrix in compiled code: Python factors it, or stages are fixed points


class Stored(IntEnum):
    """What a call of compiled code stores in rows."""

    STEPS = 0
    INTERPOLANTS = 1
    EVENTS = 2


class FailedFunction(IntEnum):
    """The function of a right-hand side with derivatives that failed last."""

    F = 0
    JAC = 1
    DF_DP = 2
    PRODUCTS = 3  # products of what the functions returned
    NOISE = 4


class LmdifStatus(IntEnum):
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
        return LmdifStatus.SMALL_REDUCTION <= self <= LmdifStatus.SMALL_GRADIENT

    @property
    def message(self) -> str:
        """The status as a sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    LmdifStatus.STOPPED_BY_USER: "The function stopped the solver.",
    LmdifStatus.IMPROPER_INPUT: "The solver refused its arguments.",
    LmdifStatus.SMALL_REDUCTION: (
        "The actual and the predicted relative reduction of the sum of squares are at most ftol."
    ),
    LmdifStatus.SMALL_STEP: "The relative change between two iterates is at most xtol.",
    LmdifStatus.SMALL_REDUCTION_AND_STEP: (
        "The relative reductions of the sum of squares are at most ftol, "
        "and the relative change between two iterates is at most xtol."
    ),
    LmdifStatus.SMALL_GRADIENT: (
        "The cosines between the residual and the columns of the Jacobian are at most gtol."
    ),
    LmdifStatus.TOO_MANY_EVALUATIONS: "The number of evaluations has reached maxfev.",
    LmdifStatus.FTOL_TOO_SMALL: "ftol is too small: the sum of squares can't be reduced further.",
    LmdifStatus.XTOL_TOO_SMALL: "xtol is too small: the iterate can't be improved further.",
    LmdifStatus.GTOL_TOO_SMALL: (
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


InterpolantColumn = IntEnum("InterpolantColumn", "MEMBER START SIZE END ON_ALGEBRA", start=0)
"""Numbers of a stored interpolant, before points and vectors; an event may end a step early."""
EventColumn = IntEnum("EventColumn", "MEMBER NUMBER TIME", start=0)
"""Numbers of a stored event, before the points before and after it."""

STEP_CONTROL: dict[str, float | int] = {
    "safety": 0.9,
    "min_factor": 0.2,
    "max_factor": 5.0,
    "failure_factor": 0.25,  # where there is no estimate
    # powers of the last error and of the one before it, times the exponent
    "last_power": 0.7,
    "before_last_power": 0.4,
    "min_last_error": 1e-4,
    "first_error": 0.01,  # target of the error of the first step, in tolerances
    # The first guess is a fraction of the time in which the point changes by its size, or of the
    # span if a norm is below this many tolerances. The first size is at most `max_growth` guesses.
    "guess_fraction": 0.01,
    "blind_fraction": 1e-6,
    "negligible": 1e-5,
    "max_growth": 100.0,
    "min_step": 10.0,  # in spacings of numbers at the time
    # At a discontinuity many steps are rejected, since estimates decrease slowly there. A rejection
    # raises the suspicion of one, and an accepted step lowers it by 1. Above `min_suspicion`
    # errors count as many times as estimates at a jump can be too small.
    "raised_by_rejection": 4,
    "min_suspicion": 4,
    "max_suspicion": 12,
    "jump_factor": 20.0,
    # In place of a first step: the size that was proposed, where points alone may have changed, and
    # where the right-hand side has.
    "proposed_for_point": -1.0,
    "proposed_for_f": -2.0,
}
"""Numbers of ``fortran/steps/controller.f90``, which solvers in JAX use too."""

ERROR_ESTIMATE: dict[str, float | int] = {
    # Unit of changes of the angle of a step by Magnus methods, in the rest of the second estimate.
    # Along 2,000 random curves through samples on quaternions it leaves angles wrong by 75
    # tolerances of 1e-10 in place of 770, for 2 per cent more evaluations.
    "unit_of_change": 6.0,
    # parts of the variation that both estimates are if the phase changes by about a radian
    "resolved_first": 2e-3,
    "resolved_second": 0.1,
    "roundings": 64.0,  # rounding errors of differences between nodes
    "max_angle": 20.0,  # radians in a step, up to which estimates were compared with errors
}
"""Numbers of ``fortran/steps/error_estimate.f90``, which solvers in JAX use too."""

PARTS_OF_TURN = 12
"""Least number of comparisons of an event's signs while a step turns by 2π."""
MAX_OWN_ROWS = 12
"""Largest number of rows of matrices that compiled code multiplies without BLAS."""
COMMUTING_ROUNDINGS = 1024.0  # a bracket of less rounding errors of its factors counts as zero
# beyond this ratio of their lengths, changes of point and parameters have differences of their own:
# in one of both the shorter change would have few digits
MAX_LENGTH_RATIO = 1000.0

_SUFFIXES = {
    LoopStatus: "",
    RhsFlag: "",
    StepKind: "_kind",
    EstimateForm: "_estimate",
    BlockKind: "_block",
    BlockOption: "_option",
    Operation: "_operation",
    RowForm: "",
    StageLimit: "_limit",
    JacobianKind: "_jacobian",
    Stored: "_stored",
    FailedFunction: "_failed",
    LmdifStatus: "",
    MinimumNormStatus: "",
    ConditionOwner: "",
    StageEquation: "_abscissa",
}


def fortran_module() -> str:
    """Return the Fortran module with all members as parameters."""
    lines = [
        "! Made from cg/support/shared_numbers.py",
        "module shared_numbers",
        "  use, intrinsic :: iso_c_binding, only: c_bool, c_double, c_int64_t, c_intptr_t",
        "  implicit none",
        "  public",
    ]
    for enumeration, suffix in _SUFFIXES.items():
        for member in enumeration:
            name = member.name.lower() + suffix
            lines.append(f"  integer, parameter :: {name} = {member.value}")
    lines.append(f"  integer, parameter :: state_columns = {len(STATE)}")
    for prefix, columns in {"interpolant": InterpolantColumn, "event": EventColumn}.items():
        lines.append(f"  integer, parameter :: {prefix}_columns = {len(columns)}")
        for column in columns:
            lines.append(f"  integer, parameter :: {prefix}_{column.name.lower()} = {column + 1}")
    others: dict[str, float] = {"parts_of_turn": PARTS_OF_TURN, "max_own_rows": MAX_OWN_ROWS}
    others |= {"commuting_roundings": COMMUTING_ROUNDINGS, "max_length_ratio": MAX_LENGTH_RATIO}
    for name, number in {**STEP_CONTROL, **ERROR_ESTIMATE, **others}.items():
        real = isinstance(number, float)
        kind, value = ("real(c_double)", f"{number}_c_double") if real else ("integer", number)
        lines.append(f"  {kind}, parameter :: {name} = {value}")
    for name, entries in RECORDS.items():
        lines += record_type(name, entries)
    return "\n".join([*lines, "end module shared_numbers", ""])


def c_header() -> str:
    """Return the C header with the numbers that C uses."""
    members = ", ".join(f"{flag.name} = {flag.value}" for flag in RhsFlag)
    return f"/* Made from cg/support/shared_numbers.py */\nenum {{ {members} }};\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("module", type=Path, help="the Fortran module to write")
    parser.add_argument("header", type=Path, help="the C header to write")
    files = parser.parse_args()
    files.module.write_text(fortran_module(), encoding="utf-8")
    files.header.write_text(c_header(), encoding="utf-8")
