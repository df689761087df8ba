"""Samples in which something happens after an idle time, or between slow changes."""

import numpy as np
import pytest

import cg
from cg.frames import UnitQuaternion

TIMES = np.arange(0.0, 20001.0)
FRAME, START = UnitQuaternion(), [0.0, 0.0, 0.0, 1.0]


def bump(start, width, times=TIMES):
    """Return a smooth pulse whose integral is one."""
    x = (times - start) / width
    return np.where(abs(x - 0.5) < 0.5, (1 - np.cos(2 * np.pi * x)) / width, 0.0)


PULSE = bump(13000, 200)


def samples(kind, values=PULSE, **options):
    """Return a curve, of means near the values if the kind has such."""
    if kind in ("averages", "causal"):
        axis = 1 if "members" in options else 0
        values = np.moveaxis(np.asarray(values), axis, 0)
        values = np.moveaxis(0.5 * (values[1:] + values[:-1]), 0, axis)
    causal = {"causal": True} if kind == "causal" else {}
    return cg.Samples(TIMES, values, "averages" if causal else kind, **causal, **options)


def turn(t, q, u):
    return [u, 0.0, 0.0]


def turn_by_time(t, u):
    return [u, 0.0, 0.0]


def turn_all(t, q, u):
    return np.stack([u, 0 * u, 0 * u], axis=1)


def angle(q):
    return 2 * np.arctan2(q[..., 0], q[..., 3])


def ensemble(**options):
    def solve(span, curve, **rest):
        points = np.tile(START, (2, 1))
        f = turn_all if options.get("vectorized") else turn
        return cg.solve_ensemble(f, span, points, inputs=curve, **options, **rest).y[-1, 0]

    return solve


def ensemble_of_inputs(span, curve, **rest):
    values = np.stack([curve.values, 0 * curve.values])
    causal = {"causal": True} if curve.causal else {}
    curves = cg.Samples(curve.times, values, curve.kind, members=True, **causal)
    return cg.solve_ensemble(turn, span, np.tile(START, (2, 1)), inputs=curves, **rest).y[-1, 0]


def stepper(span, curve, **rest):
    stepper = cg.Stepper(turn, span[0], START, span[1], inputs=samples("hold", 0 * PULSE), **rest)
    stepper.restart(inputs=curve)
    while stepper.status == "running":
        stepper.step()
    return stepper.y


def single(solve, f=turn, **fixed):
    return lambda span, curve, **rest: solve(f, span, START, inputs=curve, **fixed, **rest).y[-1]


WAYS = {
    "ivp": single(cg.solve_ivp), "implicit": single(cg.solve_ivp, method="RadauIIA5"),
    "linear": single(cg.solve_linear, turn_by_time),
    "variational": single(cg.solve_variational),
    "adjoint": single(cg.solve_variational, derivatives="adjoint"), "ensemble": ensemble(),
    "common": ensemble(common_steps=True), "vectorized": ensemble(vectorized=True),
    "members": ensemble_of_inputs, "stepper": stepper,
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", ["cubic", "averages"])
def test_no_caller_passes_over_a_pulse(way, kind):
    for span in ((0.0, 20000.0), (20000.0, 0.0)):
        for tolerance in (1e-3, 1e-6):
            end = WAYS[way](span, samples(kind), frame=FRAME, rtol=tolerance, atol=tolerance)
            assert abs(angle(end) - np.sign(span[1] - span[0])) < tolerance


def integral(curve):
    """Return the integral of a curve, by Gauss's formula on each piece."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    length = np.diff(curve.times)[:, None]
    at = curve.times[:-1, None] + length * (nodes + 1) / 2
    return (curve.at(at.ravel()).reshape(at.shape) @ weights) @ length[:, 0] / 2


@pytest.mark.parametrize("kind", ["cubic", "averages"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-6])
def test_steps_depend_on_no_unit_and_no_column_that_is_smooth(kind, tolerance):
    def solve(columns, scale):
        return cg.solve_ivp(
            lambda t, q, u: [u[0] / scale, 0.0, 0.0], (0, 20000), START, frame=FRAME,
            rtol=tolerance, atol=tolerance,
            inputs=samples(kind, scale * np.stack([PULSE, *columns], axis=1)),
        )  # fmt: skip

    alone = solve([], 1.0)
    for columns, scale in (([], 2.0**20), ([], 2.0**-20), ([np.full(len(TIMES), 101325.0)], 1.0)):
        run = solve(columns, scale)
        np.testing.assert_allclose(run.t, alone.t, rtol=1e-10)  # rounding over the tolerance
        assert abs(angle(run.y[-1]) - 1.0) < tolerance
    offset = cg.solve_ivp(
        lambda t, q, u: [u - 273.15, 0.0, 0.0], (0, 20000), START, frame=FRAME, rtol=tolerance,
        atol=tolerance, inputs=samples(kind, PULSE + 273.15),
    )  # fmt: skip
    assert abs(angle(offset.y[-1]) - 1.0) < tolerance


@pytest.mark.parametrize("kind", ["cubic", "averages"])
def test_idle_and_smooth_times_take_few_steps(kind):
    def steps(values, tolerance=1e-4):
        return cg.solve_ivp(
            turn, (0, 20000), START, frame=FRAME, inputs=samples(kind, values), rtol=tolerance,
            atol=tolerance,
        ).steps  # fmt: skip

    assert steps(np.zeros(len(TIMES))) < 8
    assert steps(PULSE) < 100
    assert steps(2e-4 * np.sin(TIMES / 1500)) < 30
    assert steps(2e-4 * np.sin(TIMES / 1500), 1e-6) < 40
    # what is at rest before a motion is compared to it
    noise = np.random.default_rng(2).standard_normal(len(TIMES))
    assert steps(PULSE + 1e-11 * noise) < 100


def burst(kind, seed, turn):
    """Return samples of which one turns by an angle, and two others by less, about near axes."""
    random = np.random.default_rng(seed)
    axis = random.standard_normal(3)
    values = np.tile(0.05 * random.standard_normal(3), (24, 1))
    values[9] += turn * axis / np.linalg.norm(axis)
    values[10:12] += 0.3 * turn * axis + 0.1 * turn * random.standard_normal((2, 3))
    return cg.Samples(np.arange(24.0 + (kind == "averages")), values, kind)


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic", "averages"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-10])
def test_samples_that_turn_far(kind, tolerance):
    for seed in range(12):
        curve = burst(kind, seed, 1.0 + seed / 4)

        def solve(curve=curve, linear=False, **options):
            f = (lambda t, u: u) if linear else (lambda t, q, u: u)
            return cg.solve_ivp(
                f, (0, 23), START, frame=FRAME, inputs=curve, linear=linear, **options
            ).y[-1]

        exact = solve(rtol=1e-13, atol=1e-13, method="Verner8(7)", max_step=0.125)
        for linear in (False, True):
            end = solve(rtol=tolerance, atol=tolerance, linear=linear)
            assert np.linalg.norm(end - exact) < 50 * 2 * tolerance, (seed, linear)


def test_a_step_over_the_first_two_pieces_of_a_spline():
    values = np.tile([0.0016, 0.0022, 0.0], (31, 1))
    values[3:5] += [[-0.6, 1.8, 0.1], [-0.3, 0.2, -0.7]]
    curve = cg.Samples(np.arange(31.0), values, "cubic")
    options = {"frame": FRAME, "inputs": curve, "linear": True}
    exact = cg.solve_ivp(
        lambda t, u: u, (0, 30), START, rtol=1e-13, atol=1e-13, max_step=0.05, **options
    ).y[-1]
    for tolerance in (1e-6, 1e-8, 1e-10):
        end = cg.solve_ivp(
            lambda t, u: u, (0, 30), START, rtol=tolerance, atol=tolerance, **options
        ).y[-1]
        assert np.linalg.norm(end - exact) < 5 * tolerance
