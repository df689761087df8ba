"""Facts about frames that integrations need: compiled blocks, brackets, dexp⁻¹."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.frames.blocks import compared_by_entries, dexpinv
from cg.frames.homogeneous import HomogeneousSpace
from cg.support.arrays import Array
from cg.support.caches import cached_by_value

Dexpinv = Callable[[Array, Array], Array]
"""``dexpinv(u, v)`` is `Frame.dexpinv`."""


class FrameFacts:
    """Facts about a frame that integrations need at each call, computed once."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.blocks = frame.compiled_blocks()
        self.compiled = self.blocks is not None
        # whether compiled code computes the flow from one point to another
        self.has_difference = self.blocks is not None and not compared_by_entries(self.blocks)
        # filled by others: plans of `cg.integration.plan`, and products with derivatives
        self.plans: dict[Any, Any] = {}
        self.products: dict[Any, Any] = {}

    @cached_property
    def no_brackets(self) -> str | None:
        """Why the frame has no brackets of its fields, None if it has."""
        try:
            self.frame.bracket(np.zeros(self.frame.dim), np.zeros(self.frame.dim))
        except NotImplementedError as error:
            return str(error)
        return None

    @property
    def has_brackets(self) -> bool:
        """Whether the frame has brackets of its fields."""
        return self.no_brackets is None


facts_of = cached_by_value(FrameFacts)
"""The facts of a frame, which are kept for the last 64 frames."""


def dexpinv_of(frame: Frame, order: int) -> Dexpinv:
    """Return `Frame.dexpinv` for a method of some order."""
    if isinstance(frame, HomogeneousSpace) and facts_of(frame.group).compiled:
        frame = frame.group
    blocks = facts_of(frame).blocks
    return partial(frame.dexpinv if blocks is None else partial(dexpinv, blocks), order=order)


@cached_by_value
def frames_for_derivatives(frame: Frame) -> tuple[Frame, Frame]:
    """Return the frame and `Frame.for_derivatives`, the same objects for equal frames."""
    fastest = frame.for_derivatives()
    return frame, frame if fastest == frame else fastest


def check_brackets(frame: Frame, method: object) -> None:
    """Raise ValueError if a frame doesn't have the brackets that a method needs."""
    if (reason := facts_of(frame).no_brackets) is not None:
        raise ValueError(
            f"method must be of Crouch-Grossman type or commutator-free on this frame, got "
            f"{method!r}, which needs brackets: {reason}"
        )
