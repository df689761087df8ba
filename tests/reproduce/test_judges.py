"""Each judge of a claim passes and fails, on numbers of a run of which single ones are changed."""

import copy
from contextlib import suppress
from functools import partial

import pytest
from report_pages import context

from cg.reproduce import judges as J
from cg.reproduce import report
from cg.reproduce.evidence import gather
from cg.reproduce.sections import claims
from cg.reproduce.sections.claims import CLAIMS, NEEDS, VERDICTS

SEARCH = {
    "distinct": 5, "exact": [True] * 5 + [False], "at_limit": 1, "settings": {"maxfev": 1000},
    "f_double": [1e-33] * 5 + [1e-3], "f_quad": [1e-69] * 5 + [None],
}  # fmt: skip
AT_SIX = {"f_double": [1e-6, 1e-6, 1e-6, 2e-7], "f_quad": [1e-8, 1e-8, 1e-8, 1e-7]}
SLOPES = {"CG4": 4.0, "CG4a": 4.05, "CG5a": 4.95, "CG6a": 6.0}
QUAD = {
    name: {"slope": slope, "local": [3.0, 3.5, 4.0], "error": [1e-20]}
    for name, slope in SLOPES.items()
}
SLOW = {
    "fig4.2quad": {"readings": {"momentum": {"methods": QUAD}}},
    "search4": SEARCH,
    "search5": SEARCH,
    "search6": {
        **AT_SIX, "distinct": 0, "exact": [False] * 4, "at_limit": 4,
        "settings": {"maxfev": 1000, "refine_maxfev": 30},
        "best": {"f": 1e-8, "condition_number": 1e9},
    },
    "evaluations": {
        "limits": [10, 20], "f_quartiles": [[1e-9, 1e-8, 1e-7, 1e-6, 1.0]] * 2,
        "stopped": {**AT_SIX, "limit": 20, "limit_quad": 100},
    },
}  # fmt: skip
"""Results of items that take long, with which claims are true."""


class Quick(dict):
    """Results of items, without those that take long."""

    def __missing__(self, name):
        assert name in NEEDS
        raise TimeoutError(name)


@pytest.fixture(scope="module")
def evidence(tmp_path_factory):
    """Numbers and results of a run as far as it is quick."""
    folder = tmp_path_factory.mktemp("quick")
    names = ("table3.2", "appendix", "fig4.1", "fig4.2")
    return gather(0), Quick((n, report.ITEMS[n].compute(context(folder))) for n in names)


def truncated(off):
    part = {"decimals": 16, "if_truncated": off, "if_rounded": 0.4}
    return {"CG4a": part | {"if_truncated": 0.5}, "CG5a": part}


FIRST, QUAD_SLOPE = "readings momentum methods", "fig4.2quad readings momentum methods CG6a slope"
ORDER_FIVE = {"rank": [38, 38], "independent": 38, "all": 64, "condition_number": 1e4}

# a judge; a number; a value for which it fails; one for which it passes, by default that of the run
CASES = [
    (partial(J.catalogue_order, 6, "CG6a"), "methods CG6a exact_order", 1, 6),
    (partial(J.example, 4, "CG4a"), "methods CG4a exact_order", 3),
    (partial(J.example, 5, "CG5a"), "appendix methods CG5a largest_difference", 2.1e-16, 1.9e-16),
    (partial(J.example, 4, "CG4a"), "appendix methods CG4a zeros_kept", False),
    (partial(J.slope, 4, "CG4a"), f"fig4.2quad {FIRST} CG4a slope", 4.11, 3.91),
    (partial(J.slope, 5, "CG5a"), "fig4.2 readings velocity CG5a slope", 4.74, 4.76),
    (partial(J.slope, 5, "CG5a"), "fig4.2 readings momentum CG5a slope", None),
    (J.slope_six, QUAD_SLOPE, 5.89, 5.91),
    (J.slope_approximate, QUAD_SLOPE, 5.5, 5.4),
    (partial(J.many, 4), "search4 exact", [False] * 5001, [False] * 5000),
    (J.trees, "trees generated", 98),
    (J.independence, "conditions 5", ORDER_FIVE | {"rank": [37, 38]}, ORDER_FIVE),
    (J.independence, "conditions 5 all", 38),
    (J.zeros, "table3.2 rows 1 discarded", 8),
    (J.table, "table3.2 rows 2 agree", False),
    (partial(J.double, 5, 1e-15), "search5 f_double", [2e-15, 1.0], [1e-15, 1.0]),
    (partial(J.usually, 4, 1e-31), "search4 f_quad", [1e-31, 1e-31, 2e-31, 1.0, None, None],
     [1e-31, 1e-31, 1e-32, 1.0, 1.0, None]),
    (partial(J.usually, 5, 1e-31), "search5 f_quad", [None] * 6),
    (partial(J.double, 6, 1e-6), "search6 f_double", [1.1e-6] * 4, [1e-6, 1.0, 1.0, 1.0]),
    (J.six_no_further, "search6 f_double", [1e-6, 1e-6, 1e-6, 0.9e-7], [1e-7] * 4),
    (J.improved, "evaluations stopped f_double", [3e-8, 3e-8, 3e-8, 1e-6]),
    (J.improved, "evaluations stopped f_quad", [3e-8, 3e-8, 4e-8, 4e-8], [3e-8, 3e-8, 3e-8, 4e-8]),
    (J.improved, "evaluations stopped f_quad", [None] * 4),
    (J.no_zero, "search6 distinct", 1),
    (J.ill_conditioned, "search6 best condition_number", 6e7, None),
    (J.ill_conditioned, "conditions 6 condition_number", 1.0),
    (J.ill_conditioned, "methods CG4a condition_number", 1e8),
    (J.typical_digits, "approximate median", 5.9, 7.0),
    (J.typical_digits, "approximate median", 7.1, 6.0),
    (J.all_digits, "approximate worst", 5.9, 6.0),
    (J.moderate, "methods CG5a largest_coefficient", 1e3),
    (J.in_unit_interval, "methods CG4a abscissae", [-1e-9, 1.0]),
    (J.in_unit_interval, "methods CG4a abscissae", [0.0, 1 + 1e-9], [0.0, 1.0]),
    (J.initial, "initial determinant", 1e-15, 9e-16),
    (partial(J.superior, "CG4a", ("CG4",), 1.0), "fig4.1 readings velocity methods CG4a momentum",
     [1.0] * 11),
    (partial(J.superior, "CG6a", ("CG4", "CG4a", "CG5a"), 2.0), f"fig4.1 {FIRST} CG6a rotation",
     [1.0] * 11),
    (J.exact, "fig4.2 readings velocity CG5a distance_flows", [0.0, 1e-14], [0.0, 9e-15]),
    (J.exact, "fig4.2 readings momentum CG4 distance", [1e-14, 0.0]),
    (partial(J.theorem, "explicit"), "rotation_slopes explicit CG5a slope", 4.8),
    (partial(J.theorem, "implicit"), "rotation_slopes implicit DICG6 slope", 6.2),
    (partial(J.theorem, "Munthe-Kaas"), "rotation_slopes Munthe-Kaas RKMK5(4) slope", 4.8, 5.7),
    (J.drift, "drift RK45", [1e-3, 1e-2, 1.5e-3], [1e-5] * 2 + [1]),
    (J.drift, "drift DOP853", [1e-16, 1e-15, 1e-14]),
    (J.flat, "flat CG6a", 1e-14, 9e-15),
    (J.truncated, "appendix methods", truncated(0.51), truncated(0.5)),
    (J.truncated, "appendix methods", truncated(None), truncated(0.5)),
]  # fmt: skip


def name(judge):
    return getattr(judge, "func", judge).__name__


def verdict(evidence, judge, path, value):
    numbers, quick = copy.deepcopy(evidence)
    results = quick | copy.deepcopy(SLOW)
    place = numbers | results
    *way, last = path.split()
    for key in way:
        place = place[int(key) if isinstance(place, list) else key]
    assert last in place
    place[last] = value
    passed, text = judge(numbers, results)
    assert isinstance(text, str)
    return bool(passed)


@pytest.mark.parametrize("case", CASES)
def test_judge_passes_and_fails(evidence, case):
    judge, path, failing, *passing = case
    assert not verdict(evidence, judge, path, failing)
    if passing:
        assert verdict(evidence, judge, path, *passing)
    else:
        assert judge(evidence[0], evidence[1] | SLOW)[0]


def test_every_judge_has_a_case():
    tried = {name(judge) for judge, *_ in CASES}
    assert {name(claim.judge) for claim in CLAIMS} == tried | {"<lambda>"}  # not reproducible


def test_verdicts_are_those_of_the_judges(evidence):
    """As far as they need neither searches nor quadruple precision; a slow test covers all."""
    numbers, results = evidence
    judged = 0
    for claim in CLAIMS:
        with suppress(TimeoutError):
            passed, _ = claim.judge(numbers, results)
            assert claim.default_verdict == VERDICTS[[True, False, None].index(passed)], claim
            judged += 1
    assert judged == 24


def test_claims_are_distinct():
    questions = [(name(claim.judge), getattr(claim.judge, "args", ())) for claim in CLAIMS]
    assert len(set(questions)) == len({(c.section, c.text) for c in CLAIMS}) == len(questions)
    assert all(claim.section and claim.text.endswith((".", "…")) for claim in CLAIMS)


def test_evidence_of_improvement_has_its_numbers(evidence):
    results = copy.deepcopy(SLOW)
    results["search6"]["f_double"] = [1e-8] * 4
    _, text = J.improved(evidence[0], results)
    assert "does not give its limits" in text
    assert "20 evaluations in double and 100 in real(16), 3 of 4 starts come to" in text
    assert "the median of f from 1e−06 to 1e−08" in text
    assert "with 1000 and 30, 0 of 4 starts" in text


def test_failing_claims_have_an_interpretation(evidence, monkeypatch, tmp_path):
    numbers, quick = evidence
    monkeypatch.setattr(claims, "gather", lambda seed: numbers)
    data = claims.compute(context(tmp_path, results=quick | SLOW))
    shown = {row[1]: row[3] for row in claims.present(data)[1].rows}
    assert data["count"]["fail"] == 4
    for entry in data["claims"]:
        fails = entry["verdict"] == "fail"
        assert bool(entry["interpretation"]) == fails or "only approximately" in entry["claim"]
        assert shown[entry["claim"]].startswith(entry["evidence"])
        assert entry["interpretation"] in shown[entry["claim"]]
