"""Detection of stiff equations, and of discontinuities."""

import warnings

import numpy as np
import pytest
from test_stiff import PLANE, START, pendulum, solve, van_der_pol

import cg


@pytest.mark.parametrize("method", ["auto", "RKMK5(4)", "BS3(2)"])
@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
def test_stiff(method, rtol):
    run = solve(method=method, rtol=rtol, max_steps=500, t1=2000.0)
    assert not run.success
    assert "stiff" in run.message
    assert "RadauIIA5" in run.message


@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
@pytest.mark.parametrize("f", [lambda t, y: [y[1], -1e4 * y[0]], pendulum])
def test_not_stiff(f, rtol):
    run = solve(f, 1e4, method="auto", rtol=rtol, max_steps=50)
    assert "max_steps = 50" in run.message
    assert "stiff" not in run.message


def test_warning_while_it_runs():
    with pytest.warns(UserWarning, match="many steps, since .* stiff.*RadauIIA5") as caught:
        run = solve(method="auto", max_steps=12_000, t1=2000.0)
    assert len(caught) == 1
    assert run.steps + run.nrejected == 12_000


@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
def test_no_warning_if_it_is_not_stiff(rtol, recwarn):
    run = solve(pendulum, 1e5, method="auto", rtol=rtol, max_steps=12_000)
    assert run.steps + run.nrejected == 12_000
    assert not recwarn


@pytest.mark.parametrize(
    ("workers", "executor"), [(None, None), (2, None), (2, "processes")], ids=str
)
def test_one_warning_for_an_ensemble(workers, executor, capfd):
    starts = [START, [1.0, 0.0]]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cg.solve_ensemble(
            van_der_pol, (0, 2000), starts, frame=PLANE, max_steps=25_000, workers=workers,
            executor=executor,
        )  # fmt: skip
    (warning,) = (w for w in caught if "many steps, since" in str(w.message))
    assert warning.filename == __file__
    assert "many steps" not in capfd.readouterr().err


@pytest.mark.parametrize("force", [0.5, 0.2])
def test_a_discontinuity_that_the_solution_stays_at(force):
    def friction(t, y):
        return [y[1], force * np.sin(t) - np.sign(y[1])]

    with pytest.warns(UserWarning, match="many steps, since f is discontinuous"):
        run = solve(friction, 20.0, [0.0, 1.0], method="auto", max_steps=12_000)
    assert f"{run.nrejected} of them were rejected; f is discontinuous" in run.message
    assert "event" in run.message
    assert "stiff" not in run.message


@pytest.mark.filterwarnings("ignore:Failure of")
def test_in_ensembles():
    run = cg.solve_ensemble(van_der_pol, (0, 2000), [START, [1.0, 0.0]], frame=PLANE, max_steps=500)
    assert "stiff" in run.message
