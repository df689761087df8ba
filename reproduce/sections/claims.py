"""Every result that the paper claims, with a verdict that numbers decide."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from .. import judges, top
from ..blocks import Block, Data, Table, Text
from ..context import Context
from ..evidence import gather
from ..item import Item

__all__ = ["CLAIMS", "ITEMS", "NEEDS", "Claim", "compute", "present"]

NEEDS = (
    "table3.2", "appendix", "fig4.1", "fig4.2", "fig4.2quad", "search4", "search5", "search6",
)  # fmt: skip


@dataclass(frozen=True)
class Claim:
    """A result that the paper claims.

    Attributes
    ----------
    section : str
        Where it says so.
    text : str
        In our words.
    judge : callable
        From the numbers of `evidence.gather` and the results of all items to a verdict.
    """

    section: str
    text: str
    judge: Callable[[Data, judges.Results], judges.Verdict]


CLAIMS = (
    Claim(
        "Abstract",
        "Levenberg–Marquardt solves the order conditions: order four.",
        partial(judges.solved, 4),
    ),
    Claim("Abstract", "The same for order five.", partial(judges.solved, 5)),
    Claim(
        "Abstract", "An example of order four is given.", partial(judges.catalogue_order, 4, "CG4a")
    ),
    Claim(
        "Abstract", "An example of order five is given.", partial(judges.catalogue_order, 5, "CG5a")
    ),
    Claim(
        "Abstract",
        "An example of order six is given (approximately so, as later sections say).",
        partial(judges.catalogue_order, 6, "CG6a"),
    ),
    Claim(
        "Abstract, 3.2",
        "Experiments confirm the expected order: four.",
        partial(judges.slope, 4, "CG4a"),
    ),
    Claim(
        "Abstract, 3.2",
        "Experiments confirm the expected order: five.",
        partial(judges.slope, 5, "CG5a"),
    ),
    Claim("Abstract, 3.2", "Experiments confirm the expected order: six.", judges.slope_six),
    Claim(
        "1",
        "General solvers lose invariants: they drift from constraints and from unitarity.",
        judges.beyond("these are results of other papers about other problems"),
    ),
    Claim(
        "1",
        "With the coordinate frame the methods are the classical Runge–Kutta methods.",
        judges.flat,
    ),
    Claim(
        "1, 2", "Solutions stay on the manifold: the methods are geometrically exact.", judges.exact
    ),
    Claim(
        "1",
        "Crouch and Grossman had a method of order three.",
        partial(judges.catalogue_order, 3, "CG3"),
    ),
    Claim(
        "1",
        "Owren and Marthinsen had an explicit method of order four.",
        partial(judges.catalogue_order, 4, "CG4"),
    ),
    Claim("1", "These were the first of their kind.", judges.beyond("priority isn't a number")),
    Claim(
        "1",
        "Munthe-Kaas has a method of order four, and carries over all classical ones.",
        judges.beyond("these methods are of another kind than those computed here"),
    ),
    Claim(
        "1",
        "No method of order six was obtained by this approach, only approximations.",
        judges.no_zero,
    ),
    Claim(
        "2",
        "A method has order q if Φ(t) = 1/γ(t) for all ordered trees with 2 to q + 1 nodes.",
        judges.theorem,
    ),
    Claim("3.1", "The tree tables can be generated for arbitrarily high order.", judges.trees),
    Claim("3.1", "The order conditions are not all independent.", judges.independence),
    Claim("3.1", "An integer table has zeros for the trees that can be discarded.", judges.zeros),
    Claim(
        "3.2",
        "Many starts reduce f to about 1e−15 in double: order four.",
        partial(judges.double, 4),
    ),
    Claim(
        "3.2",
        "Many starts reduce f to about 1e−15 in double: order five.",
        partial(judges.double, 5),
    ),
    Claim(
        "3.2", "The system of order six seems to be very ill-conditioned.", judges.ill_conditioned
    ),
    Claim("3.2", "At order six f can be reduced to about 1e−6 in double …", judges.six_reached),
    Claim("3.2", "… and no further.", judges.six_no_further),
    Claim(
        "3.2",
        "Extended precision usually reduces f to about 1e−31: order four.",
        partial(judges.usually, 4, 1e-31),
    ),
    Claim(
        "3.2",
        "Extended precision usually reduces f to about 1e−31: order five.",
        partial(judges.usually, 5, 1e-31),
    ),
    Claim(
        "3.2",
        "Extended precision usually reduces f to about 1e−8: order six.",
        partial(judges.usually, 6, 1e-8),
    ),
    Claim("3.2", "Table of q, s, n, N_CG and N_RK.", judges.table),
    Claim("3.2", "Many methods of order four were found.", partial(judges.many, 4)),
    Claim("3.2", "Many methods of order five were found.", partial(judges.many, 5)),
    Claim(
        "1, 3.2, 4",
        "CG6a satisfies the conditions to six or seven digits: the typical condition.",
        judges.typical_digits,
    ),
    Claim("1, 3.2, 4", "The same: every condition.", judges.all_digits),
    Claim("3.2", "The examples have moderately sized coefficients.", judges.moderate),
    Claim(
        "3.2", "The abscissae of the example of order four lie in [0, 1].", judges.in_unit_interval
    ),
    Claim("4", "B is orthogonal with determinant one.", judges.initial),
    *(
        Claim("4", f"CG4a is superior to CG4; ω(0) a {r}.", partial(judges.superior, r))
        for r in top.READINGS
    ),
    *(
        Claim(
            "4",
            f"At h = 0.1 CG6a is significantly better than the others; ω(0) a {r}.",
            partial(judges.best_at_tenth, r),
        )
        for r in top.READINGS
    ),
    Claim("4", "The slope of CG4a is four.", partial(judges.slope, 4, "CG4a")),
    Claim("4", "The slope of CG5a is five.", partial(judges.slope, 5, "CG5a")),
    Claim(
        "4",
        "CG6a's graph shows that its conditions are satisfied only approximately.",
        judges.slope_approximate,
    ),
    *(
        Claim(
            "A",
            f"The printed coefficients of {name} are a solution's.",
            partial(judges.agrees, name),
        )
        for name in ("CG4a", "CG5a")
    ),
    *(
        Claim(
            "A",
            f"All coefficients are truncated to 16 decimals: {name}.",
            partial(judges.truncated, name),
        )
        for name in ("CG4a", "CG5a", "CG6a")
    ),
)
"""In the order of the paper."""


def compute(context: Context) -> Data:
    """Judge all claims.

    Returns
    -------
    Data
        ``claims``, each with ``section``, ``claim`` in our words, ``verdict`` ("pass", "fail" or
        "not reproducible") and ``evidence``; ``count`` by verdict; ``numbers`` that only claims
        need, see `evidence.gather`.
    """
    numbers = gather(context.settings.seed)
    judged = []
    for done, claim in enumerate(CLAIMS):
        context.progress(done, len(CLAIMS))
        passed, evidence = claim.judge(numbers, context.results)
        verdict = "not reproducible" if passed is None else "pass" if passed else "fail"
        judged.append(
            {
                "section": claim.section,
                "claim": claim.text,
                "verdict": verdict,
                "evidence": evidence,
            }
        )
    total = Counter(entry["verdict"] for entry in judged)
    names = ("pass", "fail", "not reproducible")
    return {"claims": judged, "count": {name: total[name] for name in names}, "numbers": numbers}


def present(data: Data) -> Sequence[Block]:
    """Tabulate the verdicts."""
    total = data["count"]
    rows = [
        [entry["section"], entry["claim"], entry["verdict"], entry["evidence"]]
        for entry in data["claims"]
    ]
    return (
        Text(
            "The results that the paper claims, from the abstract to the appendix, in our words. "
            "A verdict is decided by the numbers beside it, which this run computed: "
            f"{total['pass']} pass, {total['fail']} fail, {total['not reproducible']} are not "
            "reproducible, for the reason given."
        ),
        Table("Claims", ("section", "claim", "verdict", "evidence"), rows, numeric=False),
    )


ITEMS = (Item("claims", "What the paper claims", 90, 10, compute, present, NEEDS),)
