"""The gradient flow of a lattice gauge field: many links in SU(3) at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from flint import acb, acb_mat, arb
from numpy.typing import ArrayLike, NDArray

from cg.frames import SU, Power
from cg.frames.arrays import Array, complex_array
from cg.problems.checks import ball, number
from cg.problems.extrapolation import State, extrapolated
from cg.problems.lattice import Lattice
from cg.problems.taylor import Reference, Time, exact_midpoint, exact_times
from cg.support.checks import check_integer

from ..support.balls import working_precision

_Links = NDArray[np.complex128]


@dataclass(frozen=True)
class GradientFlow:
    r"""The Wilson flow of a gauge field on a periodic lattice.

    Each link :math:`V_\mu(x)`, from the site :math:`x` one step along the axis :math:`\mu`, is a
    matrix in SU(3), and follows the gradient of the Wilson action,

    .. math::

        V_\mu' = Z_\mu V_\mu, \qquad
        Z_\mu = -\tfrac12 (P_\mu - P_\mu^*) + \tfrac16 \operatorname{tr}(P_\mu - P_\mu^*), \qquad
        S = \sum_{p} \operatorname{Re} \operatorname{tr} (1 - V_p),

    where :math:`P_\mu(x)` is the sum over the :math:`2(d - 1)` oriented plaquettes
    :math:`V_p` that begin with the link, and the sum in :math:`S` is over all plaquettes.  Time is
    that of [1]_, in units of the square of the lattice spacing.

    A point has one matrix a link, shape ``(links, 3, 3)``; `Lattice` tells their order.

    Parameters
    ----------
    sides
        How many sites the lattice has along each axis, two or more axes.
    roughness
        How far the links are from the identity at time zero: the deviation of the normal
        coefficients whose exponentials they are.
    seed
        Where those come from.

    Raises
    ------
    ValueError
        If ``sides`` aren't two or more positive integers, ``roughness`` isn't a finite number, or
        ``seed`` isn't an integer that is zero or more.

    References
    ----------
    .. [1] M. Lüscher, "Properties and uses of the Wilson flow in lattice QCD", JHEP 08 (2010) 071.

    Examples
    --------
    >>> import cg
    >>> problem = GradientFlow(sides=(2, 2))
    >>> run = cg.integrate(problem.f, (0, 1), problem.y0, frame=problem.frame, method="CF3", h=0.05)
    >>> bool(problem.action(run.y[-1]) < problem.action(problem.y0))
    True
    """

    sides: tuple[int, ...] = (2, 2, 2, 2)
    roughness: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sides", Lattice(self.sides).sides)
        object.__setattr__(self, "roughness", number(self.roughness, "roughness"))
        object.__setattr__(self, "seed", check_integer("seed", self.seed, 0))

    @cached_property
    def lattice(self) -> Lattice:
        """The sites and links."""
        return Lattice(self.sides)

    @cached_property
    def frame(self) -> Power:
        """A copy of ``SU(3)`` for each link."""
        return Power(SU(3), self.lattice.links)

    @property
    def y0(self) -> _Links:
        """The links at time zero, shape ``(links, 3, 3)``."""
        group = SU(3)
        return np.asarray(group.restore(group.exponential(self._logarithms)))

    @cached_property
    def _logarithms(self) -> Array:
        rng = np.random.default_rng(self.seed)
        return self.roughness * SU(3).random_vector(rng, self.lattice.links)

    def f(self, t: float, y: _Links) -> Array:
        r"""Return the coefficients of :math:`Z_\mu` for all links.

        Parameters
        ----------
        t
            Time; the equations don't depend on it.
        y
            Links, shape ``(..., links, 3, 3)``.

        Returns
        -------
        ndarray
            Shape ``(..., 8 * links)``.
        """
        loops = self.lattice.loops(y)
        # tr(B_k* M) of a basis with tr(B_j* B_k) = delta_jk / 2 is half the coefficient of the
        # anti-Hermitian part without trace.
        flat = loops.reshape(*loops.shape[:-2], 9)
        found = -2.0 * (flat @ _ADJOINTS).real
        return np.asarray(found.reshape(*found.shape[:-2], -1))

    def action(self, y: ArrayLike) -> Array:
        """Return the Wilson action, shape ``(...)``; the flow never lets it grow.

        Parameters
        ----------
        y
            Links, shape ``(..., links, 3, 3)``.
        """
        loops = self.lattice.loops(complex_array(y, "y"))
        # Each plaquette begins with each of its four links, in one of the two orientations.
        d = len(self.sides)
        plaquettes = self.frame.n * (d - 1) / 2
        traces = np.trace(loops, axis1=-2, axis2=-1).real.sum(axis=-1) / 4.0
        return np.asarray(3.0 * plaquettes - traces)

    def rotated(self, y: ArrayLike, gauge: ArrayLike) -> _Links:
        r"""Return the links after a gauge transformation, :math:`g(x) V_\mu(x) g(x + \mu)^*`.

        The flow commutes with it, and so does each step of each method of this package, to
        rounding.

        Parameters
        ----------
        y
            Links, shape ``(..., links, 3, 3)``.
        gauge
            One matrix a site, shape ``(sites, 3, 3)``.
        """
        links, g = complex_array(y, "y"), complex_array(gauge, "gauge")
        start, end = self.lattice.ends
        return np.asarray(g[start] @ links @ g[end].mT.conj())

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the determinants of the links, shape ``(..., links)``, which are one."""
        return {"determinant": np.asarray(np.linalg.det(self.frame._points(y)))}

    def reference(self, times: Sequence[Time], *, bits: int = 160) -> Reference:
        """Return the solution at given times in extended precision.

        The unknowns are the real and imaginary parts of the links' entries, in the order of
        memory.  It is an extrapolated midpoint rule in the space around, which knows nothing of
        frames.

        Raises
        ------
        ValueError
            If a time isn't a finite number.
        """
        wanted = exact_times(times)
        with working_precision(bits):
            start = [_exponential(v) for v in self._logarithms]
            rough = extrapolated(self._tangents, start, wanted, Fraction(1, 32), 14)
            good = extrapolated(self._tangents, start, wanted, Fraction(1, 40), 15)
            values = [[_entries(x) for x in state] for state in good]
            errors = [
                max(abs(float(x)) for a, b in zip(one, other, strict=True) for x in _entries(a - b))
                for one, other in zip(rough, good, strict=True)
            ]
        flat = tuple(tuple(x for entries in state for x in entries) for state in values)
        return Reference(wanted, flat, tuple(errors))

    @cached_property
    def _plaquettes(self) -> list[tuple[int, ...]]:
        """Links of each plaquette: two that lead from a site to the far corner, the others back."""
        at, d, n = self.lattice.staples, len(self.sides), self.lattice.sites
        found = []
        for link in range(self.lattice.links):
            axis = link // n
            # Those that turn to a later axis; the others are the same the other way round.
            for turn in range(axis, d - 1):
                found.append((link, *(int(part[turn, link]) for part in at[:3])))
        return found

    def _tangents(self, state: State) -> State:
        """Return the derivatives of all links in ball arithmetic."""
        adjoint = [_adjoint(x) for x in state]
        loops = [acb_mat(3, 3) for _ in state]
        for first, second, third, fourth in self._plaquettes:
            # Along two links to the far corner, and back along the other two
            loop = state[first] * state[second] * (adjoint[third] * adjoint[fourth])
            turned = _adjoint(loop)
            loops[first] += loop
            loops[fourth] += turned
            loops[second] += adjoint[first] * loop * state[first]
            loops[third] += adjoint[fourth] * turned * state[fourth]
        tangents = []
        for loop, link in zip(loops, state, strict=True):
            odd = (_adjoint(loop) - loop) / 2
            trace = odd.trace() / 3
            for i in range(3):
                odd[i, i] -= trace
            tangents.append(odd * link)
        return tangents


def _exponential(v: Array) -> acb_mat:
    """Return the exponential in SU(3) of the coefficients of one link."""
    root = arb(3).sqrt()
    x = [ball(c) / 2 for c in v.tolist()]
    diagonal = [x[2] + x[7] / root, -x[2] + x[7] / root, -2 * x[7] / root]
    upper = [acb(x[0], -x[1]), acb(x[3], -x[4]), acb(x[5], -x[6])]
    (a, b, c), (d, e, f) = diagonal, upper
    hermitian = acb_mat([[a, d, e], [d.conjugate(), b, f], [e.conjugate(), f.conjugate(), c]])
    return (hermitian * acb(0, -1)).exp().mid()


def _adjoint(x: acb_mat) -> acb_mat:
    return x.transpose().conjugate()


def _entries(x: acb_mat) -> list[Fraction]:
    """Return real and imaginary parts of all entries, as the exact values of their midpoints."""
    return [exact_midpoint(part) for z in x.entries() for part in (z.real, z.imag)]


_ADJOINTS = SU(3).basis.reshape(8, 9).conj().T.copy()
