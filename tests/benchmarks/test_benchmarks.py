"""Solvers, problems and pages of the benchmarks."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from quotients import jacobian

import cg
from benchmarks.linear import linear_solver
from benchmarks.linear_cases import dop853, linear_cases, qutip_solver
from cg.analysis.convergence import observed_order
from cg.problems import FreeRigidBody, HeavyTop

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module", autouse=True)
def _importable():
    sys.path.insert(0, str(ROOT))
    yield
    sys.path.remove(str(ROOT))


def test_jacobian_for_leastsq_agrees_with_differences():
    from benchmarks.contest import PaddedResidual

    residual = PaddedResidual(4, 5)
    x = np.random.default_rng(2).uniform(-1, 1, 15)
    expected = jacobian(lambda s: residual(x + s), 15, bound=1e-10)
    np.testing.assert_allclose(residual.jacobian(x), expected, rtol=0, atol=1e-10)


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


@pytest.mark.parametrize("order", [4, 6])
def test_observed_order_of_magnus_methods(order):
    from benchmarks.cases import cases
    from benchmarks.magnus import Magnus

    (case,) = cases(["two_levels"])
    counts = (8, 16, 32)
    errors = []
    for count in counts:
        method = Magnus(case.f, case.frame, order)
        errors.append(case.error(method.integrate(case.end, case.y0, count)[-1]))
        assert (method.nfev, method.nexp) == (count * order // 2, count)
    assert observed_order([1 / n for n in counts], errors) == pytest.approx(order, abs=0.1)


def test_curves_interpolate_work_and_best_solver():
    from benchmarks.rivals import _best
    from benchmarks.work_curves import Curve, Point

    points = [Point(10.0**-k, 2.0**k, 10 * k, 0, 1e-16) for k in range(1, 13)]
    curve = Curve.of("own", "pair", 4, [Point(0.5, 1.0, 1, 1, 1e-16), *points])
    assert len(curve.points) == 12
    assert curve.at(1e-8, "time") == pytest.approx(2.0**8)
    assert curve.at(1e-8, "evaluations") == pytest.approx(80)
    assert np.isnan(curve.at(1e-8, "flows"))
    assert np.isnan(curve.at(1e-14, "time"))
    other = Curve(
        "rival", "rival", 8, tuple(Point(p.error, 2 * p.seconds, 1, 1, 0.1) for p in points)
    )
    assert _best([curve, other], ("pair", "rival"), 1e-8, "time") == "own"
    assert _best([curve, other], ("fixed",), 1e-8, "time") is None
    assert other.drift(1e-8) == 0.1


needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")


@needs_gcc
@pytest.mark.parametrize("key", ["CF4", "CG4a", "CF6a", "CG5a"])
def test_plain_loop_in_c_takes_the_same_steps(tmp_path, key):
    from benchmarks.in_c import PlainLoop, field, top_field

    loop, top = PlainLoop(tmp_path), HeavyTop()
    in_c = top_field(top, tmp_path)
    plain = loop.integrate(in_c, key, 0.01, 100, top.y0[None])[0]
    for f in (in_c, top.f):
        ours = cg.integrate(f, (0, 1), top.y0, frame=top.frame, method=key, h=0.01)
        np.testing.assert_allclose(ours.y[-1], plain, rtol=0, atol=1e-12)
    frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    body = field("free_body", tmp_path, [1.0, 0.5, 0.4])
    points = frame.random_point(np.random.default_rng(1), (5,))
    ours = cg.solve_ensemble(body, (0, 1), points, frame=frame, method=key, h=0.1, t_eval=[1])
    plain = loop.integrate(body, key, 0.1, 10, points)
    np.testing.assert_allclose(ours.y[0], plain, rtol=0, atol=1e-13)


@needs_gcc
def test_ensemble_functions_agree_in_c_and_python(tmp_path):
    from benchmarks import ensemble
    from benchmarks.ensemble import fields, level
    from benchmarks.in_c import field

    frame = ensemble._FRAME
    points = frame.random_point(np.random.default_rng(1), (4,))
    body, event = field("free_body", tmp_path, ensemble._INVERSE), field("level", tmp_path)
    options = {"frame": frame, "t_eval": [0, 5, 10], "rtol": 1e-6, "atol": 1e-6}
    in_c = cg.solve_ensemble(body, (0, 10), points, events=event, **options)
    in_python = cg.solve_ensemble(body, (0, 10), points, events=level, **options)
    assert sum(len(times) for times in in_c.t_events[0]) > 4
    for ours, theirs in zip(in_c.t_events[0], in_python.t_events[0], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)
    at_once = cg.solve_ensemble(fields, (0, 10), points, vectorized=True, **options)
    np.testing.assert_allclose(at_once.y, in_c.y, rtol=0, atol=1e-10)


@needs_gcc
def test_solvers_solve_the_tumbling_body(tmp_path):
    from benchmarks import bodies

    case = bodies.tumbling(tmp_path)
    assert np.divide(bodies._MOMENTUM, bodies._INERTIA).tolist() == [1.0, 2.0, -0.5]
    body = FreeRigidBody(bodies._INERTIA, bodies._MOMENTUM)
    exact = body.body_momentum(body.reference([case.end]).y[0])
    np.testing.assert_allclose(case.exact[4:], exact, rtol=0, atol=1e-12)
    solvers = {"own": bodies._solve(case)}
    if importlib.util.find_spec("diffrax") is not None:
        solvers |= bodies.diffrax_solvers(case)
        assert len(solvers) == 3
    for name, solve in solvers.items():
        points = solve(1e-11).points
        assert points.shape == (1, 7), name
        assert case.error(points[-1]) < 1e-8, name


def test_bodies_compare_with_the_fastest_competitor(monkeypatch):
    from benchmarks import bodies, work_curves
    from benchmarks.work_curves import Point

    seconds = {bodies._OWN: 1.0, "coarse": 0.1, "slow": 4.0, "fast": 3.0}

    def run_point(case, solve, tolerance, rounds):
        return {
            name: Point(max(tolerance, 1e-5) if name == "coarse" else tolerance, s, 1, 1, 1e-16)
            for name, s in seconds.items()
        }

    monkeypatch.setattr(work_curves, "run_point", run_point)
    (case,) = _cases("two_levels")
    solve = dict.fromkeys(seconds)
    (row,) = bodies._rows(case, solve, {1e-8: 1.5}, 1)
    assert (row.against, row.value, row.other) == ("fast", pytest.approx(1e3), pytest.approx(3e3))
    assert row.ratio == pytest.approx(3.0)
    assert row.met


def _cases(*names):
    from benchmarks.cases import cases

    return cases(names)


def test_times_give_medians_and_ratios_of_rounds():
    from benchmarks.timing import Times

    times = Times({"a": [1.0, 2.0, 9.0], "b": [2.0, 8.0, 9.0]})
    assert times.median("b") == 8.0
    assert times.ratio("b", "a") == 2.0
    row = times.row("x", "a", "ms a step", "b", "b", pieces=(2, 4))
    assert (row.value, row.other, row.ratio) == (1000.0, 2000.0, 1.0)
    assert times.row("x", "a", "µs", "b", "b", above=False).ratio == 0.5


def test_pages_are_rendered_from_the_stored_results(tmp_path):
    from benchmarks import page
    from benchmarks.__main__ import NAMES

    file = ROOT / "benchmarks" / "results.json"
    results = page.read(file)
    assert list(results) == [name for name in NAMES if name in results]
    assert {"rivals", "estimates"} <= set(results)
    environments = page.read_environments(file)
    assert set(environments) == set(results)
    page.write_pages(results, environments, tmp_path)
    pages = sorted(tmp_path.iterdir())
    assert len(pages) == 2
    for written in pages:
        stored = ROOT / "docs" / written.name
        assert written.read_text(encoding="utf-8") == stored.read_text(encoding="utf-8")
    details = [result.details for result in results.values() if result.details is not None]
    for result in (*results.values(), *details):
        for figure in result.figures:
            assert (ROOT / "docs" / f"{figure.name}.png").is_file()


@pytest.mark.parametrize("name", [
    "bodies", "calls", "ensemble", "linear", "long_times", "rivals", "steps", "stiff",
    "variational",
])  # fmt: skip
def test_stored_titles_and_methods_are_those_of_the_module(name):
    from importlib import import_module

    from benchmarks import page

    result = page.read(ROOT / "benchmarks" / "results.json")[name]
    module = import_module(f"benchmarks.{name}")
    assert result.title == module.TITLE
    assert result.method in {module.method_text(rounds) for rounds in [*range(1, 32), 1000]}


def test_results_are_stored_without_nan(tmp_path):
    from benchmarks import page
    from benchmarks.record import Aim, Result, Row

    rows = (Row("a", float("nan"), "s"), Row("b", 2.0, "s", "c", 3.0, 1.5, aim=Aim(1.0, True)))
    result = Result("Title", "method", rows[1:], ("note",), details=Result("Title", "all", rows))
    page.write({"one": result}, {"one": {"python": "3"}}, tmp_path / "results.json")
    stored = page.read(tmp_path / "results.json")["one"]
    assert (stored.rows, stored.notes) == (result.rows, result.notes)
    assert np.isnan(stored.details.rows[0].value)
    assert stored.details.rows[1] == rows[1]
    text = page.render({"one": stored}, {"one": {"python": "3"}})
    assert "| b | 2.00 s | c | 3.00 s | 1.50 | ratio ≥ 1: met |" in text
    assert text.endswith("1. python 3\n")
    assert "| a | none found |" in page.render_details({"one": stored})


def test_rejects_unknown_names(capsys):
    from benchmarks.__main__ import main

    with pytest.raises(SystemExit):
        main(["nothing"])
    assert "NAME must be one of rivals" in capsys.readouterr().err


@pytest.fixture(scope="module")
def problems():
    return list(linear_cases(quick=False))


def test_solutions_agree_with_those_of_scipy(problems):
    for problem in problems:
        run = dop853(problem)(1e-8)
        assert problem.case.error(run.points[-1]) < 1e-6
        assert run.evaluations > 0


def test_solutions_agree_with_those_of_qutip(problems):
    pytest.importorskip("qutip")
    solved = [problem for problem in problems if problem.hamiltonians is not None]
    assert len(solved) == 3
    for problem in solved:
        assert problem.case.error(qutip_solver(problem)(1e-9).points[-1]) < 1e-6


def test_magnus_methods_are_counted(problems):
    run = linear_solver(problems[0], "CFM8(4)")(1e-6)
    assert run.flows > run.evaluations > 0
    assert problems[0].case.error(run.points[-1]) < 1e-5
