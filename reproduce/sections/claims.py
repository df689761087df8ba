"""The results that the paper claims, each with a verdict and its evidence."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from .. import judges
from ..blocks import Block, Context, Data, Item, Table, Text
from ..evidence import gather

NEEDS = (
    "table3.2", "appendix", "fig4.1", "fig4.2", "fig4.2quad", "search4", "search5", "search6",
    "evaluations",
)  # fmt: skip

PASS, FAIL, NOT_REPRODUCIBLE = VERDICTS = ("pass", "fail", "not reproducible")


@dataclass(frozen=True)
class Claim:
    """A result that a section of the paper claims, in our words.

    `judge` returns a verdict for the numbers of `evidence.gather` and the results of all items;
    `interpretation` is ours, if the claim fails. `default_verdict` is that of a run with default
    settings, for the documentation; a test compares it with that of the judge.
    """

    section: str
    text: str
    judge: Callable[[Data, judges.Results], judges.Verdict]
    interpretation: str = ""
    default_verdict: str = PASS


CLAIMS = (
    *(
        Claim(
            "Abstract, 3.2",
            f"Many methods of order {word} (one in a thousand starts or more) were found by "
            "Levenberg–Marquardt from random starts.",
            partial(judges.many, order),
        )
        for order, word in ((4, "four"), (5, "five"))
    ),
    *(
        Claim(
            "Abstract, A",
            f"An example of order {word} is given, {name}.",
            partial(judges.example, order, name),
        )
        for order, word, name in ((4, "four", "CG4a"), (5, "five", "CG5a"))
    ),
    Claim(
        "Abstract",
        "An example of order six is given, CG6a.",
        partial(judges.catalogue_order, 6, "CG6a"),
        "The abstract counts CG6a with the others; Sections 1 and 3.2 of the paper describe it "
        "correctly as coefficients that satisfy the conditions approximately. Strictly its order "
        "is zero, since its weights do not add up to 1.",
        FAIL,
    ),
    *(
        Claim(
            "Abstract, 3.2, 4",
            f"Experiments confirm the expected order: {word}, the slope of {name}.",
            partial(judges.slope, order, name),
        )
        for order, word, name in ((4, "four", "CG4a"), (5, "five", "CG5a"))
    ),
    Claim(
        "Abstract, 3.2",
        "Experiments confirm the expected order: six.",
        judges.slope_six,
        "The abstract and Section 3.2 claim this for all three examples; it holds for two. For "
        "CG6a, Section 4 of the paper says that its conditions are satisfied only approximately.",
        FAIL,
    ),
    Claim(
        "1",
        "General solvers lose invariants: they drift from constraints and from unitarity.",
        judges.drift,
    ),
    Claim(
        "1",
        "With the coordinate frame the methods are the classical Runge–Kutta methods.",
        judges.flat,
    ),
    Claim(
        "1, 2, 4",
        "Solutions stay on the manifold: the methods are geometrically exact.",
        judges.exact,
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
    Claim(
        "1",
        "These were the first of their kind.",
        lambda numbers, results: (None, "not reproducible because priority is not a number"),
        default_verdict=NOT_REPRODUCIBLE,
    ),
    Claim(
        "1",
        "Munthe-Kaas has a method of order four, and carries over all classical ones.",
        partial(judges.theorem, "Munthe-Kaas"),
    ),
    Claim(
        "1",
        "No method of order six was obtained by this approach, only approximations.",
        judges.no_zero,
    ),
    Claim(
        "2",
        "A method has order q if Φ(t) = 1/γ(t) for all ordered trees with 2 to q + 1 nodes.",
        partial(judges.theorem, "explicit"),
    ),
    Claim(
        "2",
        "The same condition gives implicit methods (2.3) order q.",
        partial(judges.theorem, "implicit"),
    ),
    Claim("3.1", "The tree tables can be generated for arbitrarily high order.", judges.trees),
    Claim("3.1", "The order conditions are not all independent.", judges.independence),
    Claim("3.1", "An integer table has zeros for the trees that can be discarded.", judges.zeros),
    *(
        Claim(
            "3.2",
            f"Many starts (one in a thousand or more) reduce f to about 1e−15 in double: order "
            f"{word}.",
            partial(judges.double, order, 1e-15),
        )
        for order, word in ((4, "four"), (5, "five"))
    ),
    Claim(
        "3.2", "The system of order six seems to be very ill-conditioned.", judges.ill_conditioned
    ),
    Claim(
        "3.2",
        "At order six f can be reduced to about 1e−6 in double …",
        partial(judges.double, 6, 1e-6),
    ),
    Claim(
        "3.2",
        "… and no further.",
        judges.six_no_further,
        "How far f decreases depends on the limit of evaluations of lmdif, which the paper does "
        "not give. The section on f against evaluations shows where the median reaches the paper's "
        "value, as a sum of squares and as a norm.",
        FAIL,
    ),
    *(
        Claim(
            "3.2",
            f"Extended precision usually reduces f to about 1e−31: order {word}.",
            partial(judges.usually, order, 1e-31),
        )
        for order, word in ((4, "four"), (5, "five"))
    ),
    Claim(
        "3.2",
        "Extended precision usually reduces f, from about 1e−6, to about 1e−8: order six.",
        judges.improved,
    ),
    Claim("3.2", "Table of q, s, n, N_CG and N_RK.", judges.table),
    Claim(
        "1, 3.2, 4",
        "CG6a satisfies the conditions to six or seven digits: the typical condition.",
        judges.typical_digits,
    ),
    Claim(
        "1, 3.2, 4",
        "The same: every condition.",
        judges.all_digits,
        "“Six to seven digits” describes the typical condition. Others hold to fewer digits, and "
        "the number of printed digits is not the reason.",
        FAIL,
    ),
    Claim("3.2", "The examples have moderately sized coefficients.", judges.moderate),
    Claim(
        "3.2", "The abscissae of the example of order four lie in [0, 1].", judges.in_unit_interval
    ),
    Claim("4", "B is orthogonal with determinant one.", judges.initial),
    Claim("4", "CG4a is superior to CG4.", partial(judges.superior, "CG4a", ("CG4",), 1.0)),
    Claim(
        "4",
        "At h = 0.1 CG6a is significantly better than the others.",
        partial(judges.superior, "CG6a", ("CG4", "CG4a", "CG5a"), 2.0),
    ),
    Claim(
        "4",
        "CG6a's graph shows that its conditions are satisfied only approximately.",
        judges.slope_approximate,
    ),
    Claim(
        "A",
        "All coefficients are truncated to 16 decimals.",
        judges.truncated,
        "No exact method has the digits of CG4a or CG5a when truncated. The nearest one has those "
        "of CG4a when rounded, and misses those of CG5a by 0.03 units of the last place. CG6a is "
        "printed with eight decimals.",
        FAIL,
    ),
)
"""All claims in the order of the paper, without repetitions."""


def compute(context: Context) -> Data:
    """Judge all ``claims``; return their ``count`` by verdict too, and the ``numbers`` of `gather`.

    Each claim has ``section``, ``claim``, ``verdict`` ("pass", "fail" or "not reproducible"),
    ``evidence``, and ``interpretation``, empty unless it fails.
    """
    numbers = gather(context.settings.seed)
    judged = []
    for done, claim in enumerate(CLAIMS):
        context.progress(done, len(CLAIMS))
        passed, evidence = claim.judge(numbers, context.results)
        verdict = NOT_REPRODUCIBLE if passed is None else PASS if passed else FAIL
        judged.append(
            {
                "section": claim.section,
                "claim": claim.text,
                "verdict": verdict,
                "evidence": evidence,
                "interpretation": claim.interpretation if verdict == FAIL else "",
            }
        )
    total = Counter(entry["verdict"] for entry in judged)
    count = {name: total[name] for name in VERDICTS}
    return {"claims": judged, "count": count, "numbers": numbers}


def present(data: Data) -> Sequence[Block]:
    """Tabulate the verdicts."""
    total = data["count"]
    rows = [
        [
            entry["section"],
            entry["claim"],
            entry["verdict"],
            ". Our reading: ".join(filter(None, (entry["evidence"], entry["interpretation"]))),
        ]
        for entry in data["claims"]
    ]
    return (
        Text(
            "The results that the paper claims, in our words. Each verdict is decided by the "
            f"numbers beside it, which this run computed: {total['pass']} pass, {total['fail']} "
            f"fail; not reproducible, for the reason given: {total['not reproducible']}."
        ),
        Table("Claims", ("section", "claim", "verdict", "evidence"), rows, numeric=False),
    )


ITEMS = (Item("claims", "What the paper claims", 90, 10, compute, present, NEEDS),)
