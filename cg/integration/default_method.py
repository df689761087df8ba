"""Which pair takes the steps where the caller names none.

The rule, with what ``python -m benchmarks estimates`` measures:

1. A default is honest: over ten problems and fifty spins, at tolerances from 1e-3 to 1e-10, the
   median of the error at the end is at most 5 tolerances, and the largest at most 50. And it calls
   the right-hand side within the step alone.
2. Of the honest pairs that cost least at equal errors, up to 10 per cent more, it is the one with
   the fewest evaluations and flows together. Costs are compared at errors of 1e-3 for loose
   tolerances and at 1e-8 for tight ones. They are processor time on frames that are compiled; flows
   on frames in Python, where a flow costs many evaluations; evaluations and flows together on
   frames without brackets, whose flows are functions of the user's.

The benchmark's page tells which pairs the rule takes, and a test that the defaults are honest.
"""

from __future__ import annotations

from functools import lru_cache

from cg.frames import Frame
from cg.integration.step.blocks import is_compiled
from cg.integration.step.plan import has_brackets

__all__ = ["AUTO", "choose_method"]

AUTO = "auto"
"""The name that leaves the choice of a method to `choose_method`."""

# Where the costs of both pairs are about equal
_LOOSE = 1e-4
# For loose and for tight tolerances
_COMPILED = ("CF5(4)", "RKMK8(5,3)")
_WITH_BRACKETS = ("RKMK5(4)", "RKMK8(5,3)")
_WITHOUT = ("CF5(4)", "CF6(5)")


def choose_method(frame: Frame, rtol: float | None) -> str:
    """Return the name of the pair that takes the steps.

    Parameters
    ----------
    frame
        The frame; it matters whether it is compiled, and whether it has brackets.
    rtol
        The relative tolerance: at 1e-4 or more the pair is one of order five, below it of order
        eight where there are brackets and six where there are none. None for fixed steps, which
        are taken as loose.
    """
    try:
        pairs = _pairs(frame)
    except TypeError:  # a frame of the user that can't be hashed
        pairs = _pairs.__wrapped__(frame)
    return pairs[0 if rtol is None or rtol >= _LOOSE else 1]


@lru_cache(maxsize=256)
def _pairs(frame: Frame) -> tuple[str, str]:
    if not has_brackets(frame):
        return _WITHOUT
    return _COMPILED if is_compiled(frame) else _WITH_BRACKETS
