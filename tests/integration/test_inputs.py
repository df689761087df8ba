"""Samples as inputs of integrations."""

import re

import numpy as np
import pytest
from refusals import refuses
from waves import TIGHT

import cg

LINE = cg.frames.Euclidean(1)
RNG = np.random.default_rng(3)


@pytest.mark.parametrize("span", [(0.0, 3.0), (3.0, 0.0), (0.0, 2.0), (2.0, 0.0), (0.5, 2.9)])
@pytest.mark.parametrize("way", [{"h": 0.25, "method": "CG3"}, {"method": "RKMK8(5,3)"}])
@pytest.mark.parametrize("in_c", [False, True])
def test_held_values_are_exact_on_both_sides_of_their_times(span, way, in_c, compiled_function):
    times = np.arange(3.0)
    held = cg.Samples(times, [1.0, -2.0, 4.0])
    f = compiled_function("slope_is_input") if in_c else (lambda t, y, u: [u])
    integral = lambda t: np.interp(t, [0, 1, 2, 3], [0, 1, -1, 3])
    run = cg.solve_ivp(f, span, [0.0], frame=LINE, inputs=held, t_eval=span, **way)
    expected = integral(span[1]) - integral(span[0])
    np.testing.assert_allclose(run.y[-1], expected, rtol=0, atol=4e-15)
    assert run.nrejected == 0


def test_times_of_several_rates_that_differ_by_rounding():
    first = cg.Samples(0.1 * np.arange(10), np.arange(10.0))
    second = cg.Samples(np.cumsum(np.full(10, 0.1)) - 0.1, 100 * np.arange(10.0))
    assert len(np.union1d(first.times, second.times)) > 10
    for way in ({}, {"h": 0.05, "method": "CF4"}):
        run = cg.solve_ivp(
            lambda t, y, u: [u[0] + u[1]], (0, 1), [0.0], frame=LINE, inputs=(first, second), **way
        )
        np.testing.assert_allclose(run.y[-1], 454.5, rtol=1e-14)


@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("way", [{"h": 0.1, "method": "CG4a"}, TIGHT])
def test_steppers_take_samples_as_they_arrive(in_c, way, compiled_function):
    """A causal loop sees what all samples at once give."""
    f = compiled_function("slope_is_input") if in_c else (lambda t, y, u: [u])
    values = RNG.standard_normal(5)
    stepper = cg.Stepper(
        f, 0.0, [0.0], frame=LINE, inputs=cg.Samples([0.0, 1.0], values[:1], "averages"), **way
    )
    stepper.advance(1.0)
    for k in range(1, 5):
        stepper.restart(inputs=cg.Samples([k, k + 1.0], values[k : k + 1], "averages"))
        stepper.advance(k + 1.0)
    np.testing.assert_allclose(stepper.y, values.sum(), rtol=0, atol=1e-14)
    stepper.restart(t=0.0, y=[0.0], inputs=cg.Samples([0.0, 1, 2, 3], [1.0, -1.0, 1.0, 2.0]))
    stepper.advance(3.5)
    np.testing.assert_allclose(stepper.y, 2.0, rtol=0, atol=1e-14)


HELD = cg.Samples([0.0, 1.0], [1.0, 2.0])
EACH = cg.Samples([0.0, 1.0], [[1.0, 2.0]], members=True)
REFUSED = [
    ({"inputs": [1.0, 2.0]}, TypeError, "inputs must be cg.Samples"),
    ({"inputs": (HELD, 3.0)}, TypeError, r"inputs\[1\] must be cg.Samples"),
    ({"inputs": ()}, ValueError, "at least one"),
    ({"inputs": cg.Samples([0.5, 1], [1, 2])}, ValueError, "t_span must lie within the times"),
    ({"inputs": cg.Samples([0, 1], [1, 2], end=1.5)}, ValueError, "t_span must lie within"),
    ({"inputs": EACH}, ValueError, "inputs must be without members=True here"),
    ({"inputs": HELD, "method": "CG4", "h": 0.1}, ValueError, "method must evaluate f within"),
]


@pytest.mark.parametrize(("options", "error", "message"), REFUSED)
def test_bad_inputs_are_named(options, error, message):
    with pytest.raises(error, match=message):
        cg.solve_ivp(lambda t, y, u: pytest.fail("called"), (0, 2), [0.0], frame=LINE, **options)


def test_compiled_functions_with_data_of_their_own_are_refused(compiled_function, compiled_library):
    data = cg.CompiledFunction(compiled_library._name, "slope_is_input", [1.0])
    with pytest.raises(ValueError, match="inputs must be None for a compiled f that has user_data"):
        cg.solve_ivp(data, (0, 1), [0.0], frame=LINE, inputs=HELD)
    level = cg.CompiledFunction(compiled_library._name, "gust_level")
    with pytest.raises(ValueError, match=r"events\[0\] must be in Python"):
        cg.solve_ivp(lambda t, y, u: [u], (0, 1), [0.0], frame=LINE, inputs=HELD, events=level)
    with pytest.raises(ValueError, match=r"for 3 members, got Samples\(1 times.*members=2"):
        cg.solve_ensemble(
            lambda t, y, u: [u], (0, 1), np.ones((3, 1)), frame=LINE,
            inputs=cg.Samples([0.0], [[1.0], [2.0]], members=True),
        )  # fmt: skip
    stepper = cg.Stepper(lambda t, y, u: [u], 0.0, [0.0], frame=LINE, inputs=HELD)
    with pytest.raises(ValueError, match="inputs must be like"):
        stepper.restart(inputs=cg.Samples([0.0], [[1.0, 2.0]]))
    with pytest.raises(ValueError, match="initial time must lie within"):
        cg.Stepper(lambda t, y, u: [u], -1.0, [0.0], frame=LINE, inputs=HELD)


@pytest.mark.parametrize("inputs", [HELD, (HELD, HELD)])
@pytest.mark.parametrize("given", [{}, {"args": (1.0,)}, {"parameters": [1.0]}])
def test_functions_without_inputs_are_refused(inputs, given):
    options = {"frame": LINE, "inputs": inputs, **given}
    names = ["u", *(name.replace("args", "args[0]") for name in given)]
    expected = re.escape(f"f is given ({', '.join(['t', 'y', *names])})")
    f = lambda t, y: [0.0]
    refuses(TypeError, expected, cg.solve_ivp, f, (0, 1), [0.0], **options)
    refuses(TypeError, "positional", cg.solve_variational, f, (0, 1), [0.0], **options)
    members = options | {"parameters": [[1.0]]} if "parameters" in given else options
    refuses(TypeError, expected, cg.solve_ensemble, f, (0, 1), [[0.0]], **members)
    refuses(TypeError, expected, cg.Stepper(f, 0.0, [0.0], **options).step)
    of_time = re.escape(f"f is given ({', '.join(['t', *names])})")
    refuses(TypeError, of_time, cg.solve_linear, lambda t: [0.0], (0, 1), [0.0], **options)
    f = lambda t, y, u, *more: [float(np.sum(u)) + sum(map(np.sum, more))]
    assert cg.solve_ivp(f, (0, 1), [0.0], **options).success


def test_exceptions_say_how_functions_are_called():
    def fail(t, y, u):
        raise KeyError("mine")

    options = {"frame": LINE, "inputs": HELD, "h": 0.5, "method": "CF4"}
    for f, events, note in (
        (fail, None, "f is given (t, y, u)"),
        (lambda t, y, u: [0.0], lambda t, y: 1.0, "in events[0](t, y, u, ...)"),
    ):
        with pytest.raises((KeyError, TypeError)) as caught:
            cg.solve_ivp(f, (0, 1), [0.0], events=events, **options)
        assert note in "".join(caught.value.__notes__)


class TestTimesOfTheirOwn:
    """Lists of inputs; the model's programs have them."""

    CURVES = [HELD] * 5

    def test_they_say_how_many_members_there_are_and_steppers_refuse_them(self):
        f, options = lambda t, y, u: [u], {"frame": LINE, "inputs": self.CURVES}
        assert len(cg.solve_ensemble(f, (0, 2), [0.0], **options)) == 5
        message = "those of members with members=True"
        refuses(ValueError, message, cg.Stepper, f, 0.0, np.zeros((5, 1)), 2.0, **options)

    @pytest.mark.parametrize(("inputs", "message"), [
        (CURVES[:2], "a list of 5 such"), ([*CURVES[:4], 3], r"inputs\[4\]: inputs must be"),
        ([*CURVES[:4], (CURVES[0],)], r"inputs\[4\]: inputs must be like"),
        ([*CURVES[:4], cg.Samples([0, 1, 1.5], [1, 2, 3], "linear")], r"inputs\[4\]: t_span"),
    ])  # fmt: skip
    def test_bad_lists(self, inputs, message):
        with pytest.raises((TypeError, ValueError), match=message):
            cg.solve_ensemble(
                lambda t, y, u: [u, 0, 1], (0, 2), np.stack(5 * [np.eye(3)]),
                frame=cg.frames.SO3(), inputs=inputs,
            )  # fmt: skip
