"""Variable steps of splitting methods that stay reversible."""

import copy

import numpy as np
import pytest
from mechanics import INERTIA, system
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean, PhaseSpace, Product

PLANE = PhaseSpace(Euclidean(2))


def kepler(t, y):
    return -y[..., :2] / (y[..., :2] ** 2).sum(axis=-1, keepdims=True) ** 1.5


def size(t, y):
    return float((y[:2] ** 2).sum() ** 0.75)


def energy(y):
    return 0.5 * (y[..., 2:] ** 2).sum(axis=-1) - 1 / np.sqrt((y[..., :2] ** 2).sum(axis=-1))


def start(e):
    return np.array([1 - e, 0.0, 0.0, np.sqrt((1 + e) / (1 - e))])


def run(e, orbits, method="BlanesMoan6", **options):
    options = {"h": 0.1, "step_function": size, "method": method, **options}
    return cg.solve_ivp(kepler, (0, 2 * np.pi * orbits), start(e), frame=PLANE, **options)


def test_an_eccentric_orbit_keeps_its_energy():
    e = 0.9
    solution = run(e, 60)
    assert solution.status == 0
    error = np.abs(energy(solution.y) / energy(start(e)) - 1)
    tenth = len(error) // 10
    assert error.max() < 2e-8
    assert error[-tenth:].max() < 1.2 * error[:tenth].max()
    steps = np.diff(solution.t)[:-1]
    assert steps.max() / steps.min() > 40
    # equal steps, as many, lose the orbit
    equal = run(e, 60, h=2 * np.pi * 60 / len(steps), step_function=None)
    assert np.abs(energy(equal.y) / energy(start(e)) - 1).max() > 1e4 * error.max()


@pytest.mark.parametrize("method", ["Leapfrog", "McLachlan2"])
def test_steps_are_those_of_the_formula_and_reversible(method):
    e, h = 0.6, 0.1
    solution = run(e, 3, method, h=h)
    steps = np.diff(solution.t)[:-1]
    density = h / steps
    radius = np.hypot(*solution.y[:-2, :2].T)
    # d/dt log s = 1.5 r' / r
    change = 1.5 * (solution.y[:-2, :2] * solution.y[:-2, 2:]).sum(axis=1) / radius**2
    assert np.isclose(density[0], size(0.0, start(e)) ** -1, rtol=1e-14, atol=0.0)
    assert np.allclose(np.diff(density), -h * change[1:], rtol=0.0, atol=2e-6 * density.max())
    assert np.allclose(steps, h * radius**1.5, rtol=0.15)
    # from apocentre forward and backward the steps mirror each other
    far = np.array([1 + e, 0.0, 0.0, np.sqrt((1 - e) / (1 + e))])
    ahead, back = (
        cg.solve_ivp(kepler, (0, t), far, frame=PLANE, method=method, h=h, step_function=size)
        for t in (7.0, -7.0)
    )
    assert np.allclose(ahead.t, -back.t, rtol=0.0, atol=1e-12)
    assert np.allclose(ahead.y * [1, -1, -1, 1], back.y, rtol=0.0, atol=1e-11)


def test_slopes_are_orders_and_output_lies_between_steps():
    e, t = 0.6, np.linspace(0.0, 9.0, 7)
    exact = cg.solve_ivp(kepler, (0, 9), start(e), frame=PLANE, rtol=1e-12, atol=1e-12, t_eval=t).y
    errors = [
        np.abs(cg.solve_ivp(kepler, (0, 9), start(e), frame=PLANE, method="BlanesMoan4", h=h,
                            step_function=size, t_eval=t).y - exact).max() for h in (0.1, 0.05)
    ]  # fmt: skip
    assert errors[1] < 1e-6
    assert np.log2(errors[0] / errors[1]) > 3.3


def test_members_and_steppers_have_steps_of_their_own():
    y0 = np.stack([start(0.3), start(0.8)])
    options = {"frame": PLANE, "method": "BlanesMoan4", "h": 0.1, "step_function": size}
    for how in ({}, {"vectorized": True}, {"workers": 2}):
        both = cg.solve_ensemble(kepler, (0, 9), y0, **options, **how)
        for k in range(2):
            alone = cg.solve_ivp(kepler, (0, 9), y0[k], **options)
            assert np.allclose(both.y[-1, k], alone.y[-1], rtol=0.0, atol=1e-12)
    stepper = cg.Stepper(kepler, 0.0, y0[1], **options)
    while stepper.t < 5.0:
        stepper.step()
    assert np.isclose(stepper.t, alone.t[np.searchsorted(alone.t, 5.0)], rtol=0.0, atol=4e-14)


def test_restarts_give_the_size_new_arguments():
    seen = []

    def rate_of(t, y, rate):
        seen.append(rate)
        return rate

    stepper = cg.Stepper(
        lambda t, y, rate: kepler(t, y), 0.0, start(0.3), frame=PLANE, method="BlanesMoan4",
        h=0.1, step_function=rate_of, args=(1.0,),
    )  # fmt: skip
    stepper.step()
    stepper.restart(args=(0.5,))
    seen.clear()
    twin = copy.copy(stepper)
    for each in (stepper, twin):
        each.step()
    assert set(seen) == {0.5}
    assert twin.t == stepper.t


def test_on_rotations_and_parameters():
    top = system(Product(SO3(), Euclidean(1)), (INERTIA, 1.0))

    def slower(t, y, row):
        return 1.0 + row[0] * y[8] ** 2

    one = top.reference((0, 2)).y[-1]
    solution = cg.solve_ivp(
        lambda t, y, row: top.f(t, y), (0, 2), top.y0, frame=top.frame, method="BlanesMoan6",
        h=0.05, step_function=slower, parameters=[0.7],
    )  # fmt: skip
    assert np.allclose(solution.y[-1], one, rtol=0.0, atol=4e-11)
    assert np.ptp(np.diff(solution.t)[:-1]) > 0.005


@pytest.mark.parametrize(("options", "message"), [
    ({"method": "DOP853", "h": None}, "method must be a symmetric splitting method with"),
    ({"method": cg.Splitting([0, "2/3", "1/3"], ["1/4", "3/4"])}, "symmetric splitting method"),
    ({"thermostat": cg.Langevin(1.0, 1.0)}, "step_function must be None with thermostat"),
    ({"derivatives": "forward"}, "step_function must be None with derivatives"),
    ({"step_function": lambda t, y: -1.0}, "step_function must return a positive number, got -1.0"),
    ({"step_function": lambda t, y: 1.0 + y[2] ** 2}, "configuration alone, .* another momentum"),
    ({"step_function": lambda t, y: 1.0 + t}, "configuration alone, .* another time"),
    ({"step_function": lambda t, y: 1.0 if t < 1 else np.nan}, "step_function must return finite"),
])  # fmt: skip
def test_what_is_refused(options, message):
    refuses(ValueError, message, run, 0.5, 1, **options)
    if "configuration" in message:
        options |= {"frame": PLANE, "method": "Leapfrog", "h": 0.1}
        refuses(ValueError, message, cg.Stepper, kepler, 0.0, start(0.5), -1.0, **options)


@pytest.mark.filterwarnings("ignore:Failure of")
def test_steps_that_shrink_are_as_many_as_max_steps():
    tiny = run(0.5, 1, step_function=lambda t, y: 1e-9, max_steps=50)
    assert (tiny.success, tiny.steps) == (False, 50)
    assert "50 steps (max_steps)" in tiny.message
    assert run(0.5, 1).steps > 50
    refuses(ValueError, "max_steps must be at least 1, got 0", run, 0.5, 1, max_steps=0)


def test_a_list_is_refused_and_an_exception_of_the_function_is_its_own():
    refuses(TypeError, "step_function must be callable as", run, 0.5, 1, step_function=[size, size])
    own = TypeError("observe my own words")

    def fails(t, y):
        raise own

    with pytest.raises(TypeError) as caught:
        run(0.5, 1, step_function=fails)
    assert caught.value is own
