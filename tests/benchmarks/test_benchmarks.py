"""Solvers, problems and the page of the benchmarks."""

import sys
from pathlib import Path

import numpy as np
import pytest

import cg

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module", autouse=True)
def _importable():
    sys.path.insert(0, str(ROOT))
    yield
    sys.path.remove(str(ROOT))


@pytest.mark.parametrize("projected", [True, False])
def test_projected_dop853_solves_all_cases(projected):
    from benchmarks.cases import cases
    from benchmarks.projected import integrate

    actual = cases()
    assert len(actual) == 10
    for case in actual:
        points, evaluations = integrate(
            case.f, case.end, case.y0, case.frame, 1e-11, projected=projected
        )
        assert case.error(points[-1]) < 1e-9, case.name
        assert evaluations > 12
        if projected:
            assert case.frame.membership_error(points).max() < 1e-14, case.name
        own = cg.integrate(
            case.f, (0, case.end), case.y0, frame=case.frame, method="CF6c", h=case.end / 128
        )
        assert case.error(own.y[-1]) < 1e-5, case.name


def test_rivals_compare_times_at_equal_errors(monkeypatch):
    from benchmarks import cases, rivals, work_curves
    from benchmarks.work_curves import Point

    def run_point(case, solve, tolerance, rounds):
        assert list(solve) == ["default", "DOP853"]
        return {
            "default": Point(tolerance, tolerance**-0.125, 1, 1),
            "DOP853": Point(tolerance / 16, tolerance**-0.125, 1, 0),
        }

    monkeypatch.setattr(work_curves, "run_point", run_point)
    (case,) = cases.cases(["two_levels"])
    ratios = rivals.compare(case, [10.0**-k for k in range(3, 11)], 1)
    assert ratios == [pytest.approx(2**-0.5), pytest.approx(2**-0.5), None]


def test_curves_interpolate_work():
    from benchmarks.work_curves import Curve, Point

    points = [Point(10.0**-k, 2.0**k, 10 * k, 0) for k in range(1, 13)]
    curve = Curve.of([Point(0.5, 1.0, 1, 1), *points])
    assert len(curve.points) == 12
    assert curve.at(1e-8, "time") == pytest.approx(2.0**8)
    assert curve.at(1e-8, "evaluations") == pytest.approx(80)
    assert np.isnan(curve.at(1e-8, "flows"))
    assert np.isnan(curve.at(1e-14, "time"))


def test_times_give_medians_and_ratios_of_rounds():
    from benchmarks.timing import Times

    times = Times({"a": [1.0, 2.0, 9.0], "b": [2.0, 8.0, 9.0]})
    assert times.median("b") == 8.0
    row = times.row("x", "a", "ms a step", "b", "b", pieces=(2, 4))
    assert (row.value, row.other, row.ratio) == (1000.0, 2000.0, 1.0)
    assert times.row("x", "a", "µs", "b", "b").ratio == 0.5


def test_search_counts_exact_methods():
    from benchmarks.search import contestants

    for contestant in contestants(3, 3).values():
        while not contestant.exact:
            contestant.advance(contestant.seconds + 1e-9)  # one start
            assert contestant.starts <= 20
        assert contestant.exact == [contestant.starts - 1]


def test_page_is_rendered_from_the_stored_results(tmp_path):
    from benchmarks import page
    from benchmarks.__main__ import NAMES

    file = ROOT / "benchmarks" / "results.json"
    results, environments = page.read(file)
    assert tuple(results) == NAMES
    stored = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert page.render(results, environments) == stored
    page.write(results, environments, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == file.read_bytes()


def test_rejects_unknown_names(capsys):
    from benchmarks.__main__ import main

    with pytest.raises(SystemExit):
        main(["nothing"])
    assert "NAME must be one of rivals" in capsys.readouterr().err
