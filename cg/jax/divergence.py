"""Divergences of vector fields, for densities that flow with solutions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from cg.frames import Frame, Power, Product
from cg.frames.user import UserFrame
from cg.jax.entire import JaxArray
from cg.jax.frames import rules_of
from cg.jax.rules import read_point, real_dtype
from cg.jax.term import FrameTerm


def divergence(
    f: Callable[[Any, Any, Any], Any], frame: Frame, *, key: Any = None
) -> Callable[[Any, Any, Any], JaxArray]:
    r"""Return a function ``(t, y, args)``: the divergence with respect to the invariant volume.

    The fields of a frame preserve the invariant volume of its manifold: Haar measure on groups,
    area on spheres. So the divergence of :math:`\sum_i f_i E_i` is :math:`\sum_i E_i f_i`, and
    along solutions the logarithm of a density decreases by its integral.

    Parameters
    ----------
    f
        ``f(t, y, args)`` as for `FrameTerm`.
    frame
        A frame that `cg.jax` supports, but none with fields of the user.
    key
        A key of ``jax.random``. With it the result is Hutchinson's estimate, one derivative in a
        random direction of entries ±1, instead of the sum of ``frame.dim`` derivatives. Its mean
        is the divergence. Use one key for a whole integration.

    Examples
    --------
    The gradient of the height on a sphere, at the north pole:

    >>> import crouch_grossman as cg, jax.numpy as jnp
    >>> north, sphere = jnp.array([0.0, 0.0, 1.0]), cg.frames.Sphere(2)
    >>> rate = cg.jax.divergence(lambda t, y, args: jnp.cross(y, north), sphere)
    >>> float(rate(0.0, north, None))
    -2.0
    """
    term, rules = FrameTerm(f, frame), rules_of(frame)
    if own := _own(frame):
        raise ValueError(f"frame must have a known invariant volume, got fields of the user: {own}")

    def evaluate(t: Any, y: Any, args: Any) -> JaxArray:
        y = read_point(frame, y)
        zero = jnp.zeros(frame.dim, real_dtype(y))

        def along(v: JaxArray) -> JaxArray:
            return term.vf(t, rules.flow(v, y), args)

        if key is None:
            return jnp.trace(jax.jacfwd(along)(zero))
        direction = jax.random.rademacher(key, (frame.dim,), zero.dtype)
        return direction @ jax.jvp(along, (zero,), (direction,))[1]

    return evaluate


def _own(frame: Frame) -> Frame | None:
    """Return the first factor whose fields are those of the user, None without one."""
    if isinstance(frame, UserFrame):
        return frame
    if isinstance(frame, Power):
        return _own(frame.factor)
    factors = frame.factors if isinstance(frame, Product) else ()
    return next(filter(None, map(_own, factors)), None)
