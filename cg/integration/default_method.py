"""The default method.

It is chosen by these rules from the measurements of ``python -m benchmarks estimates``:

1. Its error estimate is reliable: the ratio of error to estimate is at most 10 for rotations and
   quadrature, and at most 50 for jumps (`construction/methods/estimate.py`); over random
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
from cg.frames.linear_action import LinearAction
from cg.integration.plan.plan import has_brackets
from cg.support.shared_numbers import BlockKind

AUTO = "auto"
"""Value of ``method`` for which `choose_method` chooses."""

_FIXED_STEPS = "CF5(4)"
_WITH_BRACKETS = "RKMK8(5,3)"
# Without brackets, by the relative tolerance. At the limit both take about the same time.
_LOOSE, _TIGHT, _LIMIT = "CF5(4)", "DOP853", 1e-4

# Linear equations
_MAGNUS, _COMMUTATOR_FREE = "Magnus8(4)", "CFM8(4)"
# Nine nodes of interpolation on LinearAction; more of them save few evaluations and no products.
_LOBATTO = "Lobatto's formula"
# Blocks with flows in closed form, where time and evaluations are least without brackets
_CLOSED_FORMS = frozenset(
    (BlockKind.EUCLIDEAN, BlockKind.SO3, BlockKind.QUATERNION, BlockKind.SE3, BlockKind.SPHERE,
     BlockKind.SU2)
)  # fmt: skip


def choose_method(
    frame: Frame, rtol: float | None, linear: bool = False, kinks: bool = False
) -> str:
    """Return the name of the default method on a frame; ``rtol`` is None for fixed steps."""
    if linear:
        if isinstance(frame, LinearAction):
            return _LOBATTO
        blocks = frame.compiled_blocks()
        cheap = blocks is not None and _CLOSED_FORMS.issuperset(block[0] for block in blocks)
        return _COMMUTATOR_FREE if cheap or not has_brackets(frame) else _MAGNUS
    if rtol is None:
        return _FIXED_STEPS
    if has_brackets(frame) and not (kinks and rtol >= _LIMIT):
        return _WITH_BRACKETS
    return _LOOSE if rtol >= _LIMIT else _TIGHT
