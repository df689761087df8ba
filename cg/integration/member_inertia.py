"""Inertia of each member of an ensemble."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Frame
from cg.frames.inertia import numbers_of, read_inertia
from cg.frames.phase_space import PhaseSpace
from cg.integration.plan.plan import Plan, plan_of
from cg.support.arrays import Array
from cg.support.checks import short


class MemberInertia(NamedTuple):
    """The bodies of all members, as compiled code reads them."""

    columns: NDArray[np.intc]  # (members, bodies)
    numbers: Array  # (members, numbers), padded
    given: Sequence[Any]  # as the caller gave them
    # whether members are integrated one by one, on frames of their own: those with joints, whose
    # bodies are all of the frame's inertia, and those with derivatives
    apart: bool

    def part(self, members: slice) -> MemberInertia:
        """Return those of some members."""
        rows = self.columns[members].copy(), self.numbers[members].copy()
        return MemberInertia(*rows, self.given[members], self.apart)

    def frame(self, member: int, frame: Frame) -> PhaseSpace:
        """Return the phase space of a member."""
        assert isinstance(frame, PhaseSpace)
        return PhaseSpace(
            frame.configuration, self.given[member], gyroscopic=frame.gyroscopic,
            joints=frame.joints, constraints=frame.constraints,
        )  # fmt: skip

    def plan(self, member: int, plan: Plan) -> Plan:
        """Return the plan of the phase space of a member, for output between its steps."""
        return plan_of(self.frame(member, plan.frame), plan.method)


def read_member_inertia(value: Any, frame: Frame, options: Any, members: int) -> MemberInertia:
    """Return the bodies of each member after checking them, those of the frame aside.

    A single member takes any number of them.
    """
    if not isinstance(frame, PhaseSpace):
        raise ValueError(f"inertia must be None unless frame is a phase space, got {short(value)}")
    apart = bool(options["derivatives"]) or frame.jointed
    if apart and options["common_steps"]:
        what = "joints" if frame.jointed else f"derivatives={options['derivatives']!r}"
        raise ValueError(f"common_steps must be False with inertia and {what}")
    each = value if isinstance(value, list | tuple) else list(np.asarray(value))
    if not each or members not in (1, len(each)):
        raise ValueError(
            f"inertia must have {members} entries, one for each member, got {len(each)}"
        )
    columns, rows = [], []
    for k, own in enumerate(each):
        _, bodies = read_inertia(frame.configuration, own, f"inertia[{k}]", frame.gyroscopic)
        columns.append([body.columns for body in bodies])
        rows.append(numbers_of(bodies))
    numbers = np.zeros((len(rows), max(map(len, rows))))
    for padded, row in zip(numbers, rows, strict=True):
        padded[: len(row)] = row
    return MemberInertia(np.array(columns, dtype=np.intc), numbers, each, apart)
