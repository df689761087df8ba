"""The loop over steps: grids, first steps, counts, ends of output."""

import gc
import re
import weakref
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from equal_grids import make_grid
from interpolants import extra_evaluations
from refusals import refuses

import cg
from cg.construction.catalogue import resolve_method
from cg.frames import SO3, Euclidean, MatrixFrame, Stiefel
from cg.integration.run import drive as run_drive
from cg.integration.run.drive import StepBudget

pytestmark = pytest.mark.sanitize

EXTRA = {
    **{"CG2": 0, "CG3": 0, "CG2(3)": 0, "CG4a": 3, "CF4": 3, "DICG4": 3, "CG5a": 6, "CF5(4)": 6},
    **{"CG6g": 10, "CF6(5)": 6, "CG7b": 15, "CF7(6)": 10, "CF8a": 15},
    **{"RKMK3(2)": 0, "RKMK4": 1, "RKMK5(4)": 2, "RKMK8(5,3)": 8},
}


@pytest.mark.parametrize(("units", "steps"), [(0, 1600), (1, 1600), (2, 1601)])
def test_rounding_of_whole_numbers_of_steps(units, steps):
    """Of ends a unit; of 1600 steps of size 1, whose unit is 1024 times smaller, 0.78 units."""
    unit = np.spacing(1600.0)
    grid = make_grid((0.0, 1600.0 + units * unit), 1.0)
    assert grid.steps == steps
    assert grid.last == (1.0 if steps == 1600 else 2 * unit)


def test_largest_tolerated_rounding():
    h, stop = 0.125 * (1.0 + 2.0**-52), 5.0 + 5 * 2.0**-50
    assert (Fraction(stop) + 3 - 64 * Fraction(h)) / Fraction(np.spacing(stop)) == 3
    grid = make_grid((-3.0, stop), h)  # the unit of 8 is two of these, 64 halves of that of h one
    assert (grid.steps, grid.last) == (64, h)


def test_times_that_coincide():
    for span in ((1e15, 1e15 + 1), (-1e15, 1 - 1e15), (1 - 1e15, -1e15)):
        with pytest.raises(ValueError, match=r"h must lead to distinct times in t_span"):
            make_grid(span, 1e-5)
        assert make_grid(span, 0.5).steps == 2
        assert make_grid(span, 2.0).steps == 1
    refuses(ValueError, "distinct times .* got 1e-300", make_grid, (0.0, 1.0), 1e-300)
    below = 1.0 - 2.0**-53  # the number before 1, nearer to it than the one after
    assert make_grid((below, 1.0), 2.0**-53).steps == 1
    refuses(ValueError, "distinct times", make_grid, (below, 1.0), 0.8 * 2.0**-53)


def test_evaluations_of_the_continuous_solution():
    """By the order of a method, and the stages that a node more may cost as many as."""
    values = {name: extra_evaluations(resolve_method(name)) for name in EXTRA}
    assert values == EXTRA


def test_plans_of_many_frames_and_methods_are_not_kept():
    def reference(k):
        method = cg.Tableau([[], ["1/2"]], [0, 1], name=f"{k}")
        frame = MatrixFrame([np.diag([1.0, float(k)])])
        cg.integrate(lambda t, y: [1.0], (0, 1), [1.0, 1.0], frame=frame, method=method, h=0.5)
        return weakref.ref(method)

    references = [reference(k) for k in range(200)]
    gc.collect()
    assert sum(each() is not None for each in references) <= 64


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.filterwarnings("ignore:invalid:RuntimeWarning")
@pytest.mark.parametrize("frame", [SO3(), Stiefel(3, 1)], ids=repr)
@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("common", [False, True])
@pytest.mark.filterwarnings("ignore:Failure of")
def test_one_member_whose_f_is_too_large_for_any_step(frame, vectorized, common):
    y0 = frame.random_point(np.random.default_rng(2), (2,))
    message = "f is too large to choose a step at t = 0, got [1.e+308 1.e+308 1.e+308]"
    with pytest.raises(OverflowError, match=re.escape(message)):
        cg.solve_ivp(lambda t, y: np.full(3, 1e308), (0, 1), y0[0], frame=frame)
    for bad, large in ((1, [[1.0], [1e308]]), (0, [[1e308], [1.0]])):
        solution = cg.solve_ensemble(
            lambda t, y, size: size * np.ones((*size.shape[:-1], 3)), (0, 1), y0, frame=frame,
            parameters=large, vectorized=vectorized, common_steps=common,
        )  # fmt: skip
        assert solution.messages == {bad: message}
        assert solution.status[bad] == -1
        assert solution.t_end[[bad, 1 - bad]].tolist() == [0.0, 1.0]


def test_coordinates_of_zero_need_an_absolute_tolerance():
    options = {"frame": Euclidean(2), "atol": [1e-6, 0.0]}
    message = re.escape(
        "atol must be positive for coordinates that are zero, got 0 at t = 0, y = ["
    )
    with pytest.raises(ValueError, match=message):
        cg.solve_ivp(lambda t, y: [1.0, 1.0], (0, 1), [0.0, 0.0], **options)
    assert cg.solve_ivp(lambda t, y: [1.0, 0.0], (0, 1), [0.0, 0.0], **options).success


def test_memory_for_steps_grows():
    run = cg.solve_ivp(
        lambda t, y: [1.0], (0, 10), [0.0], frame=Euclidean(1), method="BS3(2)", max_step=0.002
    )
    np.testing.assert_allclose(run.y[:, 0], run.t, rtol=0, atol=run.steps * np.spacing(10.0))
    assert len(run.t) == run.steps + 1


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(run_drive.time, "perf_counter", lambda: now[0])
    return now


@pytest.mark.parametrize("seconds_a_step", [1e-7, 1e-3, 1.0])
def test_pauses_come_to_the_same_time(seconds_a_step, clock):
    chosen = StepBudget()
    sizes = []
    for _ in range(12):
        sizes.append(chosen.start())
        clock[0] += sizes[-1] * seconds_a_step
        chosen.stop(sizes[-1])
    assert sizes[0] == 1
    assert max(b / a for a, b in pairwise(sizes)) <= 8
    assert sizes[-1] == pytest.approx(max(1, 0.03 / seconds_a_step), abs=1)


def test_budget_after_short_runs(clock):
    chosen = StepBudget()
    for _ in range(100):  # trajectories of five steps
        steps = min(chosen.start(), 5)
        clock[0] += steps * 1e-4
        chosen.stop(steps)
    assert chosen.start() == pytest.approx(300, abs=1)
