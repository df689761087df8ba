"""Numbers in the prose of pages match stored data or computed results."""

import json
import math
import re
from collections import Counter
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import pytest
from kinds import FROZEN
from tests_of_pages import RAISED, power_of_ten, words_of

import cg
from cg import conditions
from cg.proofs import certificate_of, proved
from cg.reproduce import evidence
from cg.reproduce.appendix_a import nearest_exact

ROOT = Path(__file__).parents[2]


def certificates():
    counts = Counter(map(proved, cg.methods.values()))
    yield (
        f"Of the {len(cg.methods)} methods of `cg.methods` the orders of {counts['yes']} are "
        f"proved; of {counts['in part']} it is"
    )
    boxes = {
        n: certificate_of(m).box for n, m in cg.methods.items() if proved(m) in ("yes", "in part")
    }
    follow = [name for name, box in boxes.items() if box.left_out and box.bound is None]
    yield f"Such relations complete the proofs of {', '.join(follow)}."
    bounds = {name: box.bound for name, box in boxes.items() if box.bound}
    large = {name: bound for name, bound in bounds.items() if bound > Decimal("1e-300")}
    yield f"Larger bounds: {', '.join(f'{name} {bound:e}' for name, bound in large.items())}."
    radii = [float(box.radius) for box in boxes.values()]
    logarithms = [math.log10(radius) for radius in radii if radius]
    ends = math.floor(min(logarithms)), math.ceil(max(logarithms))
    yield "Boxes are so small (10{} to 10{})".format(*(str(end).translate(RAISED) for end in ends))


def reproduction():
    cg6a = cg.methods["CG6a"]
    residuals = conditions.residuals(cg6a, 6, arithmetic="exact")
    independent = conditions.residuals(cg6a, 6, independent=True, arithmetic="exact")
    held = sum(abs(residual) <= Fraction(1, 10**6) for residual in residuals)
    over_all, over_independent = (
        power_of_ten(sum(r * r for r in rs), 1) for rs in (residuals, independent)
    )
    yield f"{held} of {len(residuals)} hold to 10⁻⁶"
    yield f"Σb − 1 = {power_of_ten(sum(cg6a.exact[1]) - 1, 0)}:"
    yield f"has f = {over_independent} ({over_all} over all trees"
    cut, rounded = (
        [f"{nearest_exact(name, truncated=truncated):.2f}" for name in ("CG4a", "CG5a")]
        for truncated in (True, False)
    )
    yield f"{cut[0]} units of the last place (CG4a) and {cut[1]} (CG5a) from the middle"
    yield f"{rounded[0]} and {rounded[1]} from what is rounded"
    numbers = evidence.gather(0)
    assert numbers["approximate"]["six"] == held
    for name, sizes in numbers["drift"].items():
        first, second = (f"{size:.2g}" for size in sizes[:2])
        last = f"{sizes[2]:.1g}"  # the solution is chaotic, so that the next digit is rounding
        yield f"{name} by {first}, {second} and {last}"
    for name, run in numbers["rotation_slopes"]["Munthe-Kaas"].items():
        yield f"{run['slope']:.2f} for `{name}`"
    runs = numbers["rotation_slopes"]["implicit"]
    *slopes, last = (f"{run['slope']:.2f}" for run in runs.values())
    *names, other = (f"`{name}`" for name in runs)
    yield f"{', '.join(slopes)} and {last} for {', '.join(names)} and {other}"


def compared():
    (note,) = (note for note in measured("rivals")["notes"] if note.startswith("- Of "))
    total, evaluations, time = re.search(
        r"Of (\d+) cases .* evaluations in (\d+), flows in \d+, time in (\d+);", note
    ).groups()
    yield (
        f"of {total} cases of the benchmarks (a problem and an error) a Crouch–Grossman or "
        f"commutator-free method takes the least time in {time}, and the fewest evaluations in "
        f"{evaluations}."
    )


def lifting():
    values = {row["quantity"].split("`")[1]: row["value"] for row in measured("output")["rows"]}
    above = {name: value for name, value in values.items() if value > 3}
    assert set(above) == {"DOP853", "DVERK6(5)", "Verner7(6)"}
    yield f"up to {above['DOP853']:.2f} times that at the ends in the"
    yield f"of `DVERK6(5)` up to {above['DVERK6(5)']:.2f} and of `Verner7(6)` up to "
    yield f"{above['Verner7(6)']:.2f}, and of the other pairs at most 3."
    pairs = {name for name, method in FROZEN.items() if method.embedded_order}
    assert pairs == set(values)


def implicit():
    stages = (m.stages for m in tableaux(6))
    yield f"of order 6 in the catalogue have {min(stages)} stages or more"


def impossible():
    methods = [m for m in FROZEN.values() if m.explicit and m.order == 6]
    fewest = min(methods, key=lambda method: method.exponentials)
    number = {13: "thirteen"}[fewest.exponentials]
    yield f"or fewer flows than {fewest.name}'s {number}"
    for name, flows in (("CF3", 2), ("CF4", 2), ("CF5b", 4), ("CF5c", 4), ("CF6b", 4)):
        assert len(cg.methods[name].tree.path(cg.methods[name].result)) == flows


def catalogue():
    best = min(tableaux(6), key=lambda method: method.principal_error)
    small = cg.methods["CG6f"]
    yield (
        f"| `CG6f`, `{best.name}` | principal error {small.principal_error:.3g} with "
        f"{small.stages} stages, {best.principal_error:.3g} with {best.stages} |"
    )


def readme():
    rows = measured("rivals")["details"]["rows"]
    ratios = [row["ratio"] for row in rows if row["quantity"].endswith("solve_ivp, error 1e-08")]
    assert len(ratios) == 10
    yield f"takes {1 / max(ratios):.2f} to {1 / min(ratios):.2f} of the time of SciPy's DOP853"
    four, five = (
        60 / next(row["value"] for row in measured("search")["rows"] if start in row["quantity"])
        for start in ("order 4", "order 5")
    )
    free = (m.exponentials for m in FROZEN.values() if m.explicit and m.order == 6)
    smallest = min(method.exponentials for method in tableaux(6))
    yield f"so that fewer flows suffice: order six takes {min(free)}, where the smallest"
    yield f"Crouch–Grossman method of the catalogue takes {smallest}."
    yield f"of order four in {1000 * four:.0f} ms each, of order five in {five:.1g} s"


def in_jax():
    rows = {row["quantity"]: row for row in measured("jax")["rows"]}
    loop, unrolled = (rows[f"compiling RKMK8(5,3){more}"] for more in ("", ", unroll=True"))
    yield f"`RKMK8(5,3)` takes {loop['value'] / 1e3:.1f} s, `Dopri8` of diffrax "
    yield f"{loop['other'] / 1e3:.1f} s."
    yield f"unroll=True)`, {unrolled['value'] / 1e3:.1f} s,"
    bodies = [row for row in measured("jax")["rows"] if row["quantity"].startswith("tumbling")]
    assert len(bodies) == 3
    assert all(row["ratio"] > 1.0 for row in bodies)
    yield "less time than the faster of diffrax's `Tsit5` and `Dopri8` at [errors of 1e-6 to"


def long_times():
    yield from (" ".join(note.split()) for note in measured("long_times")["notes"])


def measured(section):
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text("utf-8"))["results"]
    return results[section]


def tableaux(order):
    return [
        method
        for method in cg.methods.values()
        if isinstance(method, cg.Tableau) and method.explicit and method.order == order
        if not method.approximate
    ]


@pytest.mark.parametrize(
    "page",
    [catalogue, certificates, compared, implicit, impossible, in_jax, long_times, readme,
     reproduction],
    ids=lambda page: page.__name__,
)  # fmt: skip
def test_numbers_in_page_match_stored_data(page):
    places = {
        readme: "README.md",
        in_jax: "docs/howto/jax.md",
        long_times: "docs/howto/long_times.md",
    }
    text = words_of(places.get(page, f"docs/{page.__name__}.md"))
    for sentence in page():
        assert sentence in text
