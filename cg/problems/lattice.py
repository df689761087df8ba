"""Periodic lattices with a matrix on each link, and the products of links around plaquettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Points
from cg.support.checks import check_integer

_Indices = NDArray[np.intp]


class Staples(NamedTuple):
    """Which links close the plaquettes that begin with a link, all of shape ``(turns, links)``.

    To one side they are ``first @ second.adjoint @ third.adjoint``, to the other
    ``back_first.adjoint @ back_second.adjoint @ back_third``.
    """

    first: _Indices
    second: _Indices
    third: _Indices
    back_first: _Indices
    back_second: _Indices
    back_third: _Indices


@dataclass(frozen=True)
class Lattice:
    """Sites on a torus, and links from each site one step along each axis.

    Sites are counted in C order, the last axis fastest; links by their axis, then by the site
    where they start.

    Parameters
    ----------
    sides
        How many sites there are along each axis, two or more axes.

    Raises
    ------
    ValueError
        If ``sides`` aren't two or more positive integers.
    """

    sides: tuple[int, ...]

    def __post_init__(self) -> None:
        sides: Any = self.sides
        if not isinstance(sides, Sequence) or isinstance(sides, str) or len(sides) < 2:
            raise ValueError(f"sides must be two or more positive integers, got {sides!r}")
        checked = tuple(check_integer(f"sides[{i}]", n, 1) for i, n in enumerate(sides))
        object.__setattr__(self, "sides", checked)

    @property
    def sites(self) -> int:
        """Number of sites."""
        return prod(self.sides)

    @property
    def links(self) -> int:
        """Number of links."""
        return len(self.sides) * self.sites

    @cached_property
    def ends(self) -> tuple[_Indices, _Indices]:
        """The sites where the links start and where they end, each of shape ``(links,)``."""
        start = np.tile(np.arange(self.sites), len(self.sides))
        return start, np.concatenate([self._moved(axis, 1) for axis in range(len(self.sides))])

    @cached_property
    def staples(self) -> Staples:
        """The links that close the plaquettes; those of a link are one for each other axis."""
        d = len(self.sides)
        parts: list[list[list[_Indices]]] = [[[] for _ in range(d)] for _ in range(6)]
        for along, across in permutations(range(d), 2):
            here = np.arange(self.sites)
            ahead, beside = self._moved(along, 1), self._moved(across, 1)
            behind = self._moved(across, -1)
            corner = ahead[behind]
            own, other = along * self.sites, across * self.sites
            found = (
                other + ahead,
                own + beside,
                other + here,
                other + corner,
                own + behind,
                other + behind,
            )
            for part, links in zip(parts, found, strict=True):
                part[along].append(links)
        return Staples(*(np.concatenate([np.stack(p) for p in part], axis=1) for part in parts))

    def loops(self, y: Points) -> Points:
        """Return the sums of the plaquettes that begin with each link.

        Parameters
        ----------
        y
            Unitary matrices on the links, shape ``(..., links, n, n)``.

        Returns
        -------
        ndarray
            Shape ``(..., links, n, n)``.

        Raises
        ------
        ValueError
            If there isn't a matrix for each link.
        """
        if y.ndim < 3 or y.shape[-3] != self.links:
            raise ValueError(f"y must have shape (..., {self.links}, n, n), got {y.shape}")
        adjoint = y.mT.conj()
        at = self.staples
        forward = y[..., at.first, :, :] @ adjoint[..., at.second, :, :]
        forward = forward @ adjoint[..., at.third, :, :]
        back = adjoint[..., at.back_second, :, :] @ y[..., at.back_third, :, :]
        back = adjoint[..., at.back_first, :, :] @ back
        return np.asarray(y @ (forward + back).sum(axis=-4))

    def _moved(self, axis: int, steps: int) -> _Indices:
        """Return for each site the one that is some steps further along an axis."""
        sites = np.arange(self.sites).reshape(self.sides)
        return np.roll(sites, -steps, axis).ravel()
