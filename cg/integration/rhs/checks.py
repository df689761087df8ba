"""Checks of what functions of the user return."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.frames.base import Frame
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.inputs import WithInput
from cg.support.arrays import (
    Array,
    Points,
    complex_array,
    conversion_hint,
    is_complex_array,
    real_array,
)
from cg.support.checks import short

_JOIN = "; join parts by np.concatenate"
_COMPLEX = "; the real and the imaginary part of a complex drive are coefficients of two fields"


def when(t: Any) -> str:
    """Return the time of a call, or the first of many times, for a message."""
    return f"t = {np.atleast_1d(t)[0]:.17g}"


def read_value(
    value: Any,
    name: str,
    shape: tuple[int, ...],
    t: Any,
    rows: str = "",
    hint: Callable[[tuple[int, ...]], str] | None = None,
    number: bool = False,
    dtype: Any = np.float64,
) -> Points:
    """Return what a function returned at ``t`` as a new array; ValueError if it isn't of the shape.

    A vectorized function returns ``rows``, each of a member or of a time. The hint gets the shape
    of the array.
    """
    each = f", a row for each {rows}, since vectorized=True" if rows else ""
    try:
        array: Points = (real_array if dtype == np.float64 else complex_array)(value, name)
    except ValueError as error:
        kind = "real" if dtype == np.float64 else "complex"
        expected = f"{shape[0]} {kind} numbers" if len(shape) == 1 else f"an array of shape {shape}"
        expected = expected if shape else "a real number"
        join = isinstance(value, list | tuple) and any(map(np.ndim, value))
        text = _JOIN if join else conversion_hint(value, error)
        text = _COMPLEX if not text and is_complex_array(value) and hint is not None else text
        raise ValueError(
            f"{name} must return {expected}{each}, got {short(value)} at {when(t)}{text}"
        ) from error
    if number and array.size == 1 == math.prod(shape):
        array = array.reshape(shape)
    if array.shape != shape:
        raise ValueError(
            f"{name} must return an array of shape {shape}{each}, got shape {array.shape} at "
            f"{when(t)}{hint(array.shape) if hint else ''}"
        )
    return array


def read_finite(
    value: Any, name: str, shape: tuple[int, ...], t: Any, number: bool = False
) -> Array:
    """Return what a function returned as a new array; ValueError unless it is finite as well.

    A single number may have any shape if ``number``.
    """
    array = read_value(value, name, shape, t, number=number)
    if not is_finite(array):
        raise ValueError(f"{name} must return finite numbers, got {short(value)} at {when(t)}")
    return array


def is_finite(array: Array) -> bool:
    """Return whether all numbers are finite.

    A finite sum means that all terms are finite, and takes a fraction of the time.
    """
    return math.isfinite(array.sum()) or bool(np.isfinite(array).all())


class Check:
    """The check of what ``f`` returns."""

    def __init__(self, f: Any, frame: Frame, vectorized: bool = False) -> None:
        self.frame, self.vectorized = frame, vectorized
        self.of_time = isinstance(f.function if isinstance(f, WithInput) else f, TimeFunction)
        self.rows = ("time" if self.of_time else "member") if vectorized else ""

    def __call__(self, value: Any, t: Any, y: Points | None = None) -> Points:
        """Return what ``f(t, y)`` returned as an array, shape ``rhs_shape`` or ``(n, *rhs_shape)``.

        ValueError is raised if it has another shape. Numbers that aren't finite pass: compiled code
        rejects the step in which they are.
        """
        shape = self.frame.rhs_shape
        shape = (len(t), *shape) if self.vectorized else shape
        dtype = self.frame.rhs_dtype
        return read_value(value, "f", shape, t, self.rows, self._hint, dtype=dtype)

    def _hint(self, shape: tuple[int, ...]) -> str:
        """Return a hint if ``f`` returned a matrix of the Lie algebra, or a derivative."""
        shape = shape[int(self.vectorized) :]
        if self.frame.rhs_shape == self.frame.point_shape:
            return ""
        group = self.frame.group if isinstance(self.frame, HomogeneousSpace) else self.frame
        flat = isinstance(group, MatrixGroup) and shape == (math.prod(group.point_shape),)
        if not isinstance(group, MatrixGroup) or not (flat or shape == group.point_shape):
            if shape != self.frame.point_shape:
                return _JOIN if len(shape) > 1 and math.prod(shape) == self.frame.rhs_dim else ""
            return '; rhs="derivative" takes derivatives of y'
        name = "frame.vee" if group is self.frame else "frame.group.vee"
        return (
            f"; {name}(matrix) are those of a matrix in the Lie algebra, and "
            'rhs="derivative" takes derivatives of y'
        )
