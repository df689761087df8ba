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

    def part(self, members: slice) -> MemberInertia:
        """Return those of some members."""
        rows = self.columns[members].copy(), self.numbers[members].copy()
        return MemberInertia(*rows, self.given[members])

    def plan(self, member: int, plan: Plan) -> Plan:
        """Return the plan of the phase space of a member, for output between its steps."""
        frame = plan.frame
        assert isinstance(frame, PhaseSpace)
        own = PhaseSpace(frame.configuration, self.given[member], gyroscopic=frame.gyroscopic)
        return plan_of(own, plan.method)


def read_member_inertia(value: Any, frame: Frame, options: Any, members: int) -> MemberInertia:
    """Return the bodies of each member after checking them, those of the frame aside.

    A single member takes any number of them.
    """
    if not isinstance(frame, PhaseSpace):
        raise ValueError(f"inertia must be None unless frame is a phase space, got {short(value)}")
    if options["derivatives"]:
        raise ValueError(f"inertia must be None with derivatives={options['derivatives']!r}")
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
    return MemberInertia(np.array(columns, dtype=np.intc), numbers, each)
