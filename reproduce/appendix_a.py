"""Appendix A of the paper: its printed coefficients beside those of the catalogue."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib.resources import files

import numpy as np
from scipy.optimize import linprog

from cg import conditions
from cg.construction.catalogue import methods
from cg.construction.methods.tableau import Tableau

_SOLVED = 1e-5  # units of the last place, to which conditions are to hold


@dataclass(frozen=True)
class Printed:
    """A method as the paper prints it, digit for digit, with the strictly lower rows of a."""

    name: str
    a: tuple[tuple[str, ...], ...]
    b: tuple[str, ...]
    c: tuple[str, ...]

    def labelled(self) -> Iterator[tuple[str, str]]:
        """Yield every coefficient's label, such as ``a_3,2``, and its printed digits."""
        for i, row in enumerate(self.a, 1):
            for j, entry in enumerate(row, 1):
                yield f"a_{i},{j}", entry
        for letter, numbers in (("b", self.b), ("c", self.c)):
            for i, entry in enumerate(numbers, 1):
                yield f"{letter}_{i}", entry


@dataclass(frozen=True)
class Comparison:
    """One printed coefficient beside the exact value of the catalogue.

    The value for c is the exact sum of a row of a.
    """

    label: str
    printed: str
    ours: Fraction

    @property
    def difference(self) -> Fraction:
        """Ours minus the paper's, exactly."""
        return self.ours - Fraction(self.printed)

    @property
    def units(self) -> float:
        """The difference in units of the last printed place."""
        places = len(self.printed.partition(".")[2])
        return float(self.difference * 10**places)

    @property
    def kept_zero(self) -> bool:
        """Whether ours is an exact zero wherever the paper prints one."""
        return Fraction(self.printed) != 0 or self.ours == 0


@cache
def printed() -> dict[str, Printed]:
    """Return the methods of Appendix A by name, in the paper's order."""
    text = files(__package__).joinpath("appendix_a.toml").read_text(encoding="utf-8")
    return {
        name: Printed(name, tuple(map(tuple, entry["a"])), tuple(entry["b"]), tuple(entry["c"]))
        for name, entry in tomllib.loads(text).items()
    }


def compare(name: str, method: Tableau | None = None) -> tuple[Comparison, ...]:
    """Set every printed coefficient of CG4a, CG5a or CG6a beside that of a method.

    The method is by default the one of this name in the catalogue. The order is a row by row, then
    b, then c. KeyError if the paper has no such method; ValueError if the numbers of stages differ.
    """
    paper = printed()[name]
    compared = methods[name] if method is None else method
    assert isinstance(compared, Tableau)
    if compared.stages != len(paper.b):
        raise ValueError(f"method must have {len(paper.b)} stages, got {compared.stages}")
    a, b = compared.exact
    ours = [entry for i, row in enumerate(a) for entry in row[:i]] + [*b, *map(sum, a)]
    return tuple(
        Comparison(label, digits, Fraction(value))
        for (label, digits), value in zip(paper.labelled(), ours, strict=True)
    )


def nearest_exact(name: str, method: Tableau | None = None, *, truncated: bool) -> float:
    """Return by how much, at least, exact methods differ from printed coefficients.

    This is the largest difference of a coefficient from the middle of what is truncated, or else
    rounded, to the printed digits, in units of the last place: up to 0.5 where printed digits may
    be those of an exact method. It is computed to first order, by linear programming; zeros are
    kept. `name` is CG4a or CG5a, `method` has printed coefficients, by default the paper's.
    """
    paper = printed()[name]
    digits = Tableau(paper.a, paper.b) if method is None else method
    order, unit = methods[name].order, Fraction(1, 10**16)
    x = np.array([float(entry.value) for entry in digits.coefficients])
    exact = conditions.residuals(digits, order, arithmetic="exact")
    residuals = np.array([float(r / unit) for r in exact])
    slopes = conditions.jacobian(digits.layout, x, order, independent=False)
    middle = 0.5 * np.sign(x) if truncated else np.zeros_like(x)
    # least d such that |step - middle| <= d and |residuals + slopes step| is next to nothing
    ones, nothing = np.ones((x.size, 1)), np.zeros((residuals.size, 1))
    left = np.block(
        [[np.eye(x.size), -ones], [-np.eye(x.size), -ones], [slopes, nothing], [-slopes, nothing]]
    )
    right = np.concatenate([middle, -middle, _SOLVED - residuals, _SOLVED + residuals])
    bounds = [*((None, None) if entry else (0.0, 0.0) for entry in x), (0.0, None)]
    solution = linprog(np.eye(x.size + 1)[-1], A_ub=left, b_ub=right, bounds=bounds)
    assert solution.fun is not None
    return float(solution.fun)
