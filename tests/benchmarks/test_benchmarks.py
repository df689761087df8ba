"""Solvers, problems and the page of the benchmarks."""

from pathlib import Path

import pytest

import cg

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("projected", [True, pytest.param(False, marks=pytest.mark.slow)])
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
