"""Products of frames, and powers: products of equal factors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame, check_frame
from cg.frames.blocks import Blocks, compared_by_entries
from cg.support.arrays import Array, Points, Size, check_random, is_array
from cg.support.checks import check_integer


class Composite(Frame):
    """A frame of several factors, whose methods are those of its factors."""

    @abstractmethod
    def _each(self, method: str, *arguments: Any, **options: Any) -> Any:
        """Return the results of a method of all factors, with the arguments of each."""

    @abstractmethod
    def _split_vector(self, vector: Array) -> Any:
        """Return the coefficients of each factor."""

    @abstractmethod
    def _join_vectors(self, vectors: Any) -> Array:
        """Return the coefficients of all factors, joined."""

    def _split(self, point: Points) -> Any:
        """Return the points of the factors: a stack of them is the point itself."""
        return point

    def _join(self, points: Any) -> Points:
        """Return the point of the factors' points."""
        return np.asarray(points)

    def _joined(self, method: str, *arguments: Any, **options: Any) -> Array:
        """Return the coefficients that a method of all factors returns, joined."""
        return self._join_vectors(self._each(method, *arguments, **options))

    def _numbers(self, method: str, *points: Points) -> Array:
        """Return the number that a method of each factor returns, shape ``(..., factors)``."""
        numbers = self._each(method, *map(self._split, points))
        return np.stack(numbers, axis=-1) if isinstance(numbers, list) else numbers

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self._join(self._each("field", self._split_vector(vector), self._split(point)))

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self._join(self._each("flow", self._split_vector(vector), self._split(point)))

    def _bracket(self, u: Array, v: Array) -> Array:
        return self._joined("_bracket", self._split_vector(u), self._split_vector(v))

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        vectors = self._split_vector(u), self._split_vector(v)
        return self._joined("_dexpinv", *vectors, order=order)

    def without_isotropy(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._rows(v, y)
        return self._joined("without_isotropy", self._split_vector(vector), self._split(point))

    def local_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        return self._between("local_coordinates", y0, y1)

    def _nearest_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        return self._between("_nearest_coordinates", y0, y1)

    def _logarithms(self, m: Points, y: Points) -> Array:
        return self._between("_logarithms", m, y)

    def _between(self, method: str, y0: ArrayLike, y1: ArrayLike) -> Array:
        points = np.broadcast_arrays(self._points(y0, "y0"), self._points(y1, "y1"))
        return self._joined(method, *map(self._split, points))

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        return self._joined("coordinate_sizes", self._split(self._points(y)))

    def _project(self, y: Points) -> Points:
        return self._join(self._each("project", self._split(y)))

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the largest of the factors' membership errors, shape ``(...)``."""
        return np.asarray(self._numbers("membership_error", self._points(y)).max(axis=-1))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the largest of the factors' relative errors, shape ``(...)``."""
        return np.asarray(self._numbers("relative_error", self._points(y)).max(axis=-1))

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the root of the sum of the factors' squared distances, shape ``(...)``."""
        distances = self._numbers("distance", self._points(x, "x"), self._points(y))
        return np.asarray(np.linalg.norm(distances, axis=-1))


@dataclass(frozen=True, init=False)
class Product(Composite):
    """A product of manifolds, each with its own frame.

    A point is one flat real vector: the points of the factors, each raveled in C order, joined
    in the order of the factors; a complex entry becomes its real and its imaginary part. The
    coefficients are joined likewise.

    Parameters
    ----------
    *factors
        At least one frame; products may be nested.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Product(cg.frames.SO3(), cg.frames.Euclidean(3))
    >>> frame.dim, frame.point_shape
    (6, (12,))
    """

    factors: tuple[Frame, ...]
    _vector_slices: tuple[slice, ...] = field(init=False, compare=False)
    _point_slices: tuple[slice, ...] = field(init=False, compare=False)
    _point_shape: tuple[int] = field(init=False, compare=False)
    _parts: tuple[tuple[slice, tuple[int, ...], bool], ...] = field(init=False, compare=False)

    def __init__(self, *factors: Frame) -> None:
        if not factors:
            raise ValueError("factors must hold at least one frame, got none")
        for index, factor in enumerate(factors):
            check_frame(factor, f"factors[{index}]")
        slices = _slices(map(real_size, factors))
        kinds = [(factor.point_shape, factor.dtype.kind == "c") for factor in factors]
        vars(self).update(
            factors=factors, _vector_slices=_slices(f.dim for f in factors), _point_slices=slices,
            _point_shape=(slices[-1].stop,),
            _parts=tuple((entries, *kind) for entries, kind in zip(slices, kinds, strict=True)),
        )  # fmt: skip

    def __repr__(self) -> str:
        return f"Product({', '.join(map(repr, self.factors))})"

    @property
    def dim(self) -> int:
        return int(self._vector_slices[-1].stop)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self._point_shape

    def split(self, y: ArrayLike) -> tuple[Points, ...]:
        """Return the factors' points, the i-th of shape ``(..., *factors[i].point_shape)``.

        They are views of ``y`` if it is an array of doubles, contiguous along its last axis, and
        can be written to if ``y`` can.
        """
        # f calls this method at each stage: a single point needs no other check.
        if is_array(y, np.float64) and y.shape == self._point_shape:
            return self._split(y)
        return self._split(self._points(y))

    def join(self, *parts: ArrayLike) -> Array:
        """Return the flat point, shape ``(..., n)``, of one point of every factor."""
        if len(parts) != len(self.factors):
            raise ValueError(f"parts must be {len(self.factors)} points, got {len(parts)}")
        # f that returns derivatives joins them at each stage: single points need no other check.
        for part, (_, shape, is_complex) in zip(parts, self._parts, strict=True):
            if is_complex or not is_array(part, np.float64) or part.shape != shape:
                break
        else:
            return np.concatenate(parts, axis=None)
        names = [f"parts[{index}]" for index in range(len(parts))]
        return self._join(self._each("_points", parts, names))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the factors' coordinates, joined; None if a factor has none."""
        points = self._split(self._points(y0, "y0")), self._split(self._points(y1, "y1"))
        vectors = self._each("exp_coordinates", *points)
        return None if any(v is None for v in vectors) else self._join_vectors(vectors)

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        return self._joined("coordinate_sizes", self.split(y))  # by the fast path, at each step

    def turning_coefficients(self) -> Array:
        return self._joined("turning_coefficients")

    @cached_property
    def jointed(self) -> bool:
        return any(factor.jointed for factor in self.factors)

    def _composed(self, flows: Array) -> Array:
        return self._joined("_composed", self._split_vector(flows))

    def _each(self, method: str, *arguments: Iterable[Any], **options: Any) -> list[Any]:
        pairs = zip(self.factors, *arguments, strict=True)
        return [getattr(factor, method)(*own, **options) for factor, *own in pairs]

    def _blocks(self) -> Blocks | None:
        blocks: Blocks = ()
        for factor in self.factors:
            if (factor_blocks := factor.compiled_blocks()) is None:
                return None
            blocks += factor_blocks
        # Compiled code measures errors either in coordinates or in entries, for all blocks.
        mixed = len({compared_by_entries((block,)) for block in blocks}) > 1
        return None if mixed else blocks

    def for_derivatives(self) -> Frame:
        factors = [factor.for_derivatives() for factor in self.factors]
        moved = Product(*factors) if type(self) is Product else self
        return self if moved.compiled_blocks() is None else moved

    def _coefficients_at(self, y: Array, tangent: Array) -> Array:
        return self._joined("_coefficients_at", self._split(y), self._split(tangent))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return random points of the factors, joined: shape ``(*size, n)``."""
        return self.join(*(factor.random_point(rng, size) for factor in self.factors))

    def random_vector(self, rng: np.random.Generator, size: Size = ()) -> Array:
        return self._join_vectors([factor.random_vector(rng, size) for factor in self.factors])

    def _split_vector(self, vector: Array) -> list[Array]:
        return [vector[..., entries] for entries in self._vector_slices]

    def _join_vectors(self, vectors: list[Array]) -> Array:
        return np.concatenate(vectors, axis=-1)

    def _split(self, point: Array) -> tuple[Points, ...]:
        lead, points = point.shape[:-1], []
        for own, shape, is_complex in self._parts:
            entries = point[..., own]
            if is_complex:
                if entries.strides[-1] != entries.itemsize:
                    entries = np.ascontiguousarray(entries)
                entries = entries.view(np.complex128)
            points.append(entries.reshape(lead + shape))
        return tuple(points)

    def _join(self, points: Sequence[Points]) -> Array:
        leads = [
            point.shape[: point.ndim - len(factor.point_shape)]
            for factor, point in zip(self.factors, points, strict=True)
        ]
        lead = leads[0]
        if len(set(leads)) > 1:
            try:
                lead = np.broadcast_shapes(*leads)
            except ValueError:
                raise ValueError(
                    f"parts must have leading axes that broadcast, got {sorted(set(leads))}"
                ) from None
        joined = np.empty(lead + self._point_shape)
        for place, point in zip(self._split(joined), points, strict=True):
            place[...] = point
        return joined


def real_size(factor: Frame) -> int:
    """Return the number of real numbers in a point."""
    return prod(factor.point_shape) * (2 if factor.dtype.kind == "c" else 1)


def _slices(lengths: Iterable[int]) -> tuple[slice, ...]:
    return tuple(slice(*ends) for ends in pairwise(accumulate(lengths, initial=0)))


@dataclass(frozen=True, repr=False)
class Power(Composite):
    """The product of n equal frames, for n spins, links of a lattice or bodies.

    Unlike those of `Product`, points keep their shape, and all flows are computed in one batch.

    Parameters
    ----------
    factor
        The frame of each point.
    n
        Number of factors, at least 1.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> spins = cg.frames.Power(cg.frames.Sphere(2), 100)
    >>> spins.dim, spins.point_shape
    (300, (100, 3))
    >>> y = np.tile([0.0, 0.0, 1.0], (100, 1))
    >>> spins.flow(np.tile([np.pi / 2, 0.0, 0.0], 100), y)[99].round(15) + 0.0
    array([ 0., -1.,  0.])
    """

    factor: Frame
    n: int

    def __post_init__(self) -> None:
        check_frame(self.factor, "factor")
        object.__setattr__(self, "n", check_integer("n", self.n, 1))

    @property
    def dim(self) -> int:
        return self.n * self.factor.dim

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, *self.factor.point_shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.factor.dtype

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and whatever else the factor takes for a stack of points."""
        return self.factor.read_points(value, name)

    def for_derivatives(self) -> Frame:
        return Power(self.factor.for_derivatives(), self.n)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        rows = (x.reshape(-1, *self.factor.point_shape) for x in (y, tangent))
        return self.factor._coefficients_at(*rows).reshape(-1, self.dim)

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the coordinates of all points, ``(..., dim)``; None if the factor has none."""
        v = self.factor.exp_coordinates(self._points(y0, "y0"), self._points(y1, "y1"))
        return None if v is None else self._join_vectors(v)

    def turning_coefficients(self) -> Array:
        return np.tile(self.factor.turning_coefficients(), self.n)

    @property
    def jointed(self) -> bool:
        return self.factor.jointed

    def _composed(self, flows: Array) -> Array:
        by_factor = self._split_vector(flows).swapaxes(0, 1)
        return np.concatenate([self.factor._composed(own) for own in by_factor])

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return random points, shape ``(*size, n, *factor.point_shape)``."""
        return self.factor.random_point(rng, (*check_random(rng, size), self.n))

    def _blocks(self) -> Blocks | None:
        blocks = self.factor.compiled_blocks()
        return None if blocks is None else blocks * self.n

    def _split_vector(self, vector: Array) -> Array:
        """Return the coefficients of each point, shape ``(..., n, factor.dim)``."""
        return vector.reshape(*vector.shape[:-1], self.n, self.factor.dim)

    def _each(self, method: str, *arguments: Points, **options: Any) -> Any:
        return getattr(self.factor, method)(*arguments, **options)

    def _join_vectors(self, vectors: Array) -> Array:
        return np.asarray(vectors.reshape(*vectors.shape[:-2], self.dim))
