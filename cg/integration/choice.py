"""Which pair takes the steps where the caller names none.

Measured by ``python -m benchmarks rivals``: time for an error, over tolerances, on ten problems.

- For errors above 1e-5 Dormand and Prince's tableau is the fastest: lifted, by some ten per cent,
  on frames that are compiled; as a method of Munthe-Kaas, with half the flows, where these are
  functions in Python.
- For smaller errors Munthe-Kaas's method with DOP853's tableau is.
- Without brackets, flows are functions of the user's, which cost as much as f: CF5(4) needs the
  fewest for errors above 1e-5, CF6(5) below. DOP853 needs fewer evaluations at 1e-8 and beyond, and
  half as many flows again.
"""

from __future__ import annotations

from cg.frames import Frame
from cg.integration.arguments import has_brackets
from cg.integration.blocks import is_compiled

__all__ = ["AUTO", "choose_method"]

AUTO = "auto"
"""The name that leaves the choice of a method to `choose_method`."""

# At larger tolerances errors are above 1e-5.
_LOOSE = 1e-4
# For loose and for tight tolerances
_COMPILED = ("DP5(4)", "RKMK8(5,3)")
_WITH_BRACKETS = ("RKMK5(4)", "RKMK8(5,3)")
_WITHOUT = ("CF5(4)", "CF6(5)")


def choose_method(frame: object, rtol: float | None) -> str:
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
    if not isinstance(frame, Frame) or not has_brackets(frame):
        pairs = _WITHOUT
    else:
        pairs = _COMPILED if is_compiled(frame) else _WITH_BRACKETS
    return pairs[0 if rtol is None or rtol >= _LOOSE else 1]
