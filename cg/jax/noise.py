"""Stratonovich equations: noise along the fields of a frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp

from cg.frames import Frame
from cg.jax.entire import JaxArray
from cg.jax.frames import rules_of
from cg.jax.rules import real_dtype
from cg.jax.term import FrameTerm, unwrapped
from cg.method.method import Method


class NoiseTerm(diffrax.ControlTerm):
    r"""The noise of :math:`dy = \sum_i E_i(y) \bigl(f_i\, dt + \sum_j g_{ij} \circ dW_j\bigr)`.

    The products with the Brownian path are those of Stratonovich, as are equations with noise on
    manifolds: solutions stay on them. Pass ``diffrax.MultiTerm(FrameTerm(f, frame), NoiseTerm(g,
    path, frame))`` with a `Solver` and steps of a fixed size; each step follows the flows of a
    step of the method with ``f h + g ΔW`` in place of ``h f``. Convergence is of strong order ½,
    and 1 for one noise or where the noise fields commute, and of weak order 1.

    Parameters
    ----------
    g
        ``g(t, y, args)`` of ``jax.numpy`` returns an array of shape ``(frame.dim, noises)``.
    path
        A Brownian path of shape ``(noises,)``, such as ``diffrax.VirtualBrownianTree``.
    frame
        As for `FrameTerm`.

    Raises
    ------
    TypeError
        If ``g`` is no function, ``path`` no Brownian path, or ``frame`` none for JAX.
    ValueError
        When it is used: if ``g`` returns another shape, the terms have two frames, or the method
        is of order one or for linear equations, whose steps have Itô's or another limit.

    Examples
    --------
    >>> import crouch_grossman as cg, diffrax, jax, jax.numpy as jnp
    >>> frame = cg.frames.SO3()
    >>> path = diffrax.VirtualBrownianTree(0.0, 1.0, tol=1e-3, shape=(3,), key=jax.random.key(0))
    >>> terms = diffrax.MultiTerm(
    ...     cg.jax.FrameTerm(lambda t, y, args: jnp.zeros(3), frame),
    ...     cg.jax.NoiseTerm(lambda t, y, args: 0.3 * jnp.eye(3), path, frame),
    ... )
    >>> solver = cg.jax.Solver("CF4", dense="steps")
    >>> y = diffrax.diffeqsolve(terms, solver, 0.0, 1.0, 0.01, jnp.eye(3)).ys[-1]
    >>> bool(abs(y.T @ y - jnp.eye(3)).max() < 1e-5)
    True
    """

    vector_field: Callable[..., Any]
    control: Any
    frame: Frame = eqx.field(static=True)

    def __init__(self, g: Callable[[Any, Any, Any], Any], path: Any, frame: Frame) -> None:
        if not callable(g):
            raise TypeError(f"g must be a function, got {g!r}")
        if not isinstance(path, diffrax.AbstractBrownianPath):
            raise TypeError(f"path must be a Brownian path of diffrax, got {path!r}")
        rules_of(frame)
        super().__init__(g, path)
        self.frame = frame

    def vf(self, t: JaxArray, y: JaxArray, args: Any) -> JaxArray:
        """Return the coefficients of the noises, shape ``(dim, noises)``."""
        value = jnp.asarray(self.vector_field(t, y, args))
        if value.ndim != 2 or len(value) != self.frame.dim or jnp.iscomplexobj(value):
            raise ValueError(
                f"g must return real numbers of shape ({self.frame.dim}, noises), got "
                f"{value.dtype} of shape {value.shape}"
            )
        return value.astype(real_dtype(y))


def check_noise(terms: diffrax.MultiTerm, method: Method) -> None:
    """Raise an error unless terms are one of a frame and noise on it, for a method that suits."""
    parts = [unwrapped(term) for term in terms.terms]
    if [isinstance(parts[0], FrameTerm), *map(_is_noise, parts[1:])] != [True] * len(parts):
        kinds = ", ".join(type(part).__name__ for part in parts)
        raise TypeError(
            f"terms must be a cg.jax.FrameTerm and then cg.jax.NoiseTerm, got {kinds}; f is "
            "one function with all coefficients"
        )
    if any(part.frame != parts[0].frame for part in parts[1:]):
        raise ValueError(f"terms must have one frame, got {[part.frame for part in parts]}")
    if method.order < 2:
        raise ValueError(
            f"method must be of order two or more for noise, got {method!r}, whose steps have the "
            "limit of Itô"
        )


def _is_noise(term: Any) -> bool:
    return isinstance(term, NoiseTerm)


def increments(
    terms: diffrax.MultiTerm, t0: JaxArray, t1: JaxArray, args: Any
) -> Callable[[Any, JaxArray], JaxArray]:
    """Return the function ``(c, y)`` whose values are coefficients times the changes in a step."""
    controls = [term.contr(t0, t1) for term in terms.terms]

    def f(c: Any, y: JaxArray) -> JaxArray:
        t = t0 + c * (t1 - t0)
        drift, *noises = (term.vf(t, y, args) for term in terms.terms)
        total = drift * controls[0]
        for g, change in zip(noises, controls[1:], strict=True):
            total = total + g @ jnp.asarray(change, g.dtype)
        return total

    return f
