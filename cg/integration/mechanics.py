"""Arguments for mechanical systems: thermostats, step functions, inertia of members, friction.

Splitting methods refuse friction. `refuse_friction` recognises it by forces that differ for two
momenta at one position, at a sample of points. Its evaluations of ``f`` aren't counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import Frame
from cg.frames.inertia import compiled_bodies, read_inertia
from cg.frames.phase_space import PhaseSpace
from cg.integration.heat_bath import Langevin
from cg.integration.options import EnsembleOptions
from cg.integration.plan.plan import Plan, plan_of
from cg.integration.rhs.compiled import compiled_event
from cg.integration.rhs.events import Observer, StepFunction
from cg.integration.rhs.inputs import WithInput
from cg.integration.rhs.python import PythonRhs, Rhs
from cg.support.arrays import Array, Points
from cg.support.checks import short
from cg.tables import Kind, MethodTable

_MAX_SAMPLE, _MIN_SAMPLE = 32, 4  # number of points at which forces are compared
_CALLS_PER_CHECK = 40  # evaluations of f by an integration for each evaluation by a comparison
_FORCES_ROUNDING = 1e-12  # relative difference of forces that should be equal
_FRACTION_OF_STEP = 0.37  # later by this much of h, also a function with period h has changed
_SIZES_ROUNDING = 1e-10  # relative difference of sizes of steps that should be equal


def refuse_friction(
    plan: Plan, rhs: Rhs, times: Sequence[float] | Array, points: Points,
    nfev: ArrayLike = _MAX_SAMPLE * 2 * _CALLS_PER_CHECK,
) -> None:  # fmt: skip
    """Raise ValueError if a force of a splitting method is friction, at a sample of points.

    Points have the shape ``(times, members, *point_shape)``. The sample is small if an integration
    took few evaluations, ``nfev`` in sum. Exceptions of ``f`` are left to the integration.
    """
    if plan.table.kind is not Kind.SPLITTING or not isinstance(plan.frame, PhaseSpace):
        return
    count = len(times) * points.shape[1]
    size = max(_MIN_SAMPLE, min(_MAX_SAMPLE, int(np.sum(nfev)) // (2 * _CALLS_PER_CHECK)))
    sample = np.linspace(0, count - 1, min(count, size)).round().astype(np.intp)  # with both ends
    k, members = np.divmod(sample, points.shape[1])
    reached = np.isfinite(points[k, members]).all(axis=-1)  # not those after an early end
    k, members = k[reached], members[reached]
    t, y = np.asarray(times)[k], points[k, members]
    try:
        forces, shifted_forces = (_forces(rhs, t, members, x) for x in (y, _shifted(plan.frame, y)))
    except Exception:
        return
    scale = np.abs(forces).max(axis=-1, keepdims=True, initial=0.0)
    differ = ~(np.abs(forces - shifted_forces) <= _FORCES_ROUNDING * scale)
    differ &= ~(np.isnan(forces) & np.isnan(shifted_forces))
    if differ.any():
        i = int(np.flatnonzero(differ.any(axis=-1))[0])
        first = rhs.extra.first_member
        in_member = "" if first is None else f" in member {first + members[i]}"
        raise ValueError(
            "f must not depend on the momentum with a splitting method, whose kicks are not "
            "symplectic then, got other forces for another momentum at t = "
            f"{t[i]:.17g}{in_member}; adaptive methods, the default among them, take friction"
        )


def _shifted(frame: PhaseSpace, y: Points) -> Points:
    """Return points with the same positions and other momenta, all of whose components differ."""
    position, momentum = frame.split(y)
    shift = np.sqrt(np.arange(2.0, 2.0 + frame.rhs_dim)) * (1.0 + np.abs(momentum))
    return frame.join(position, momentum + shift)


def _forces(rhs: Rhs, t: Array, members: NDArray[np.intp], y: Points) -> Array:
    """Return the results of ``f`` for several members, in one call if it is vectorized."""
    if isinstance(rhs, PythonRhs) and rhs.vectorized:
        return np.array(rhs.results(t.copy(), members, y.copy()))
    calls = zip(members.tolist(), t.tolist(), y, strict=True)
    return np.array([rhs.result(member, time, point) for member, time, point in calls])


def check_thermostat(
    thermostat: Any, start: float, end: float, table: MethodTable, options: EnsembleOptions
) -> None:
    """Raise TypeError or ValueError unless a thermostat fits the integration."""
    if not isinstance(thermostat, Langevin):
        raise TypeError(f"thermostat must be a cg.Langevin or None, got {short(thermostat)}")
    if end < start:
        raise ValueError(
            "thermostat must be None backward in time, where friction would drive momenta, got "
            f"{thermostat!r}"
        )
    if table.kind is not Kind.SPLITTING:
        raise ValueError(
            "method must be a splitting method with a thermostat, 'Leapfrog' or, with joints, "
            f"'RATTLE', since others have no part of a step that is noise alone, got {table!r}"
        )
    if not table.symmetric:
        raise ValueError(
            "method must be symmetric with a thermostat, whose noise is in the middle of a step, "
            f"got {table!r}"
        )
    if options["derivatives"] is not None:
        raise ValueError("thermostat must be None with derivatives, which the noise doesn't have")
    if options["dense_output"]:
        raise ValueError("dense_output must be False with a thermostat: paths aren't smooth")


class MemberInertia(NamedTuple):
    """The bodies of all members, as compiled code reads them."""

    signed_columns: NDArray[np.intc]  # (members, bodies)
    constants: Array  # (members, constants), padded
    entries: Sequence[Any]  # the inertia of each member, as the user gave it
    # whether each member is integrated alone on its own frame, as joints and derivatives need
    one_by_one: bool

    def of_members(self, members: slice) -> MemberInertia:
        """Return the bodies of some members."""
        rows = self.signed_columns[members].copy(), self.constants[members].copy()
        return MemberInertia(*rows, self.entries[members], self.one_by_one)

    def frame(self, member: int, frame: Frame) -> PhaseSpace:
        """Return the phase space of a member."""
        assert isinstance(frame, PhaseSpace)
        return PhaseSpace(
            frame.configuration, self.entries[member], gyroscopic=frame.gyroscopic,
            joints=frame.joints, constraints=frame.constraints,
        )  # fmt: skip

    def plan(self, member: int, plan: Plan) -> Plan:
        """Return the plan of the phase space of a member, for output between its steps."""
        return plan_of(self.frame(member, plan.frame), plan.table)


def read_member_inertia(
    value: Any, frame: Frame, options: EnsembleOptions, members: int
) -> MemberInertia:
    """Return the bodies of each member, in place of those of the frame, after checking them.

    With ``members`` = 1 the number of entries is the number of members.
    """
    if not isinstance(frame, PhaseSpace):
        raise ValueError(f"inertia must be None unless frame is a phase space, got {short(value)}")
    one_by_one = bool(options["derivatives"]) or frame.jointed
    if one_by_one and options["common_steps"]:
        reason = "joints" if frame.jointed else f"derivatives={options['derivatives']!r}"
        raise ValueError(f"common_steps must be False with inertia and {reason}")
    entries = value if isinstance(value, list | tuple) else list(np.atleast_1d(value))
    if not entries or members not in (1, len(entries)):
        raise ValueError(
            f"inertia must have {members} entries, one for each member, got {len(entries)}"
        )
    pairs = []
    for k, entry in enumerate(entries):
        _, bodies = read_inertia(frame.configuration, entry, f"inertia[{k}]", frame.gyroscopic)
        pairs.append(compiled_bodies(bodies))
    columns, rows = zip(*pairs, strict=True)
    constants = np.zeros((len(rows), max(map(len, rows))))
    for padded, row in zip(constants, rows, strict=True):
        padded[: len(row)] = row
    return MemberInertia(np.array(columns), constants, entries, one_by_one)


def step_function_of(
    options: EnsembleOptions, plan: Plan, rhs: Rhs, t: float, end: float, y: Points
) -> Observer | None:
    """Return the function of step sizes after checking it, None without one."""
    function = options["step_function"]
    if function is None:
        return None
    if plan.table.kind is not Kind.SPLITTING or not plan.table.symmetric:
        raise ValueError(
            "method must be a symmetric splitting method with a step_function, whose steps can be "
            f"reversed, got {plan.table!r}"
        )
    for name in ("thermostat", "derivatives", "common_steps"):
        if options[name]:
            raise ValueError(f"step_function must be None with {name}, got {short(function)}")
    if compiled_event(function) is not None:
        return StepFunction([function], plan.frame, (), True)
    if not callable(function):
        raise TypeError(
            f"step_function must be callable as step_function(t, y), got {short(function)}"
        )
    if rhs.extra.inputs is not None:
        function = WithInput(function)
    observer = StepFunction(function, plan.frame, (), True)

    def size_at(time: float, point: Points) -> Array:
        return observer.check(function(time, point.copy(), *rhs.extra.arguments(0)), time, point)

    h = options["h"]
    assert isinstance(plan.frame, PhaseSpace)
    assert h is not None
    later = t + float(np.clip(end - t, -1.0, 1.0)) * _FRACTION_OF_STEP * h
    _check_reversible(size_at, plan.frame, t, later, y)
    return observer


def _check_reversible(
    size_at: Callable[[float, Points], Array], frame: PhaseSpace, t: float, later: float, y: Points
) -> None:
    """Raise ValueError if sizes of steps depend on the momentum or the time."""
    size = size_at(t, y)
    for quantity, time, point in (("momentum", t, _shifted(frame, y)), ("time", later, y)):
        other = size_at(time, point)
        if not abs(other - size) <= _SIZES_ROUNDING * abs(size):
            raise ValueError(
                "step_function must depend on the configuration alone, or steps can't be "
                f"reversed, got {size:.17g} and for another {quantity} {other:.17g} at t = {t:.17g}"
            )
