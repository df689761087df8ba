"""What integrations ask of a frame: whether it is compiled, its brackets, its dexp⁻¹."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from cg.frames.base import Frame
from cg.frames.compiled import compared_by_entries, dexpinv
from cg.frames.homogeneous import HomogeneousSpace
from cg.support.arrays import Array
from cg.support.caches import cached_by_value

Dexpinv = Callable[[Array, Array], Array]
"""``dexpinv(u, v)`` is `Frame.dexpinv`."""


def is_compiled(frame: Frame) -> bool:
    """Return whether compiled code has the flows of a frame."""
    return frame.compiled_blocks() is not None


def has_compiled_difference(frame: Frame) -> bool:
    """Return whether compiled code computes the flow from one point to another."""
    blocks = frame.compiled_blocks()
    return blocks is not None and not compared_by_entries(blocks)


def dexpinv_of(frame: Frame, order: int) -> Dexpinv:
    """Return `Frame.dexpinv` for a method of some order."""
    if isinstance(frame, HomogeneousSpace) and is_compiled(frame.group):
        frame = frame.group
    blocks = frame.compiled_blocks()
    return partial(frame.dexpinv if blocks is None else partial(dexpinv, blocks), order=order)


@cached_by_value
def for_derivatives(frame: Frame) -> dict[bool, Frame]:
    """Return `Frame.for_derivatives` without and with brackets."""
    return {known: frame.for_derivatives(with_brackets=known) for known in (False, True)}


@cached_by_value
def has_brackets(frame: Frame) -> bool:
    """Return whether a frame has brackets of its fields."""
    try:
        frame.bracket(np.zeros(frame.dim), np.zeros(frame.dim))
    except NotImplementedError:
        return False
    return True


def check_brackets(frame: Frame, method: object) -> None:
    """Raise ValueError if a frame doesn't have the brackets that a method needs."""
    try:
        frame.bracket(np.zeros(frame.dim), np.zeros(frame.dim))
    except NotImplementedError as error:
        raise ValueError(
            f"method must be of Crouch-Grossman type or commutator-free on this frame, got "
            f"{method!r}, which needs brackets: {error}"
        ) from None
