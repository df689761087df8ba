"""Ensembles: each member equals its solution alone, with all options."""

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SE3, SO3, SU, Euclidean, Sphere, UnitQuaternion
from cg.integration import ensemble
from cg.integration.plan.plan import plan_of
from cg.integration.run import drive
from cg.integration.run import run as run_module
from cg.tables import table_of

pytestmark = pytest.mark.sanitize

LINE = {"frame": Euclidean(1)}


def grown(t, y, rates):
    return rates * y


def rotated(t, y):
    return np.stack([np.cos(t), y[..., 0, 0], y[..., 1, 2]], axis=-1)


def test_indices_and_copies():
    y0 = SO3().random_point(np.random.default_rng(1), 3)
    solution = cg.solve_ensemble(
        rotated, (0, 1), y0, frame=SO3(), dense_output=True, events=lambda t, y: t - 0.5
    )
    assert len(solution) == 3
    np.testing.assert_array_equal([solution[i - 3].y for i in range(3)], [s.y for s in solution])
    for i in (3, -4):
        refuses(IndexError, rf"in range\(-3, 3\), got {i}", solution.__getitem__, i)
    refuses(TypeError, "member must be an integer", solution.__getitem__, slice(0, 2))
    assert [member.steps for member in solution] == solution.steps.tolist()
    assert "members=3" in repr(solution)
    assert "members=3" in repr(solution.sol)


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_results_do_not_depend_on_parts_and_pauses(size, compiled_function, monkeypatch):
    rates = np.linspace(-3, 3, 10)
    options = {
        "rtol": 1e-9, "atol": 1e-9, "dense_output": True, "t_eval": np.linspace(0, 1, 23),
        "events": lambda t, y, row: y[0] - 2.0, **LINE,
    }  # fmt: skip
    numbers = np.stack([rates, np.full(10, 1e9)], axis=-1)
    runs = {
        "compiled": lambda: cg.solve_ensemble(
            compiled_function("decays"), (0, 1), [1.0], parameters=numbers, **options
        ),
        "vectorized": lambda: cg.solve_ensemble(
            grown, (0, 1), [1.0], parameters=rates[:, None], vectorized=True, **options
        ),
    }
    for run in runs.values():
        whole = run()
        np.testing.assert_allclose(whole.y[..., 0], np.exp(np.outer(whole.t, rates)), rtol=5e-10)
        with monkeypatch.context() as patched:
            patched.setattr(ensemble, "_MEMBERS_PER_RUN", size)
            patched.setattr(drive, "_SECONDS", 0.0)
            parts = run()
        np.testing.assert_array_equal(parts.y, whole.y)
        np.testing.assert_array_equal(parts.sol(whole.t), whole.sol(whole.t))
        for count in ("steps", "nrejected", "nfev", "nexp", "njev", "nlu", "status"):
            np.testing.assert_array_equal(getattr(parts, count), getattr(whole, count))
        for ours, theirs in zip(parts.t_events[0], whole.t_events[0], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_results_do_not_depend_on_lanes(monkeypatch):
    """A vectorized function is called with whatever members are on their way."""
    sizes = set()

    def f(t, y, rates):
        sizes.add(len(t))
        return rates * y

    options = {
        "parameters": np.linspace(-3, 3, 7)[:, None], "vectorized": True, "rtol": 1e-7, **LINE,
    }  # fmt: skip
    whole = cg.solve_ensemble(f, (0, 1), [1.0], **options)
    assert max(sizes) == 7
    sizes.clear()
    monkeypatch.setattr(run_module, "_LANES", 2)
    parts = cg.solve_ensemble(f, (0, 1), [1.0], **options)
    assert max(sizes) == 2
    np.testing.assert_array_equal(parts.y, whole.y)
    np.testing.assert_array_equal(parts.nfev, whole.nfev)


def test_the_wrong_point_of_many_is_named():
    y0 = np.broadcast_to(np.eye(3), (10_000, 3, 3)).copy()
    y0[8007] *= 1.01
    refuses(ValueError, r"y0\[8007\] must", cg.solve_ensemble, rotated, (0, 1), y0, frame=SO3())
    y0[9003, 1, 1] = np.nan
    y0[9999] *= 2.0
    refuses(ValueError, r"y0\[9003\] must", cg.solve_ensemble, rotated, (0, 1), y0, frame=SO3())


@pytest.mark.parametrize("frame", [SO3(), SE3(), SU(2), Sphere(2), UnitQuaternion()], ids=repr)
def test_nan_is_never_surely_on_the_manifold(frame):
    plan = plan_of(frame, table_of("CG3"))
    point = frame.random_point(np.random.default_rng(4))
    assert plan.surely_on_manifold(plan.doubles(point[None]))
    for index in np.ndindex(point.shape):
        wrong = point.copy()
        wrong[index] = np.nan
        assert not plan.surely_on_manifold(plan.doubles(wrong[None]))


@pytest.mark.parametrize(("options", "count"), [
    ({"rtol": 1e-6, "atol": 1e-6}, 37), ({"method": "RKMK4", "h": 0.5}, 8),
])  # fmt: skip
@pytest.mark.parametrize("output", [{}, {"t_eval": [0.3, 1.0]}, {"dense_output": True}])
def test_calls_of_a_vectorized_function_do_not_depend_on_time(options, count, output, monkeypatch):
    """Equal members are evaluated together, however few steps are taken between interrupts."""
    sizes = []

    def f(t, y):
        sizes.append(len(t))
        return np.stack([np.cos(t), np.sin(t), y[:, 0, 0]], axis=1)

    y0 = np.tile(np.eye(3), (50, 1, 1))
    for seconds in (1e-9, 1e-3, 1.0):
        monkeypatch.setattr(drive, "_SECONDS", seconds)
        sizes.clear()
        run = cg.solve_ensemble(f, (0, 1), y0, frame=SO3(), vectorized=True, **options, **output)
        assert set(sizes) == {50}
        assert len(sizes) == run.nfev[0]
        assert len(sizes) == count or output
