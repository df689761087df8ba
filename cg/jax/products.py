"""Products and powers of frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from cg.frames import Power, Product
from cg.jax.rules import JaxArray, Rules, read_point


def split(frame: Product, y: JaxArray) -> tuple[JaxArray, ...]:
    """Return the points of the factors of a product, each of the shape of its factor.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    >>> [part.shape for part in cg.jax.split(frame, jnp.arange(7.0))]
    [(4,), (3,)]
    """
    _check_product(frame)
    y = read_point(frame, y)
    points = []
    for factor, slot in zip(frame.factors, frame._point_slices, strict=True):
        entries = y[slot]
        if factor.dtype.kind == "c":
            entries = jax.lax.complex(*entries.reshape(-1, 2).T)
        points.append(entries.reshape(factor.point_shape))
    return tuple(points)


def join(frame: Product, *parts: JaxArray) -> JaxArray:
    """Return the point of a product, the inverse of `split`, shape ``frame.point_shape``.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> plane = cg.frames.Product(cg.frames.Euclidean(1), cg.frames.Euclidean(1))
    >>> cg.jax.join(plane, jnp.ones(1), jnp.zeros(1)).tolist()
    [1.0, 0.0]
    """
    _check_product(frame)
    if len(parts) != len(frame.factors):
        raise ValueError(f"parts must be {len(frame.factors)} points, got {len(parts)}")
    flat = []
    for index, factor in enumerate(frame.factors):
        point = read_point(factor, parts[index], f"parts[{index}]")
        if factor.dtype.kind == "c":
            point = jnp.stack([point.real, point.imag], axis=-1)
        flat.append(point.reshape(-1))
    return jnp.concatenate(flat)


def product_rules(frame: Product, factors: list[Rules]) -> Rules:
    """Return the rules of a product, from those of its factors."""

    def cut(v: JaxArray) -> list[JaxArray]:
        return [v[..., slot] for slot in frame._vector_slices]

    def each(name: str, *arguments: Any) -> list[JaxArray]:
        pairs = zip(factors, *arguments, strict=True)
        return [getattr(rules, name)(*parts) for rules, *parts in pairs]

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        return jnp.concatenate(each("dexpinv", cut(u), cut(v), [order] * len(factors)))

    def together(name: str) -> Callable[[JaxArray, JaxArray], JaxArray]:
        return lambda x, y: jnp.concatenate(each(name, split(frame, x), split(frame, y)))

    def composed(flows: JaxArray) -> JaxArray:
        functions = [rules.composed or (lambda v: jnp.zeros_like(v[0])) for rules in factors]
        pairs = zip(functions, cut(flows), strict=True)
        return jnp.concatenate([function(parts) for function, parts in pairs])

    return Rules(
        frame,
        lambda v, y: join(frame, *each("flow", cut(v), split(frame, y))),
        lambda y: join(frame, *each("restore", split(frame, y))),
        None if any(rules.log is None for rules in factors) else together("log"),
        None if any(rules.dexpinv is None for rules in factors) else dexpinv,
        together("coefficients"),
        lambda y: jnp.concatenate(each("sizes", split(frame, y))),
        lambda y: jnp.stack(each("relative_error", split(frame, y))).max(),
        unique=all(rules.unique for rules in factors),
        composed=None if all(rules.composed is None for rules in factors) else composed,
        closed_field=lambda v, y: join(frame, *each("field", cut(v), split(frame, y))),
    )


def power_rules(frame: Power, rules: Rules) -> Rules:
    """Return the rules of a power, from those of its factor."""
    n, m = frame.n, frame.factor.dim

    def on_points(function: Callable[..., JaxArray]) -> Callable[..., JaxArray]:
        return lambda *points: jax.vmap(function)(*points).reshape(-1)

    def dexpinv(u: JaxArray, v: JaxArray, order: int) -> JaxArray:
        inverse = rules.dexpinv
        assert inverse is not None
        each = jax.vmap(lambda x, y: inverse(x, y, order))
        return each(u.reshape(n, m), v.reshape(n, m)).reshape(-1)

    def composed(flows: JaxArray) -> JaxArray:
        assert rules.composed is not None
        return jax.vmap(rules.composed, 1)(flows.reshape(len(flows), n, m)).reshape(-1)

    return Rules(
        frame, lambda v, y: jax.vmap(rules.flow)(v.reshape(n, m), y), jax.vmap(rules.restore),
        None if rules.log is None else on_points(rules.log),
        None if rules.dexpinv is None else dexpinv, on_points(rules.coefficients),
        on_points(rules.sizes), lambda y: jax.vmap(rules.relative_error)(y).max(),
        unique=rules.unique, composed=None if rules.composed is None else composed,
    )  # fmt: skip


def _check_product(frame: Any) -> None:
    if not isinstance(frame, Product):
        raise TypeError(f"frame must be a cg.frames.Product, got {frame!r}")
