"""What was done differently from the paper, and what the paper leaves open."""

from __future__ import annotations

from collections.abc import Sequence

from cg.catalogue import methods
from cg.conditions import exact_residuals_of

from ..blocks import Block, Data, Table, Text, number
from ..context import Context
from ..item import Item
from .search import PLANS

__all__ = ["ITEMS", "compute", "present"]


def compute(context: Context) -> Data:
    """List the differences.

    Returns
    -------
    Data
        ``differences``: a list of what differs, with the ``paper``'s way and ``ours``.
    """
    limits = "; ".join(
        f"order {order}: {plan.maxfev} in double, {plan.refine_maxfev} in real(16)"
        for order, plan in PLANS.items()
    )
    rows = (
        (
            "trees and their table",
            "a Maple program writes a Fortran subroutine",
            "a program in Python does, when the package is built",
        ),
        (
            "lmdif",
            "MINPACK's subroutine",
            "the algorithm written anew in modern Fortran, one source for both precisions; tests "
            "compare it with MINPACK bit for bit in double, with Debian's for an epsfcn of its "
            "own machine epsilon, which it has to twelve digits",
        ),
        (
            "dependent conditions",
            "zeros in the integer table",
            "the same; where fewer rows are left than unknowns, rows of zeros follow, since lmdif "
            "refuses fewer equations than unknowns and they change nothing",
        ),
        (
            "f",
            "the sum that is displayed is over all trees",
            "over the independent ones, as in the table with its zeros: CG6a as printed has "
            f"{number(_square(independent=True), 2)}, over all {number(_square(), 2)}",
        ),
        (
            "random starts",
            "zufall.f of W. P. Petersen",
            "NumPy's PCG64, with a seed spawned for each start, so that any of them can be "
            "repeated alone and the number of threads doesn't matter",
        ),
        (
            "interval of starts",
            "not given",
            "uniform in [−1, 1], for every coefficient",
        ),
        ("limit of evaluations", "not given", limits),
        (
            "extended precision",
            "of which kind isn't said",
            "real(16), IEEE binary128 in software",
        ),
        (
            "starts that go on to it",
            "not given",
            "; ".join(f"order {q}: f ≤ {plan.refine_below:g}" for q, plan in PLANS.items()),
        ),
        (
            "extent of the search",
            "“extensive”",
            "; ".join(
                f"order {q}: {plan.starts} starts, {plan.full_starts} with --full"
                for q, plan in PLANS.items()
            ),
        ),
        (
            "the top's inertia, mass, length",
            "not given; cited works are",
            "I = diag(7, 7, 2)/8, M = 1, g = 9.81, L = √3/2, an example of DiffMan",
        ),
        (
            "ω(0)",
            "called an angular momentum",
            "both an angular momentum and, as in that example, an angular velocity",
        ),
        (
            "reference solution",
            "not given",
            "Taylor series in ball arithmetic, without any method of the paper",
        ),
        (
            "flows on SO(3)",
            "not given",
            "products of unit quaternions between points, and a Newton–Schulz step at the end of "
            "a step; Figure 4.2 shows the distance without both as well",
        ),
    )
    return {"differences": [dict(zip(("what", "paper", "ours"), row, strict=True)) for row in rows]}


def _square(*, independent: bool = False) -> float:
    """Return the sum of squared residuals of CG6a."""
    residuals = exact_residuals_of(methods["CG6a"], 6, independent=independent)
    return float(sum(r * r for r in residuals))


def present(data: Data) -> Sequence[Block]:
    """Tabulate them."""
    return (
        Text(
            "The aim is the paper's results by the paper's way. Where the way isn't the same, or "
            "where the paper doesn't say what it was:"
        ),
        Table(
            "Differences",
            ("what", "the paper", "here"),
            [[row["what"], row["paper"], row["ours"]] for row in data["differences"]],
            numeric=False,
        ),
    )


ITEMS = (Item("differences", "What was done differently", 5, 15, compute, present),)
