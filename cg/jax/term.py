"""Right-hand sides for diffrax: coefficients of the fields of a frame, of noise and of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from cg.frames import Frame, Product
from cg.jax.frames import rules_of
from cg.jax.rules import JaxArray, Rules, real_dtype
from cg.tables import MethodTable


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
        return coefficients.astype(real_dtype(y))

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


class NoiseTerm(diffrax.ControlTerm):
    r"""The noise of :math:`dy = \sum_i E_i(y) \bigl(f_i\, dt + \sum_j g_{ij} \circ dW_j\bigr)`.

    The equation is in the sense of Stratonovich, so that solutions stay on the manifold. Pass
    ``diffrax.MultiTerm(FrameTerm(f, frame), NoiseTerm(g, path, frame))`` with a `Solver` and steps
    of a fixed size; each step follows the flows of the method with ``f h + g ΔW`` in place of
    ``h f``. The strong order is ½, and 1 for one noise or where the noise fields commute; the weak
    order is 1. Points between the ends of steps leave out the noise there, with errors of order ½:
    ``diffrax.StepTo(ts)`` ends steps at the times of output.

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
    ValueError
        When it is used: if ``g`` returns another shape, or the path has one, the terms have two
        frames, or the method is of order one or for linear equations, whose steps have Itô's or
        another limit.

    Examples
    --------
    >>> import crouch_grossman as cg, diffrax, jax, jax.numpy as jnp
    >>> frame = cg.frames.SO3()
    >>> path = diffrax.VirtualBrownianTree(0.0, 1.0, tol=1e-3, shape=(3,), key=jax.random.key(0))
    >>> terms = diffrax.MultiTerm(
    ...     cg.jax.FrameTerm(lambda t, y, args: jnp.zeros(3), frame),
    ...     cg.jax.NoiseTerm(lambda t, y, args: 0.3 * jnp.eye(3), path, frame),
    ... )
    >>> solver = cg.jax.Solver("CF4")
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


def rules_in(terms: Any) -> Rules:
    """Return the rules of the frame of a term; TypeError if it is no term of a frame."""
    term = unwrapped(terms.terms[0] if isinstance(terms, diffrax.MultiTerm) else terms)
    if isinstance(term, FrameTerm):
        return rules_of(term.frame)
    raise TypeError(f"terms must be one cg.jax.FrameTerm, got {type(term).__name__}")


def unwrapped(terms: Any) -> Any:
    """Return the term of the user that diffrax has wrapped."""
    while isinstance(terms, diffrax._term.WrapTerm):
        terms = terms.term
    return terms


def check_noise(terms: diffrax.MultiTerm, table: MethodTable) -> None:
    """Raise an error unless terms are a FrameTerm and noise on its frame, and the method fits."""
    drift, *noises = users = [unwrapped(term) for term in terms.terms]
    if not (isinstance(drift, FrameTerm) and all(isinstance(g, NoiseTerm) for g in noises)):
        kinds = ", ".join(type(term).__name__ for term in users)
        raise TypeError(
            f"terms must be a cg.jax.FrameTerm and then cg.jax.NoiseTerm, got {kinds}; f is "
            "one function with all coefficients"
        )
    if any(noise.frame != drift.frame for noise in noises):
        raise ValueError(f"terms must have one frame, got {[term.frame for term in users]}")
    if table.order < 2:
        raise ValueError(
            f"method must be of order two or more for noise, got {table!r}, whose steps have the "
            "limit of Itô"
        )


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
            if jnp.shape(change) != g.shape[1:]:
                raise ValueError(f"path must have shape {g.shape[1:]}, got {jnp.shape(change)}")
            total = total + g @ jnp.asarray(change, g.dtype)
        return total

    return f


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
