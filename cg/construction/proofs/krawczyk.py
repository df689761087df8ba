"""Krawczyk's test: a zero of a system exists, and is unique, in a box.

Let f have m equations in m unknowns that may move (`movable`), y be a point, X the box ``y ± r``,
J(X) an enclosure of the derivatives on X and A any matrix. If

    |A f(y)|_i + r Σ_j |I - A J(X)|_ij < r   for all i,

then f has exactly one zero in X: ``z ↦ z - A f(z)`` maps X into its interior and A J is
regular on X (Krawczyk 1969; Neumaier, Interval Methods for Systems of Equations, 1990,
Theorem 5.1.8). The map contracts the box by the factor κ, the largest row sum, so that the zero is
within ``|A f(z)| / (1 - κ)`` of any z in X, in the maximum norm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.proofs.certificate import CertificationError
from cg.construction.proofs.packed import Equations, Linearised
from cg.support import flint

RANK_THRESHOLD = 1e-12
"""Singular values below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class KrawczykTest:
    """Result of Krawczyk's test of a box of some radius."""

    radius: flint.arb
    ratio: float  # bound of the image's radius in units of `radius`; below 1 the zero is proved
    correction: float  # upper bound of max |A f(y)|
    contraction: float  # upper bound of the maximum norm of I - A J(X)
    inverse: flint.arb_mat | None = None  # A

    @property
    def proved(self) -> bool:
        """Whether the zero is proved."""
        return self.ratio < 1

    @property
    def quantities(self) -> dict[str, float]:
        """The quantities of the test, for messages."""
        names = "radius", "ratio", "correction", "contraction"
        return {name: float(getattr(self, name)) for name in names}


def doubles(vectors: Iterable[Sequence[flint.arb]]) -> NDArray[np.float64]:
    """Return the midpoints of vectors of balls, such as the rows of a matrix."""
    return np.array([[float(x) for x in vector] for vector in vectors])


def numerical_rank(jacobian: NDArray[np.float64]) -> tuple[int, NDArray[np.float64]]:
    """Return how many singular values aren't negligible, and all of them."""
    values = linalg.svdvals(jacobian)
    return int(np.sum(values > RANK_THRESHOLD * values[0])), values


def choose_movable(jacobian: NDArray[np.float64], candidates: Sequence[int]) -> list[int]:
    """Choose as many of the candidates as there are equations, by QR with column pivoting."""
    indices = np.array(candidates)
    pivots = linalg.qr(jacobian[:, indices], mode="r", pivoting=True)[1]
    return sorted(int(k) for k in indices[pivots[: len(jacobian)]])


def krawczyk(
    system: Equations, y: Sequence[flint.arb], movable: Sequence[int],
    radius: flint.arb | None = None, *, at_point: Linearised | None = None,
) -> KrawczykTest:  # fmt: skip
    """Try to prove that m equations have a zero near y in the m unknowns `movable`.

    By default the radius is twice the size of the correction. `at_point` are the residuals and
    their derivatives at y, if they are known. If the derivatives aren't regular there, nothing is
    proved and the ratio is infinite.
    """
    values, slopes = system.linearise(y) if at_point is None else at_point
    columns = list(movable)
    unknown = flint.arb("inf") if radius is None else radius
    infinite = KrawczykTest(unknown, float("inf"), float("inf"), float("inf"))
    identity = flint.arb_mat(len(columns), len(columns), 1)
    try:
        middle = _take(slopes, columns).mid()
        inverse = middle.solve(identity, algorithm="approx").mid()
    except ZeroDivisionError:
        return infinite
    changes = (inverse * flint.arb_mat([[v] for v in values])).entries()
    steps = [abs(entry).upper() for entry in changes]
    correction = max_abs(steps)
    if not correction.is_finite():
        return infinite
    if radius is None:
        # the radius has two decimal digits, so that certificates state it exactly
        radius = flint.arb(f"{2.2 * float(correction) or 1e-300:.1e}")
    box = list(y)
    for k in columns:
        box[k] = y[k] + flint.arb(0, radius.upper())
    enclosure = _take(system.linearise(box)[1], columns)
    rows = (identity - inverse * enclosure).tolist()
    sums = [sum((abs(entry).upper() for entry in row), flint.arb(0)).upper() for row in rows]
    images = [
        (step / radius.lower() + total).upper() for step, total in zip(steps, sums, strict=True)
    ]
    bounds = _up(max_abs(images)), _up(correction), _up(max_abs(sums))
    return KrawczykTest(radius, *bounds, inverse)


def enclose_zero(
    system: Equations, y: Sequence[flint.arb], movable: Sequence[int], test: KrawczykTest,
    places: int,
) -> list[flint.arb]:  # fmt: skip
    """Return balls with radii below ``10**-places`` around the zero that a test at y proved.

    Repeats ``z ↦ z - A f(z)``: each step gains as many digits as A has, without new derivatives.
    """
    if test.inverse is None or not test.proved:
        raise CertificationError("no zero is proved", **test.quantities)
    z = list(y)
    for k in movable:
        z[k] = y[k].mid()
    target = flint.arb(10) ** -places
    last = flint.arb("inf")
    while True:
        changes = (test.inverse * flint.arb_mat([[v] for v in system.residuals(z)])).entries()
        distance = max_abs(changes) / (1 - flint.arb(test.contraction))
        if distance < target:
            for k in movable:
                z[k] = z[k] + flint.arb(0, distance.upper())
            return z
        if not 2 * distance < last:
            raise CertificationError(f"{places} places aren't proved", **test.quantities)
        last = distance
        for k, change in zip(movable, changes, strict=True):
            z[k] = (z[k] - change).mid()
            if not abs(z[k] - y[k]) < test.radius:
                raise CertificationError("the box doesn't contain its image", **test.quantities)


def max_abs(values: Sequence[flint.arb]) -> flint.arb:
    """Return an upper bound of the magnitudes of balls, infinity if one isn't finite."""
    bounds = [abs(value).upper() for value in values]
    if not all(bound.is_finite() for bound in bounds):
        return flint.arb("inf")
    return max(bounds, default=flint.arb(0))


def _up(value: flint.arb) -> float:
    """Round a bound up to a double."""
    return float(np.nextafter(float(value), np.inf))


def _take(matrix: flint.arb_mat, columns: Sequence[int]) -> flint.arb_mat:
    return flint.arb_mat([[row[k] for k in columns] for row in matrix.tolist()])
