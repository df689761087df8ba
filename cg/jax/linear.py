"""Linear equations in JAX: coefficients that depend on time alone.

The results of a Magnus method may agree although its nodes miss a feature of the coefficients.
`node_difference` estimates that error from the nodes of this step and of the one before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from cg.frames import Frame
from cg.integration.step.paths import MethodPaths
from cg.jax.entire import JaxArray
from cg.jax.term import FrameTerm

_ROUNDINGS = 64  # as in fortran/steps/node_difference.f90


class LinearTerm(FrameTerm):
    r"""The right-hand side :math:`y' = \sum_i a_i(t) E_i(y)`, with coefficients of time alone.

    It takes every `Solver`, also those of Magnus methods, such as ``Solver("CFM6(4)")``: their
    steps evaluate the coefficients at a few nodes, all at once, and need fewer flows.

    Parameters
    ----------
    a
        ``a(t, args)`` of ``jax.numpy`` returns the coefficients, shape ``(frame.dim,)``.
    frame
        As for `FrameTerm`; also `cg.frames.LinearAction`, whose generators are dense in JAX.

    Raises
    ------
    TypeError, ValueError
        As for `FrameTerm`.

    Examples
    --------
    >>> import crouch_grossman as cg, diffrax, jax.numpy as jnp
    >>> frame = cg.frames.SO3()
    >>> term = cg.jax.LinearTerm(lambda t, rate: jnp.array([0.0, 0.0, rate * t]), frame)
    >>> solution = diffrax.diffeqsolve(
    ...     term, cg.jax.Solver("CFM4"), t0=0.0, t1=1.0, dt0=0.5, y0=jnp.eye(3), args=2.0
    ... )
    >>> [round(float(x), 5) for x in solution.ys[0, 0]]  # a turn by one radian
    [0.5403, -0.84147, 0.0]
    """

    def __init__(self, a: Callable[[Any, Any], Any], frame: Frame) -> None:
        if not callable(a):
            raise TypeError(f"a must be a function, got {a!r}")
        super().__init__(_OfTime(a), frame)


class _OfTime(eqx.Module):
    a: Callable[[Any, Any], Any]

    def __call__(self, t: Any, y: Any, args: Any) -> Any:
        return self.a(t, args)


class Before(eqx.Module):
    """The step before: its size, zero without one, and the coefficients at its nodes."""

    h: JaxArray
    values: JaxArray


def no_step(paths: MethodPaths, first: JaxArray) -> Before:
    """Return the step before a first one."""
    count = len(paths.stages)
    return Before(jnp.zeros((), first.dtype), jnp.zeros((count, len(first)), first.dtype))


def node_difference(paths: MethodPaths, values: JaxArray, h: JaxArray, before: Before) -> JaxArray:
    """Return the largest error of interpolation between the nodes times h, zero in a first step.

    With the highest divided difference D of the coefficients over the nodes t_i of both steps, it
    is h D max_m |prod_i (m - t_i)| over the middles m between nodes of this step; D below rounding
    counts as zero. As in ``fortran/steps/node_difference.f90``.
    """
    c = np.asarray(paths.abscissae)
    known = h != 0.0
    ratio = before.h / jnp.where(known, h, 1.0)
    earlier = (jnp.asarray(c, h.dtype) - 1.0) * ratio
    fields = before.values
    if c[-1] == 1.0 and c[0] == 0.0:  # the end of the step before is the start of this one
        earlier, fields = earlier[:-1], fields[:-1]
    times = jnp.concatenate([earlier, jnp.asarray(c, h.dtype)])
    fields = jnp.concatenate([fields, values])
    used = known & (before.h != 0.0)
    times = jnp.where(used, times, jnp.arange(len(times), dtype=h.dtype))
    apart = times[:, None] - times + jnp.eye(len(times), dtype=h.dtype)
    weights = 1.0 / apart.prod(axis=1)
    middles = 0.5 * (times[-len(c) : -1] + times[-len(c) + 1 :])
    largest = jnp.abs((middles[:, None] - times).prod(axis=1)).max()
    difference = weights @ fields
    rounding = _ROUNDINGS * jnp.finfo(h.dtype).eps * (jnp.abs(weights) @ jnp.abs(fields))
    seen = used & (jnp.abs(difference) > rounding)
    return h * largest * jnp.where(seen, difference, 0.0)
