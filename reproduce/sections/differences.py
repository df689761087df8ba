"""Differences from the paper, and choices that the paper leaves open."""

from collections.abc import Sequence

from cg import conditions
from cg.construction.catalogue import methods

from ..blocks import Block, Data, Table, Text, number
from ..context import Context, Item
from .search import PLANS


def compute(context: Context) -> Data:
    """Return ``differences``, each with ``what`` differs, the ``paper``'s way and ``ours``."""
    keys = ("what", "paper", "ours")
    rows = (*_algorithms(), *_search(), *_PROBLEM)
    return {"differences": [dict(zip(keys, row, strict=True)) for row in rows]}


def _algorithms() -> tuple[tuple[str, str, str], ...]:
    return (
        (
            "trees and their table",
            "a Maple program writes a Fortran subroutine",
            "a Python program does so when the package is built",
        ),
        (
            "lmdif",
            "MINPACK's subroutine",
            "the same algorithm in modern Fortran, one source for both precisions; tests compare "
            "it with MINPACK bit for bit in double, and with Debian's library for epsfcn equal to "
            "the machine epsilon of that library, which has twelve digits",
        ),
        (
            "dependent conditions",
            "zeros in the integer table",
            "the same; if fewer rows are left than unknowns, rows of zeros are appended, since "
            "lmdif requires at least as many equations as unknowns",
        ),
        (
            "f",
            "the displayed sum is over all trees",
            "over the independent ones, as in the table with its zeros: CG6a as printed has "
            f"{number(_square(independent=True), 2)}, over all {number(_square(), 2)}",
        ),
        ("extended precision", "the kind is not stated", "real(16), IEEE binary128 in software"),
    )


def _search() -> tuple[tuple[str, str, str], ...]:
    limits = "; ".join(
        f"order {order}: {plan.maxfev} in double, {plan.refine_maxfev} in real(16)"
        for order, plan in PLANS.items()
    )
    extent = "; ".join(
        f"order {order}: {plan.starts} starts, {plan.full_starts} with --full"
        for order, plan in PLANS.items()
    )
    refined = "; ".join(f"order {order}: f ≤ {p.refine_below:g}" for order, p in PLANS.items())
    return (
        (
            "random starts",
            "zufall.f of W. P. Petersen",
            "NumPy's PCG64 with a seed spawned for each start, so that each can be repeated alone "
            "and the number of threads does not matter",
        ),
        ("interval of starts", "not given", "uniform in [−1, 1], for every coefficient"),
        ("limit of evaluations", "not given", limits),
        ("starts refined in extended precision", "not given", refined),
        ("extent of the search", "“extensive”", extent),
    )


_PROBLEM = (
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


def _square(*, independent: bool = False) -> float:
    """Return the sum of squared residuals of CG6a."""
    residuals = conditions.residuals(
        methods["CG6a"], 6, independent=independent, arithmetic="exact"
    )
    return float(sum(r * r for r in residuals))


def present(data: Data) -> Sequence[Block]:
    """Tabulate them."""
    return (
        Text(
            "The report reproduces the paper's results by the paper's methods. This table lists "
            "where the methods differ, and what the paper does not specify."
        ),
        Table(
            "Differences",
            ("what", "the paper", "here"),
            [[row["what"], row["paper"], row["ours"]] for row in data["differences"]],
            numeric=False,
        ),
    )


ITEMS = (Item("differences", "What was done differently", 5, 15, compute, present),)
