"""Linear equations by Magnus methods with brackets: steps, defaults, estimates, output."""

import numpy as np
import pytest
from bracket_examples import WITH
from frame_examples import HEISENBERG, name
from refusals import refuses

import cg
from cg.frames import SO, SU, LinearAction, U, UnitQuaternion

METHOD = cg.methods["Magnus8(4)"]


def wave(frame, seed, size=2.0):
    """Return random coefficients with four frequencies."""
    rng = np.random.default_rng(seed)
    amplitudes = size * rng.normal(size=(4, frame.dim)) / np.sqrt(frame.dim)
    frequencies, phases = rng.uniform(0.5, 4, 4), rng.uniform(0, 6, 4)
    return lambda t: np.cos(frequencies * t + phases) @ amplitudes


@pytest.mark.parametrize("frame", [*WITH, SU(4), U(3), SO(6)], ids=name)
def test_steps_follow_the_exponent(frame):
    """Compiled brackets, and those in Python, against `Frame.bracket`."""
    a, h, y0 = wave(frame, 1, 0.3), 0.5, frame.random_point(np.random.default_rng(2))
    fields = [np.asarray(a(c * h)) for c in METHOD.c]
    for pair in METHOD.brackets:
        u, v = ([float(x.value) for x in row] @ np.array(fields) for row in pair)
        fields.append(h * frame.bracket(u, v))
    exponent = h * np.array([float(x.value) for x in METHOD.weights[0]]) @ np.array(fields)
    run = cg.solve_linear(a, (0, h), y0, frame=frame, method=METHOD, h=h)
    assert (run.nexp, run.steps) == (1, 1)
    np.testing.assert_allclose(run.y[-1], frame.flow(exponent, y0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("frame", [SU(4), SU(8), SO(5), U(3), SU(16)], ids=repr)
def test_orders_and_errors_of_a_random_family(frame):
    """With the default: slopes of equal steps, and errors in tolerances."""
    slopes, quotients = [], []
    y0 = frame.random_point(np.random.default_rng(3))
    for seed in range(8):
        problem = wave(frame, seed), (0, 3), y0
        exact = cg.solve_linear(*problem, frame=frame, method="CFM8(4)", h=3 / 400).y[-1]
        runs = [cg.solve_linear(*problem, frame=frame, method=METHOD, h=3 / n) for n in (12, 24)]
        errors = [np.abs(run.y[-1] - exact).max() for run in runs]
        slopes.append(np.log2(errors[0] / errors[1]))
        for tolerance in (1e-4, 1e-7, 1e-10):
            run = cg.solve_linear(*problem, frame=frame, rtol=tolerance, atol=tolerance)
            quotients.append(np.abs(run.y[-1] - exact).max() / tolerance)
            assert run.nexp <= run.steps + run.nrejected + 1
    assert 7.5 < np.median(slopes) < 8.5
    assert np.median(quotients) < 0.3
    assert max(quotients) < 3


def test_the_estimate_sees_what_commutes_and_what_breaks():
    """Where all fields commute; jumps and kinks at random times."""
    z, frame = np.eye(15)[7], SU(4)
    options = {"frame": frame, "rtol": 1e-9, "atol": 1e-9}
    run = cg.solve_linear(lambda t: np.cos(20 * t) * z, (0, 2.3), np.eye(4), **options)
    exact = frame.flow(np.sin(46.0) / 20 * z, np.eye(4))
    assert np.abs(run.y[-1] - exact).max() < 1e-10
    for seed in range(12):
        a, place = wave(frame, seed), np.random.default_rng(seed).uniform(0.2, 1.8)

        def broken(t, a=a, place=place, kink=seed % 2):
            return a(t) * (1 + (t > place) * ((t - place) if kink else 1))

        problem = broken, (0, 2), np.eye(4)
        exact = cg.solve_linear(*problem, breakpoints=[place], **options | {"rtol": 1e-12}).y[-1]
        assert np.abs(cg.solve_linear(*problem, **options).y[-1] - exact).max() < 2e-9


def test_defaults():
    for frame, flows in [(SU(3), 1), (SO(4), 1), (UnitQuaternion(), 8), (HEISENBERG, 8)]:
        a = wave(frame, 0)
        y0 = frame.random_point(np.random.default_rng(1))
        assert cg.solve_linear(a, (0, 1), y0, frame=frame, h=0.25).nexp == 4 * flows
    matrices = [-1j * np.diag([1.0, -1.0]), -1j * np.array([[0, 1], [1, 0]])]
    run = cg.solve_linear(
        lambda t: [1.0, t], (0, 1), [1, 0], frame=LinearAction(matrices), method=METHOD, h=0.25
    )
    assert (run.nexp, run.nfev) == (4, 17)  # along polynomials, without brackets


def test_frames_without_brackets_are_refused():
    refuses(
        ValueError, r"method must be of Crouch-Grossman type or commutator-free on this frame, got "
        r"<MagnusMethod Magnus8\(4\).*which needs brackets", cg.solve_linear, lambda t: [1.0, t],
        (0, 1), np.zeros(3), frame=HEISENBERG, method=METHOD,
    )  # fmt: skip
