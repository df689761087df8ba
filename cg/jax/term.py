"""Right-hand sides for diffrax: coefficients of the fields of a frame."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import Euclidean, Frame, Product
from cg.jax.entire import JaxArray
from cg.jax.frames import rules_of
from cg.jax.rules import Rules

_CALLERS = 12  # of which equinox has some between diffrax and a solver


class FrameTerm(diffrax.AbstractTerm):
    r"""The right-hand side :math:`y' = \sum_i f_i(t, y) E_i(y)`, for `diffrax.diffeqsolve`.

    Parameters
    ----------
    f
        ``f(t, y, args)`` of ``jax.numpy`` returns the coefficients of the fields of the frame,
        shape ``(frame.dim,)``. ``y`` has the shape ``frame.point_shape``.
    frame
        One of those of `cg.frames`, or a `cg.frames.FieldFrame` whose functions are written in
        ``jax.numpy``.

    Raises
    ------
    TypeError
        If ``f`` is no function, or JAX has no functions for ``frame``.
    ValueError
        When it is used: if ``f`` returns another shape or numbers that aren't real, or ``y0`` isn't
        an array of the shape and kind of a point.
    NotImplementedError
        When it is used with a solver other than `Solver`, or with ``BacksolveAdjoint``.

    Examples
    --------
    >>> import crouch_grossman as cg, diffrax, jax.numpy as jnp
    >>> frame = cg.frames.SO3()
    >>> term = cg.jax.FrameTerm(lambda t, y, args: args * y[2], frame)
    >>> solution = diffrax.diffeqsolve(
    ...     term, cg.jax.Solver("CF4"), t0=0.0, t1=1.0, dt0=0.1, y0=jnp.eye(3), args=2.0
    ... )
    >>> solution.ys.shape
    (1, 3, 3)
    """

    f: Callable[[Any, Any, Any], Any]
    frame: Frame = eqx.field(static=True)

    def __init__(self, f: Callable[[Any, Any, Any], Any], frame: Frame) -> None:
        if not callable(f):
            raise TypeError(f"f must be a function, got {f!r}")
        rules_of(frame)
        self.f = f
        self.frame = frame

    def vf(self, t: JaxArray, y: JaxArray, args: Any) -> JaxArray:
        """Return the coefficients, shape ``(dim,)``, in the precision of ``y``."""
        _check_point(self.frame, y)
        try:
            value = self.f(t, y, args)
        except jax.errors.JAXTypeError as error:
            error.add_note("f must be written in jax.numpy, with jnp.where or lax.cond for if")
            raise
        expected = f"f must return {self.frame.dim} real numbers, shape ({self.frame.dim},)"
        try:
            coefficients = jnp.asarray(value)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{expected}, got {value!r}") from error
        if coefficients.shape != (self.frame.dim,):
            raise ValueError(f"{expected}, got shape {coefficients.shape}")
        if jnp.iscomplexobj(coefficients):
            raise ValueError(f"{expected}, got {coefficients.dtype}")
        return coefficients.astype(jnp.finfo(y.dtype).dtype)

    def contr(self, t0: JaxArray, t1: JaxArray, **kwargs: Any) -> JaxArray:
        """Return the time between two times."""
        return t1 - t0

    def prod(self, vf: JaxArray, control: JaxArray) -> JaxArray:
        """Refuse solvers and adjoints that add tangents to points instead of following flows."""
        raise NotImplementedError(
            'solver must be one of this package for a FrameTerm, such as cg.jax.Solver("CF4"), and '
            "adjoint must not be BacksolveAdjoint, whose state is no point of the frame, but "
            "RecursiveCheckpointAdjoint"
        )


def rules_in(terms: Any) -> Rules:
    """Return the rules of the frame of a term; TypeError if it is no term of a frame."""
    first = terms.terms[0] if isinstance(terms, diffrax.MultiTerm) else terms
    term = unwrapped(first)
    if isinstance(term, FrameTerm):
        return rules_of(term.frame)
    raise TypeError(f"terms must be one cg.jax.FrameTerm, got {type(term).__name__}")


def unwrapped(terms: Any) -> Any:
    """Return the term of the user that diffrax has wrapped."""
    while isinstance(terms, diffrax._term.WrapTerm):
        terms = terms.term
    return terms


def refuse_implicit_adjoint(frame: Frame) -> None:
    """Raise NotImplementedError if diffrax's ImplicitAdjoint asks for f on a manifold.

    It solves f(y) = 0 for the entries of y. Only the functions that call tell which adjoint it is.
    """
    place = inspect.currentframe()
    for _ in range(_CALLERS):
        if place is None or isinstance(frame, Euclidean):
            return
        if (place.f_globals.get("__name__"), place.f_code.co_name) == ("diffrax._adjoint", "_vf"):
            raise NotImplementedError(
                "adjoint must not be ImplicitAdjoint on a manifold, where f(y) = 0 does not "
                "determine the entries of y; RecursiveCheckpointAdjoint gives the gradient"
            )
        place = place.f_back


def _check_point(frame: Frame, y: Any) -> None:
    """Raise ValueError if something is no array of the shape and kind of a point."""
    if not isinstance(y, jax.Array | np.ndarray):
        hint = "; cg.jax.join makes one of its parts" if isinstance(frame, Product) else ""
        kind = type(y).__name__
        raise ValueError(f"y0 must be an array of shape {frame.point_shape}, got a {kind}{hint}")
    if y.shape != frame.point_shape:
        hint = "; jax.vmap takes a batch" if y.shape[1:] == frame.point_shape else ""
        raise ValueError(f"y0 must have shape {frame.point_shape}, got {y.shape}{hint}")
    if jnp.iscomplexobj(y) != (frame.dtype.kind == "c"):
        kind = "complex" if frame.dtype.kind == "c" else "real"
        raise ValueError(f"y0 must be {kind} for {frame!r}, got {y.dtype}")
