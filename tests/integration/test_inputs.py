"""Samples as inputs of integrations."""

import copy
import ctypes
import pickle
import re

import numpy as np
import pytest
from compiled_examples import DOUBLES
from driven_bodies import FRAME, GAIN, GUST, GUSTS, LINE, START, TIGHT, TIMES, driven
from refusals import refuses
from scipy.interpolate import CubicSpline

import cg
from cg.frames import SO3, Euclidean, LinearAction

RNG = np.random.default_rng(3)
TORQUE = RNG.standard_normal((8, 3))


def torque(kind):
    edges = np.append(TIMES, 3.0) if kind in ("averages", "causal") else TIMES
    causal = kind == "causal"
    return cg.Samples(edges, TORQUE, "averages" if causal else kind, causal=causal)


def closed_form(kind, curve):
    """Return the curve as a function that doesn't use `cg.Samples` where there is one."""
    if kind == "hold":
        return lambda t: TORQUE[np.searchsorted(TIMES, t, side="right") - 1]
    if kind == "linear":
        return lambda t: np.array([np.interp(t, TIMES, column) for column in TORQUE.T])
    return CubicSpline(TIMES, TORQUE) if kind == "cubic" else curve


def by_hand(curve, kind="hold"):
    moment = closed_form(kind, curve)
    return lambda t, y, p: driven(t, y, (moment(t), np.interp(t, *GUSTS)), p)


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic", "averages", "causal"])
@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize(
    ("span", "way"),
    [
        ((0.0, 2.5), TIGHT), ((2.5, -0.5), {"h": 0.1, "method": "CF4"}),
        ((2.2, 0.1), {"method": "CF5(4)", **TIGHT}), ((-0.2, 2.0), {"h": 0.07, "method": "RKMK4"}),
    ],
)  # fmt: skip
def test_inputs_are_those_of_a_function_with_breakpoints(kind, in_c, span, way, function):
    curve = torque(kind)
    f = function("blown") if in_c else driven
    options = {"frame": FRAME, "parameters": GAIN, "dense_output": True, **way}
    run = cg.solve_ivp(f, span, START, inputs=(curve, GUST), **options)
    corners = np.unique(np.concatenate([c.corners(way.get("rtol")) for c in (curve, GUST)]))
    corners = corners[(corners > min(span)) & (corners < max(span))]
    if span[0] > span[1]:
        corners = corners[::-1]
    # a hold begins at the end of a span, which its last step must not see
    moment = by_hand(curve, kind)
    inside = np.nextafter(span, np.mean(span))
    reference = cg.solve_ivp(
        lambda t, y, p: moment(np.clip(t, *sorted(inside)), y, p), span, START, breakpoints=corners,
        **options,
    )  # fmt: skip
    assert run.steps == reference.steps
    atol = 1e-13 if "h" in way else 1e-9  # rounding changes the sizes of other steps
    np.testing.assert_allclose(run.y[-1], reference.y[-1], rtol=0, atol=atol)
    t = np.linspace(*span, 40)
    np.testing.assert_allclose(run.sol(t), reference.sol(t), rtol=0, atol=atol)


@pytest.mark.parametrize("span", [(0.0, 3.0), (3.0, 0.0), (0.0, 2.0), (2.0, 0.0), (0.5, 2.9)])
@pytest.mark.parametrize("way", [{"h": 0.25, "method": "CG3"}, {"method": "RKMK8(5,3)"}])
@pytest.mark.parametrize("in_c", [False, True])
def test_held_values_are_exact_on_both_sides_of_their_times(span, way, in_c, function):
    times = np.arange(3.0)
    held = cg.Samples(times, [1.0, -2.0, 4.0])
    f = function("slope_is_input") if in_c else (lambda t, y, u: [u])
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
def test_events_jumps_and_breakpoints(in_c, function, library):
    """Events see inputs, in Python and compiled; a jump in the inputs is where they cross."""
    curve = torque("hold")
    level = library["gust_level"]
    level.restype = ctypes.c_double
    level.argtypes = [ctypes.c_double, DOUBLES, ctypes.c_void_p]

    def events_of(gust):
        return [
            lambda t, y, *rest: y[9] - gust(t, rest),
            cg.Event(
                lambda t, y, *rest: y[10] - 0.2, terminal=3,
                jump=lambda t, y, *rest: np.append(y[:11], gust(t, rest)),
            ),
        ]  # fmt: skip

    events = events_of(lambda t, rest: rest[0][1])
    events[0] = level if in_c else events[0]
    events_by_hand = events_of(lambda t, rest: np.interp(t, *GUSTS))
    options = {"frame": FRAME, "parameters": GAIN, **TIGHT}
    run = cg.solve_ivp(
        function("blown") if in_c else driven, (0, 2.4), START, events=events,
        inputs=(curve, GUST), breakpoints=[0.77], **options,
    )  # fmt: skip
    stops = np.unique([0.77, *curve.corners(TIGHT["rtol"]), *GUST.corners()])
    reference = cg.solve_ivp(
        by_hand(curve), (0, 2.4), START, events=events_by_hand,
        breakpoints=stops[(stops > 0) & (stops < 2.4)], **options,
    )  # fmt: skip
    assert 0.77 in run.t
    assert [len(t) for t in run.t_events] == [len(t) for t in reference.t_events]
    assert sum(map(len, run.t_events)) > 1
    for got, expected in zip(run.t_events, reference.t_events, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.y[-1], reference.y[-1], rtol=0, atol=1e-9)
    copied = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(copied.y, run.y)


def spin(t, u):
    return np.array([u[0], u[1], 1.0])


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("method", ["auto", "CF4"])
def test_linear_equations(vectorized, method):
    pulse = cg.Samples(np.linspace(0, 1, 20), RNG.standard_normal((20, 2)))
    rows = lambda t, u: np.stack([u[:, 0], u[:, 1], np.ones(len(t))], axis=1)
    options = {"frame": SO3(), "method": method, **(TIGHT if method == "auto" else {"h": 0.05})}
    run = cg.solve_linear(
        rows if vectorized else spin, (0, 1.2), np.eye(3), inputs=pulse, vectorized=vectorized,
        **options,
    )  # fmt: skip
    point = np.eye(3)
    for value, size in zip(pulse.values, np.diff([*pulse.times, 1.2]), strict=True):
        point = SO3().flow(size * spin(0.0, value), point)
    np.testing.assert_allclose(run.y[-1], point, rtol=0, atol=1e-13)
    # the same fields, which multiply points on the right, as sparse matrices
    generators = [np.kron(np.eye(3), matrix.T) for matrix in SO3().field(np.eye(3), np.eye(3))]
    vector = cg.solve_linear(
        rows if vectorized else spin, (0, 1.2), np.eye(3).ravel(), inputs=pulse,
        vectorized=vectorized, **options | {"frame": LinearAction(generators)},
    )  # fmt: skip
    np.testing.assert_allclose(vector.y[-1], point.ravel(), rtol=0, atol=1e-9)


def driven_df_dp(t, y, u, p):
    return np.concatenate([np.zeros(3), u[0]])[:, None]


def driven_jac(t, y, u, p):
    identity, zero = np.eye(3), np.zeros((3, 3))
    return np.block([[zero, identity], [zero, -identity]])


@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("given", [False, True])
def test_derivatives(in_c, given, function):
    curve = torque("hold")
    mixed = function("blown_df_dp") if in_c else driven_df_dp
    derivatives = {"jac": driven_jac, "df_dp": mixed} if given else {}
    options = {"frame": FRAME, "parameters": GAIN, **TIGHT, "control_derivatives": True}
    event = lambda t, y, *_: y[9] - 0.3
    run = cg.solve_variational(
        function("blown") if in_c else driven, (0, 2), START, inputs=(curve, GUST), events=event,
        **derivatives, **options,
    )  # fmt: skip
    stops = np.union1d(curve.corners(TIGHT["rtol"]), GUST.corners())
    reference = cg.solve_variational(
        by_hand(curve), (0, 2 - 1e-15), START, events=event, **options,
        breakpoints=stops[(stops > 0) & (stops < 2)],
    )  # fmt: skip
    for name in ("y", "transition", "sensitivity"):
        got, expected = getattr(run, name)[-1], getattr(reference, name)[-1]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7)
    np.testing.assert_allclose(run.dt_events[0], reference.dt_events[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["python", "sparse", "vectorized", "differences"])
def test_stiff_equations_with_a_jacobian(kind):
    from scipy.sparse import csc_array

    held = cg.Samples([0.0, 0.5, 1.0], [1.0, 2.0, -1.0])
    matrix = np.array([[-1000.0, 0.0], [1.0, -1.0]])
    jac = {
        "python": lambda t, y, u: matrix * u**2,
        "sparse": lambda t, y, u: csc_array(matrix * u**2),
        "vectorized": lambda t, y, u: matrix * u[:, None, None] ** 2,
        "differences": None,
    }[kind]
    many = kind == "vectorized"
    f = lambda t, y, u: (
        u[:, None] ** 2 * (y @ matrix.T) + u[:, None] if many else u**2 * (matrix @ y) + u
    )
    solve = cg.solve_ensemble if many else cg.solve_ivp
    run = solve(
        f, (0, 1.5), np.ones((1, 2)) if many else [1.0, 1.0], frame=Euclidean(2), inputs=held,
        method="RadauIIA5", jac=jac, **({"vectorized": True} if many else {}), **TIGHT,
    )  # fmt: skip
    reference = cg.solve_ivp(
        lambda t, y: held(t) ** 2 * (matrix @ y) + held(t), (0, 1.5), [1.0, 1.0],
        frame=Euclidean(2), breakpoints=[0.5, 1.0], method="RadauIIA5", rtol=1e-11, atol=1e-11,
    )  # fmt: skip
    np.testing.assert_allclose(run.y[-1].ravel(), reference.y[-1], rtol=0, atol=1e-7)


@pytest.mark.parametrize("in_c", [False, True])
def test_steppers_end_steps_at_samples(in_c, function):
    f = function("blown") if in_c else driven
    inputs = (torque("hold"), GUST)
    options = {"frame": FRAME, "parameters": GAIN, **TIGHT}
    run = cg.solve_ivp(f, (0, 2.5), START, inputs=inputs, **options)
    stepper = cg.Stepper(f, 0.0, START, 2.5, inputs=inputs, **options)
    while stepper.status == "running":
        assert stepper.step() is None
        np.testing.assert_allclose(stepper.dense_output()(stepper.t), stepper.y, atol=1e-12)
    np.testing.assert_array_equal(stepper.y, run.y[-1])
    stepper = cg.Stepper(f, 0.0, START, inputs=inputs, **options)
    stepper.advance(0.3)  # the time of a sample
    if not in_c:
        stepper = pickle.loads(pickle.dumps(copy.copy(stepper)))
    stepper.advance(2.5)
    np.testing.assert_allclose(stepper.y, run.y[-1], rtol=0, atol=1e-8)
    refuses(ValueError, "t must lie within the times of the samples", stepper.advance, 2.6)
    refuses(RuntimeError, "inputs must lead beyond", stepper.step)


@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("way", [{"h": 0.1, "method": "CG4a"}, TIGHT])
def test_steppers_take_samples_as_they_arrive(in_c, way, function):
    """A causal loop sees what all samples at once give."""
    f = function("slope_is_input") if in_c else (lambda t, y, u: [u])
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
REFUSED = [
    ({"inputs": [1.0, 2.0]}, TypeError, "inputs must be cg.Samples"),
    ({"inputs": (HELD, 3.0)}, TypeError, r"inputs\[1\] must be cg.Samples"),
    ({"inputs": ()}, ValueError, "at least one"),
    ({"inputs": cg.Samples([0.5, 1], [1, 2])}, ValueError, "t_span must lie within the times"),
    ({"inputs": cg.Samples([0, 1], [1, 2], end=1.5)}, ValueError, "t_span must lie within"),
    ({"inputs": cg.Samples([0, 1], [[1, 2]], members=True)}, ValueError, "no members, got 1"),
    ({"inputs": HELD, "method": "CG4", "h": 0.1}, ValueError, "method must evaluate f within"),
]


@pytest.mark.parametrize(("options", "error", "message"), REFUSED)
def test_bad_inputs_are_named(options, error, message):
    with pytest.raises(error, match=message):
        cg.solve_ivp(lambda t, y, u: pytest.fail("called"), (0, 2), [0.0], frame=LINE, **options)


def test_compiled_functions_with_data_of_their_own_are_refused(function, library):
    data = cg.CompiledFunction(library._name, "slope_is_input", [1.0])
    with pytest.raises(ValueError, match="inputs must be None for a compiled f that has user_data"):
        cg.solve_ivp(data, (0, 1), [0.0], frame=LINE, inputs=HELD)
    level = cg.CompiledFunction(library._name, "gust_level")
    with pytest.raises(ValueError, match=r"events\[0\] must be in Python"):
        cg.solve_ivp(lambda t, y, u: [u], (0, 1), [0.0], frame=LINE, inputs=HELD, events=level)
    with pytest.raises(ValueError, match="3 members, got 2"):
        cg.solve_ensemble(
            driven, (0, 1), np.ones((3, 1)), frame=LINE,
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
    expected = rf"f({', '.join(['t', 'y', *names])}) with inputs u, got a function of (t, y)"
    f = lambda t, y: [0.0]
    for solve in (cg.solve_ivp, cg.solve_variational):
        refuses(TypeError, re.escape(expected), solve, f, (0, 1), [0.0], **options)
    members = options | {"parameters": [[1.0]]} if "parameters" in given else options
    refuses(TypeError, re.escape(expected), cg.solve_ensemble, f, (0, 1), [[0.0]], **members)
    refuses(TypeError, re.escape(expected), cg.Stepper, f, 0.0, [0.0], **options)
    of_time = re.escape(
        f"f({', '.join(['t', 'u', *names[1:]])}) with inputs u, got a function of (t)"
    )
    refuses(TypeError, of_time, cg.solve_linear, lambda t: [0.0], (0, 1), [0.0], **options)
    f = lambda t, y, u, *more: [float(np.sum(u)) + sum(map(np.sum, more))]
    assert cg.solve_ivp(f, (0, 1), [0.0], **options).success


def test_exceptions_say_how_functions_are_called():
    def fail(t, y, u):
        raise KeyError("mine")

    options = {"frame": LINE, "inputs": HELD, "h": 0.5, "method": "CF4"}
    for f, events, note in (
        (fail, None, "f is given (t, y, u, ...)"),
        (lambda t, y, u: [0.0], lambda t, y: 1.0, "in events[0](t, y, u, ...)"),
    ):
        with pytest.raises((KeyError, TypeError)) as caught:
            cg.solve_ivp(f, (0, 1), [0.0], events=events, **options)
        assert note in "".join(caught.value.__notes__)
