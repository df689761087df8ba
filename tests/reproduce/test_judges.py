"""Each judge of a claim passes and fails on given numbers."""

import copy
from functools import partial

import pytest

from cg.reproduce import judges
from cg.reproduce.sections.claims import CLAIMS

METHODS = ("CG4", "CG4a", "CG5a", "CG6a")


def numbers():
    """Numbers of `evidence.gather` that make every claim true."""
    orders = {"CG3": 3, "CG4": 4, "CG4a": 4, "CG5a": 5, "CG6a": 6}
    return {
        "conditions": {
            "4": {"rank": [13, 13], "independent": 13, "all": 22, "condition_number": 1e2},
            "5": {"rank": [38, 38], "independent": 38, "all": 64, "condition_number": 1e4},
            "6": {"rank": [113, 113], "independent": 113, "all": 196, "condition_number": 1e6},
        },
        "methods": {
            name: {
                "exact_order": order,
                "largest_coefficient": 3.0 if name == "CG4" else 2.0,
                "abscissae": [0.0, 1.0],
                "condition_number": 1e9 if name == "CG6a" else 1e3,
            }
            for name, order in orders.items()
        },
        "approximate": {
            "worst": 6.1, "root_mean_square": 6.4, "median": 6.5, "conditions": 196, "six": 196,
            "truncation": 1e-7,
        },
        "rotation_slopes": {
            "explicit": {"CG3": {"order": 3, "slope": 3.05}, "CG5a": {"order": 5, "slope": 4.95}},
            "implicit": {"DICG3": {"order": 3, "slope": 3.0}, "DICG6": {"order": 6, "slope": 6.05}},
            "Munthe-Kaas": {
                "RKMK4": {"order": 4, "slope": 4.0},
                "RKMK5(4)": {"order": 5, "slope": 5.7},
            },
        },
        "drift": {"RK45": [1e-3, 1e-2, 1e-1], "DOP853": [1e-4, 1e-3, 1e-3]},
        "drift_times": [1, 10, 100],
        "flat": dict.fromkeys(METHODS, 1e-16),
        "initial": {"orthogonality": 1e-16, "determinant": 0.0},
        "trees": {"order": 10, "generated": 99, "expected": 99},
    }  # fmt: skip


def figures():
    """Results of both figures, in double and real(16), that make every claim true."""
    errors = {"CG4": 1e-2, "CG4a": 1e-3, "CG5a": 1e-4, "CG6a": 1e-5}
    slopes = {"CG4": 4.0, "CG4a": 4.05, "CG5a": 4.95, "CG6a": 6.0}

    over_time = lambda error: {name: [0.0, error / 2, error] for name in ("rotation", "momentum")}

    def in_double(slope):
        distances = {"distance": [0.0, 2e-16], "distance_flows": [0.0, 9e-16]}
        return {"slope": slope, "error": [1.0, 1e-8], **distances}

    in_quad = lambda slope: {"slope": slope, "local": [3.0, 3.5, 4.0], "error": [1e-20]}
    readings = ("momentum", "velocity")
    quad = {name: in_quad(slopes[name]) for name in METHODS}
    return {
        "fig4.1": {
            "readings": {
                reading: {"methods": {name: over_time(errors[name]) for name in METHODS}}
                for reading in readings
            }
        },
        "fig4.2": {
            "readings": {
                reading: {name: in_double(slopes[name]) for name in METHODS} for reading in readings
            }
        },
        "fig4.2quad": {"readings": {"momentum": {"methods": quad}}},
    }


def searches():
    """Results of the searches that make every claim true."""
    search = {
        "distinct": 5, "exact": [True] * 5 + [False],
        "f_double": [1e-33] * 5 + [1e-3], "f_quad": [1e-69] * 5 + [None], "at_limit": 1,
        "settings": {"maxfev": 1000},
    }  # fmt: skip
    six = {
        "distinct": 0, "exact": [False] * 4, "f_double": [1e-6, 1e-6, 1e-6, 2e-7],
        "f_quad": [1e-8, 1e-8, 1e-8, 1e-7], "at_limit": 4,
        "settings": {"maxfev": 1000, "refine_maxfev": 30},
        "best": {"f": 1e-8, "condition_number": 1e9},
    }  # fmt: skip
    stopped = {
        "limit": 20, "limit_quad": 100, "f_double": [1e-6, 1e-6, 1e-6, 2e-7],
        "f_quad": [1e-8, 1e-8, 1e-8, 1e-7],
    }  # fmt: skip
    return {
        "search4": search,
        "search5": copy.deepcopy(search),
        "search6": six,
        "evaluations": {
            "limits": [10, 20],
            "f_quartiles": [[1e-9, 1e-8, 1e-7, 1e-6, 1.0]] * 2,
            "stopped": stopped,
        },
    }


def results():
    """Results of all items that make every claim true."""

    def printed():
        return {
            "count": 20, "decimals": 16, "largest_difference": 1e-16, "zeros_kept": True,
            "if_truncated": 0.5, "if_rounded": 0.4,
            "residuals": {"paper": {"largest": 1e-15}, "ours": {"largest": 1e-35}},
        }  # fmt: skip

    rows = [
        {"paper": {"q": q, "N_CG": n}, "agree": True, "trees": n + 7, "discarded": 7}
        for q, n in ((4, 13), (5, 38), (6, 113))
    ]
    return {
        "table3.2": {"rows": rows},
        "appendix": {"methods": {name: printed() for name in ("CG4a", "CG5a", "CG6a")}},
        **figures(),
        **searches(),
    }


J = judges
APPROXIMATE = "fig4.2quad readings momentum methods CG6a slope"

# a judge; a number; a value for which it must fail; one for which it must still pass
CASES = [
    (partial(J.catalogue_order, 6, "CG6a"), "methods CG6a exact_order", 1),
    (partial(J.catalogue_order, 3, "CG3"), "methods CG3 exact_order", 4),
    (partial(J.example, 4, "CG4a"), "methods CG4a exact_order", 3),
    (partial(J.example, 5, "CG5a"), "appendix methods CG5a largest_difference", 2.1e-16, 1.9e-16),
    (partial(J.example, 4, "CG4a"), "appendix methods CG4a zeros_kept", False),
    (partial(J.slope, 4, "CG4a"), "fig4.2quad readings momentum methods CG4a slope", 4.11, 3.91),
    (partial(J.slope, 5, "CG5a"), "fig4.2 readings velocity CG5a slope", 4.74, 4.76),
    (partial(J.slope, 5, "CG5a"), "fig4.2 readings momentum CG5a slope", None),
    (J.slope_six, APPROXIMATE, 5.89, 5.91),
    (J.slope_approximate, APPROXIMATE, 5.5, 5.4),
    (partial(J.many, 4), "search4 exact", [False] * 5001, [False] * 5000),
    (J.trees, "trees generated", 98),
    (J.independence, "conditions 5 rank", [37, 38]),
    (J.independence, "conditions 5 all", 38),
    (J.zeros, "table3.2 rows 1 discarded", 8),
    (J.table, "table3.2 rows 2 agree", False),
    (
        partial(J.double, 5, 1e-15),
        "search5 f_double",
        [2e-15, 1.0],
        [1e-15, 1.0],
    ),
    (
        partial(J.usually, 4, 1e-31), "search4 f_quad", [1e-31, 1e-31, 2e-31, 1.0, None, None],
        [1e-31, 1e-31, 1e-32, 1.0, 1.0, None],
    ),
    (partial(J.usually, 5, 1e-31), "search5 f_quad", [None] * 6),
    (partial(J.double, 6, 1e-6), "search6 f_double", [1.1e-6] * 4, [1e-6, 1.0, 1.0, 1.0]),
    (J.six_no_further, "search6 f_double", [1e-6, 1e-6, 1e-6, 0.9e-7], [1e-7] * 4),
    (J.improved, "evaluations stopped f_double", [3e-8, 3e-8, 3e-8, 1e-6]),
    (J.improved, "evaluations stopped f_quad", [3e-8, 3e-8, 4e-8, 4e-8], [3e-8, 3e-8, 3e-8, 4e-8]),
    (J.improved, "evaluations stopped f_quad", [None] * 4),
    (J.no_zero, "search6 distinct", 1),
    (J.ill_conditioned, "search6 best condition_number", 6e7, None),
    (J.ill_conditioned, "conditions 6 condition_number", 1e3),
    (J.ill_conditioned, "methods CG4a condition_number", 1e8),
    (J.typical_digits, "approximate median", 5.9, 7.0),
    (J.typical_digits, "approximate median", 7.1, 6.0),
    (J.all_digits, "approximate worst", 5.9, 6.0),
    (J.moderate, "methods CG5a largest_coefficient", 3.0, 2.9),
    (J.in_unit_interval, "methods CG4a abscissae", [-1e-9, 1.0]),
    (J.in_unit_interval, "methods CG4a abscissae", [0.0, 1 + 1e-9]),
    (J.initial, "initial determinant", 1e-15, 9e-16),
    (partial(J.superior, "CG4a", ("CG4",), 1.0), "fig4.1 readings velocity methods CG4a momentum",
     [0.0, 5e-3, 1e-3], [0.0, 4e-3, 9e-3]),
    (partial(J.superior, "CG6a", ("CG4", "CG4a", "CG5a"), 2.0),
     "fig4.1 readings momentum methods CG6a rotation", [0.0, 1e-5, 5.1e-5], [0.0, 4.9e-5, 4.9e-5]),
    (J.exact, "fig4.2 readings velocity CG5a distance_flows", [0.0, 1e-14], [0.0, 9e-15]),
    (J.exact, "fig4.2 readings momentum CG4 distance", [1e-14, 0.0]),
    *(
        (partial(J.theorem, kind), f"rotation_slopes {kind} {name} slope", slope)
        for kind, name, slope in (
            ("explicit", "CG3", 3.2),
            ("explicit", "CG5a", 4.8),
            ("implicit", "DICG3", 2.8),
            ("implicit", "DICG6", 6.2),
        )
    ),
    *(
        (partial(J.theorem, "Munthe-Kaas"), f"rotation_slopes Munthe-Kaas {name} slope", slope)
        for name, slope in (("RKMK4", 3.8), ("RKMK5(4)", 4.8))
    ),
    (J.drift, "drift RK45", [1e-3, 1e-2, 1.5e-3], [1e-5] * 2 + [1]),
    (J.drift, "drift DOP853", [1e-16, 1e-15, 1e-14]),
    (J.flat, "flat CG6a", 1e-14, 9e-15),
    (J.truncated, "appendix methods CG5a if_truncated", 0.51),
    (J.truncated, "appendix methods CG6a if_truncated", None),
    (J.truncated, "appendix methods CG6a decimals", 8),
]  # fmt: skip


def name(judge):
    return getattr(judge, "func", judge).__name__


def verdict(judge, *changes):
    given = {"numbers": numbers(), "results": results()}
    if name(judge) == "slope_approximate":
        changes = ((APPROXIMATE, 1.0), *changes)
    for path, value in changes:
        place = given["numbers"] | given["results"]
        *way, last = path.split()
        for key in way:
            place = place[int(key) if isinstance(place, list) else key]
        assert last in place
        place[last] = value
    passed, evidence = judge(given["numbers"], given["results"])
    assert isinstance(evidence, str)
    return bool(passed)


@pytest.mark.parametrize("case", CASES)
def test_judge_passes_and_fails(case):
    judge, path, failing, *passing = case
    assert verdict(judge)
    assert not verdict(judge, (path, failing))
    assert all(verdict(judge, (path, value)) for value in passing)


def test_every_judge_has_a_case():
    tried = {name(judge) for judge, *_ in CASES}
    public = {key for key, f in vars(judges).items() if f.__class__ is type(judges.flat)}
    assert tried == {key for key in public if key.islower() and key[0] != "_"} - {
        "number",
        "places",
        "median",
    }
    in_use = {name(claim.judge) for claim in CLAIMS}
    assert in_use == tried | {"<lambda>"}  # not reproducible


def test_claims_are_distinct():
    questions = [
        (name(claim.judge), getattr(claim.judge, "args", ()))
        for claim in CLAIMS
        if name(claim.judge) != "<lambda>"
    ]
    assert len(set(questions)) == len(questions)


def test_evidence_of_improvement_has_its_numbers():
    given = results()
    given["search6"]["f_double"] = [1e-8] * 4
    _, evidence = judges.improved(numbers(), given)
    assert "does not give its limits" in evidence
    assert "20 evaluations in double and 100 in real(16), 3 of 4 starts come to" in evidence
    assert "the median of f from 1e−06 to 1e−08" in evidence
    assert "with 1000 and 30, 0 of 4 starts" in evidence
    assert verdict(judges.improved, ("search6 f_quad", [None] * 4))


def test_failing_claims_have_an_interpretation(monkeypatch, tmp_path):
    from cg.reproduce.context import Context, Settings
    from cg.reproduce.sections import claims

    monkeypatch.setattr(claims, "gather", lambda seed: numbers())
    given = results()
    given["appendix"]["methods"]["CG6a"]["decimals"] = 8
    data = claims.compute(Context(Settings(), tmp_path, 1, results=given))
    failing = [entry for entry in data["claims"] if entry["verdict"] == "fail"]
    assert {entry["claim"] for entry in failing} == {
        "All coefficients are truncated to 16 decimals.",
        "CG6a's graph shows that its conditions are satisfied only approximately.",
    }
    assert data["count"] == {"pass": len(data["claims"]) - 3, "fail": 2, "not reproducible": 1}
    shown = {row[1]: row[3] for row in claims.present(data)[1].rows}
    for entry in failing:
        assert shown[entry["claim"]].startswith(entry["evidence"])
        assert entry["interpretation"] in shown[entry["claim"]]
    assert all(not entry["interpretation"] for entry in data["claims"] if entry not in failing)
