"""The default method.

Rules choose it from the measurements of ``python -m benchmarks estimates``:

1. Its error estimate is reliable: the ratio of error to estimate is at most 10 for rotations and
   quadrature, and at most 50 for jumps (`cg/construction/methods/estimate.py`); over random
   families of problems, at tolerances from 1e-3 to 1e-10, the median of the error at the end is at
   most 5 tolerances, and the largest at most 50. And it evaluates the right-hand side only at times
   within the step.
2. Of the reliable pairs whose cost at equal errors is within 10 per cent of the least, it is the
   one with the smallest sum of evaluations and flows. Costs are compared at errors of 1e-3 for
   loose tolerances and at 1e-8 for tight ones. The cost is processor time on compiled frames; the
   number of flows on frames in Python, where a flow costs many evaluations; and the sum of
   evaluations and flows on frames without brackets, whose flows are the user's functions.
3. `cg.scipy.Solver`, whose hosts have kinks at unknown times, takes the pair without brackets for
   loose tolerances: the default loses to LSODA there by more than 1.5 in evaluations at equal
   errors (``python -m benchmarks kinks``), this pair by 1.4, and on smooth problems it is as good.

The page of benchmarks lists the pairs that the rules select; a test checks their reliability.
"""

from __future__ import annotations

from cg.frames import Frame
from cg.frames.facts import facts_of
from cg.frames.linear_action import LinearAction
from cg.support.shared_numbers import BlockKind

AUTO = "auto"
"""Value of ``method`` for which `choose_method` chooses."""

_LIMIT = 1e-4  # relative tolerance at which methods without brackets take about the same time
# Blocks with flows in closed form, where time and evaluations are least without brackets
_CHEAP_FLOWS = frozenset(
    (BlockKind.EUCLIDEAN, BlockKind.SO3, BlockKind.QUATERNION, BlockKind.SE3, BlockKind.SPHERE,
     BlockKind.SU2)
)  # fmt: skip


def choose_method(
    frame: Frame, rtol: float | None, linear: bool = False, kinks: bool = False
) -> str:
    """Return the name of the default method on a frame; ``rtol`` is None for fixed steps."""
    facts = facts_of(frame)
    if linear:
        if isinstance(frame, LinearAction):
            # nine nodes of interpolation; more of them save few evaluations and no products
            return "Lobatto's formula"
        blocks = facts.blocks
        cheap = blocks is not None and _CHEAP_FLOWS.issuperset(block[0] for block in blocks)
        return "CFM8(4)" if cheap or not facts.has_brackets else "Magnus8(4)"
    if rtol is None:
        return "CF5(4)"
    if facts.has_brackets and not (kinks and rtol >= _LIMIT):
        return "RKMK8(5,3)"
    return "CF5(4)" if rtol >= _LIMIT else "DOP853"
