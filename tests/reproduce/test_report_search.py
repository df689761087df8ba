"""Searches of the report: checkpoints, interrupts, presentation."""

import json
from dataclasses import astuple, replace
from fractions import Fraction

import pytest
from refusals import refuses
from report_pages import context

from cg.construction.runs import read_store
from cg.construction.search.random_search import search
from cg.construction.search.shapes import start_generator
from cg.reproduce.blocks import Settings, Table, median, quartiles
from cg.reproduce.coefficients import labels
from cg.reproduce.sections import evaluations
from cg.reproduce.sections import search as section
from cg.reproduce.sections.search import PLANS


def test_plans_match_the_paper():
    # order, stages, starts, starts in full, evaluations in double: 200 (n + 1) at orders four and
    # six, refined below, evaluations in real(16), f in double and real(16) in the paper
    assert {order: astuple(plan) for order, plan in PLANS.items()} == {
        4: (4, 5, 1000, 20_000, 3_200, 1e-12, 320, 1e-15, 1e-31),
        5: (5, 9, 240, 4_800, 100_000, 1e-12, 1840, 1e-15, 1e-31),
        6: (6, 16, 16, 320, 27_400, 1.0, 822, 1e-6, 1e-8),
    }
    assert [plan.unknowns for plan in PLANS.values()] == [15, 45, 136]
    assert evaluations.COUNTS == (1370, 2740, 5480, 27_400 + 822)
    stopped = evaluations.STOPPED
    assert (stopped.starts, stopped.maxfev, stopped.refine_maxfev) == (4, 2740, 13_700)


def test_search_uses_its_plan(tmp_path):
    data = section.compute(replace(PLANS[4], starts=2), context(tmp_path))
    expected = {
        "order": 4, "stages": 5, "seed": 0, "algorithm": "lmdif", "rows": "explicit", "width": 1.0,
        "maxfev": 3200, "refine_below": 1e-12, "refine_maxfev": 320, "flows": None,
        "embedded": False, "first_same_as_last": False, "hold": (),
    }  # fmt: skip
    assert data["settings"] | expected == data["settings"]
    assert data["paper"] == {"f_double": 1e-15, "f_quad": 1e-31}
    assert abs(start_generator(0, 1).uniform(-1.0, 1.0, 15)).max() <= 1


def test_median_and_quartiles():
    assert quartiles([]) is None
    assert quartiles([1e-9, 1.0, 1e-3]) == [1e-9, 1e-9, 1e-3, 1.0, 1.0]
    assert median([1e-9, 1.0, 1e-3]) == 1e-3
    assert median([4.0, 1.0, 3.0, 2.0]) in (2.0, 3.0)
    refuses(ValueError, "must not be empty", median, [])


SMALL = replace(PLANS[4], starts=60, full_starts=70)


def stores(folder):
    return list(folder.glob("*.jsonl"))


def test_interrupted_search_continues(tmp_path):
    def stop(done, total):
        if done >= 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        section.compute(SMALL, context(tmp_path, progress=stop))
    (path,) = stores(tmp_path)
    stored = [line for line in read_store(path) if "index" in line]
    assert 20 <= len(stored) < 60
    seen = []
    resumed = section.compute(SMALL, context(tmp_path, progress=lambda *now: seen.append(now)))
    assert seen == [(done, 60) for done in range(len(stored), 61)]
    fresh = tmp_path / "fresh"
    fresh.mkdir()
    assert resumed == section.compute(SMALL, context(fresh))
    assert resumed["distinct"] > 3


def test_search_with_other_settings_has_its_own_store(tmp_path):
    section.compute(replace(SMALL, starts=2), context(tmp_path))
    section.compute(replace(SMALL, starts=2, maxfev=100), context(tmp_path))
    section.compute(replace(SMALL, starts=2), replace(context(tmp_path), settings=Settings(1)))
    assert len(stores(tmp_path)) == 3


def test_full_has_more_starts_and_shares_the_store(tmp_path):
    default = section.compute(SMALL, context(tmp_path))
    full = section.compute(SMALL, replace(context(tmp_path), settings=Settings(0, full=True)))
    assert len(full["f_double"]) == 70
    assert full["f_double"][:60] == default["f_double"]
    assert len(stores(tmp_path)) == 1
    assert all(plan.full_starts > 10 * plan.starts for plan in PLANS.values())


def test_methods_are_chosen_by_the_rule_of_the_paper(tmp_path):
    data = section.compute(replace(SMALL, starts=300), context(tmp_path))
    inside = [method["abscissae_in_unit_interval"] for method in data["methods"]]
    assert inside == sorted(inside, reverse=True)
    assert inside[0]
    for method in data["methods"]:
        assert [label for label, _ in method["coefficients"]] == labels(5)
        b = [Fraction(value) for label, value in method["coefficients"] if label[0] == "b"]
        assert abs(sum(b) - 1) < 1e-33
    sizes = data["largest_coefficients"]
    assert sizes == sorted(sizes)


def test_search_without_exact_method_reports_it(tmp_path):
    plan = replace(PLANS[5], starts=2, maxfev=300)
    data = section.compute(plan, context(tmp_path))
    assert data["distinct"] == 0
    assert data["f_quad_quartiles"] is None
    blocks = section.present(plan, data)
    titles = [block.caption for block in blocks if isinstance(block, Table)]
    assert titles[-1].startswith("Not exact")
    assert json.dumps(data, allow_nan=False)


def test_evaluations_section_uses_the_same_starts(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluations, "_PLAN", replace(PLANS[6], starts=2, maxfev=700))
    monkeypatch.setattr(evaluations, "COUNTS", (300, 500, 900))
    early = replace(PLANS[6], starts=1, maxfev=400, refine_below=1e3, refine_maxfev=140)
    monkeypatch.setattr(evaluations, "STOPPED", early)
    given = {"search6": {"f_double": [1.0, 2.0, 3.0], "f_quad": [0.9, 1.0, 1.0]}}
    shown = []
    given_context = context(tmp_path, results=given)
    data = evaluations.compute(replace(given_context, progress=lambda *done: shown.append(done)))
    # starts in double are 2 · 300, 2 · 500 and 2 · 900 of 15,000 evaluations, the last one 80 · 140
    assert shown == [(k, 100) for k in (0, 2, 4, 7, 10, 16, 22, 100)]
    assert data["limits"] == [300, 500, 700, 900]
    assert data["f"][2] == [1.0, 2.0]
    again = search(6, 16, 2, 0, algorithm="lmdif", maxfev=500, refine_below=0.0)
    assert data["f"][1] == [start.double.f for start in again.starts]
    assert data["f"][0][0] > data["f"][1][0] > data["f"][3][0]
    assert data["ratio_quad"] == [0.9, 0.5]
    assert data["ratio_double"] == [data["f"][3][0], data["f"][3][1] / 2]
    stopped = data["stopped"]
    assert (stopped["limit"], stopped["limit_quad"]) == (400, 140)
    (start,) = search(**early.arguments(0), starts=1).starts
    assert (stopped["f_double"], stopped["f_quad"]) == ([start.double.f], [start.quad.f])
    table = evaluations.present(data)[-1]
    assert [row[0] for row in table.rows] == ["300", "500", "700", "900"]
