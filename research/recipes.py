"""What programs that make methods share: a measure, texts of coefficients, the command line."""

import sys
import time
from collections.abc import Callable, Collection, Iterable
from decimal import Decimal, localcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cg.construction.candidate import Candidate
from cg.construction.catalogue import save
from cg.construction.methods.method import Method


def merit(candidate: Candidate) -> float:
    """Return the principal error, more where coefficients or abscissae are large."""
    layout = candidate.system.layout
    sums = np.array([candidate.x[layout.row(k)].sum() for k in range(layout.stages)])
    outside = max(0.0, sums.max() - 1) + max(0.0, -sums.min())
    large = max(0.0, candidate.largest - 1.5)
    return float(candidate.principal_error * (1 + large + 2 * outside))


def texts(row: Iterable[Fraction]) -> list[str]:
    """Return fractions with short denominators as they are, and other numbers with 36 places."""
    short = [(x, x.limit_denominator(999)) for x in row]
    with localcontext(prec=60):
        return [
            str(near)
            if abs(near - x) < Fraction(1, 10**34)
            else f"{Decimal(x.numerator) / x.denominator:.36f}"
            for x, near in short
        ]


def run(make: Callable[[str], Method], names: Collection[str], usage: str | None) -> None:
    """Make methods, write each to a file in a folder, and print a summary of each.

    `names` are all names, made if the command line has none; it must have a folder, or `usage` is
    printed.
    """
    if len(sys.argv) < 2:
        raise SystemExit(usage)
    folder, chosen = Path(sys.argv[1]), sys.argv[2:]
    if unknown := sorted(set(chosen) - set(names)):
        raise SystemExit(f"no recipe for {', '.join(unknown)}; there are {', '.join(names)}")
    folder.mkdir(parents=True, exist_ok=True)
    with threadpool_limits(1):
        for name in chosen or names:
            begin = time.process_time()
            method = make(name)
            save(method, folder / f"{name}.toml")
            second = f"({method.embedded_order})" if method.embedded_order else ""
            largest = max(abs(float(entry.value)) for entry in method.coefficients)
            print(
                f"{name}: order {method.order}{second}, {method.stages} stages, "
                f"{method.exponentials} exponentials, largest coefficient {largest:.4f}, principal "
                f"error {method.principal_error:.4g}; {time.process_time() - begin:.0f} s",
                flush=True,
            )
