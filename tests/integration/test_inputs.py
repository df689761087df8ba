"""Samples as inputs of integrations."""

import copy
import ctypes
import pickle

import numpy as np
import pytest
from compiled_examples import DOUBLES
from scipy.interpolate import CubicSpline

import cg
from cg.frames import SO3, Euclidean, LinearAction, Product

RNG = np.random.default_rng(3)
FRAME, LINE = Product(SO3(), Euclidean(3)), Euclidean(1)
START = np.concatenate([np.eye(3).ravel(), [0.3, -0.2, 0.5]])
TIMES = np.array([-0.5, 0.0, 0.3, 0.45, 1.0, 1.4, 2.0, 2.5])
TORQUE = RNG.standard_normal((8, 3))
GUSTS = np.linspace(-0.5, 2.5, 11), RNG.standard_normal(11)
GUST = cg.Samples(*GUSTS, "linear")
GAIN = [1.5]
TIGHT = {"rtol": 1e-9, "atol": 1e-9}


def torque(kind):
    edges = np.append(TIMES, 3.0) if kind in ("averages", "causal") else TIMES
    causal = kind == "causal"
    return cg.Samples(edges, TORQUE, "averages" if causal else kind, causal=causal)


def driven(t, y, u, p):
    moment, gust = u
    slope = p[0] * moment - y[9:]
    slope[0] += gust
    return np.concatenate([y[9:], slope])


def driven_rows(t, y, u, p):
    moment, gust = u
    slope = p[:, :1] * moment - y[:, 9:]
    slope[:, 0] += gust
    return np.concatenate([y[:, 9:], slope], axis=1)


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
    corners = np.unique(np.concatenate([curve.corners, GUST.corners]))
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
    atol = 1e-13 if "h" in way else 2e-9  # rounding changes the sizes of other steps
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
    integral = lambda t: np.interp(t, [0, 1, 2, 3], [0, 1, -1, 3])  # noqa: E731
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


def test_few_evaluations_of_a_quadrotor_like_loop():
    """Motors change 100 times a second, and the steps end there."""
    t = np.arange(0, 5, 0.01)
    motors = cg.Samples(t, 0.3 * np.sin(3 * t)[:, None] + RNG.normal(0, 0.2, (500, 3)))
    index = lambda t, y: driven(t, y, (motors(t), 0.0), GAIN)  # noqa: E731
    options = {"frame": FRAME, "rtol": 1e-6, "atol": 1e-8, "method": "CF5(4)"}
    run = cg.solve_ivp(
        lambda t, y, u: driven(t, y, (u, 0.0), GAIN), (0, 5), START, inputs=motors, **options
    )
    with pytest.warns(UserWarning, match="breakpoints"):
        blind = cg.solve_ivp(index, (0, 5), START, **options)
    assert run.nfev < 0.2 * blind.nfev
    assert run.nrejected < 10


@pytest.mark.parametrize("in_c", [False, True])
def test_events_jumps_and_breakpoints(in_c, function, library):
    """Events see inputs, in Python and compiled; a jump in the inputs is where they cross."""
    curve = torque("hold")
    level = library["gust_level"]
    level.restype = ctypes.c_double
    level.argtypes = [ctypes.c_double, DOUBLES, ctypes.c_void_p]
    jumps = cg.Event(
        lambda t, y, u, p: y[10] - 0.2, jump=lambda t, y, u, p: np.append(y[:11], u[1]), terminal=3
    )
    events = [level if in_c else (lambda t, y, u, p: y[9] - u[1]), jumps]
    other = by_hand(curve)
    gust = lambda t: np.interp(t, *GUSTS)  # noqa: E731
    plain = [
        lambda t, y, p: y[9] - gust(t),
        cg.Event(
            lambda t, y, p: y[10] - 0.2, jump=lambda t, y, p: np.append(y[:11], gust(t)), terminal=3
        ),
    ]
    options = {"frame": FRAME, "parameters": GAIN, **TIGHT}
    run = cg.solve_ivp(
        function("blown") if in_c else driven, (0, 2.4), START, events=events,
        inputs=(curve, GUST), breakpoints=[0.77], **options,
    )  # fmt: skip
    stops = np.unique([0.77, *curve.corners, *GUST.corners])
    reference = cg.solve_ivp(
        other, (0, 2.4), START, events=plain, breakpoints=stops[(stops > 0) & (stops < 2.4)],
        **options,
    )  # fmt: skip
    assert 0.77 in run.t
    assert [len(t) for t in run.t_events] == [len(t) for t in reference.t_events]
    assert sum(map(len, run.t_events)) > 1
    for got, expected in zip(run.t_events, reference.t_events, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.y[-1], reference.y[-1], rtol=0, atol=1e-9)
    copied = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(copied.y, run.y)


MEMBERS = 7
OF_EACH = RNG.standard_normal((MEMBERS, 8, 3))
OWN = cg.Samples(TIMES, OF_EACH, members=True)
GAINS = np.linspace(0.5, 2.0, MEMBERS)[:, None]
EACH = {"frame": FRAME, "parameters": GAINS, "inputs": (OWN, GUST), **TIGHT}
ALONE = {"frame": FRAME, **TIGHT}


def alone(k, **options):
    own = cg.Samples(TIMES, OF_EACH[k])
    return cg.solve_ivp(
        driven, (0, 2.4), START, parameters=GAINS[k], inputs=(own, GUST), **ALONE | options
    )


@pytest.mark.parametrize("workers", [{}, {"workers": 2}, {"executor": "processes", "workers": 2}])
@pytest.mark.parametrize("kind", ["python", "vectorized", "compiled"])
def test_members_have_inputs_of_their_own(workers, kind, library):
    f = {
        "python": driven,
        "vectorized": driven_rows,
        "compiled": cg.CompiledFunction(library._name, "blown"),
    }[kind]
    run = cg.solve_ensemble(
        f, (0, 2.4), START, vectorized=kind == "vectorized", t_eval=[0.0, 1.1, 2.4], **workers,
        **EACH,
    )  # fmt: skip
    for k in range(MEMBERS):
        expected = alone(k, t_eval=[0.0, 1.1, 2.4]).y
        atol = 0.0 if kind == "python" else 1e-13
        np.testing.assert_allclose(run.y[:, k], expected, rtol=0, atol=atol)


def test_members_without_parameters_and_those_that_fail():
    held = cg.Samples([0.0, 1.0], [[0.5, 0.5], [0.5, -1.0], [0.5, 9.0]], members=True)
    f = lambda t, y, u: [u * y[0] ** 2]  # noqa: E731
    with pytest.warns(UserWarning, match="1 of 3 trajectories"):
        run = cg.solve_ensemble(
            f, (0, 1.5), np.ones((3, 1)), frame=LINE, inputs=held, t_eval=[1.0, 1.5], **TIGHT
        )
    assert run.status.tolist() == [0, 0, -1]
    np.testing.assert_allclose(run.y[0], 2.0, rtol=1e-7)
    np.testing.assert_allclose(run.y[1, :2, 0], [4.0, 1.0], rtol=1e-7)
    events = lambda t, y, u: u  # noqa: E731
    signs = cg.solve_ensemble(
        f, (0, 1.5), np.ones((2, 1)), frame=LINE, events=events, workers=2,
        inputs=cg.Samples([0.0, 1.0], [[0.1, 0.2], [0.1, -1.0]], members=True),
    )  # fmt: skip
    assert [len(t) for t in signs.t_events[0]] == [0, 1]
    assert signs.t_events[0][1][0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("common", [False, True])
def test_vectorized_members_take_rows(common):
    seen = []

    def f(t, y, u):
        seen.append((t.shape, u.shape))
        return u[:, None] * y

    held = cg.Samples([0.0, 1.0], RNG.standard_normal((4, 2)), members=True)
    run = cg.solve_ensemble(
        f, (0, 2), np.ones((4, 1)), frame=LINE, inputs=held, vectorized=True, common_steps=common,
        **TIGHT,
    )  # fmt: skip
    np.testing.assert_allclose(run.y[-1, :, 0], np.exp(held.values.sum(axis=1)), rtol=1e-8)
    assert all(a == b for a, b in seen)


def spin(t, u):
    return np.array([u[0], u[1], 1.0])


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("method", ["auto", "CF4"])
def test_linear_equations(vectorized, method):
    pulse = cg.Samples(np.linspace(0, 1, 20), RNG.standard_normal((20, 2)))
    rows = lambda t, u: np.stack([u[:, 0], u[:, 1], np.ones(len(t))], axis=1)  # noqa: E731
    options = {"frame": SO3(), "method": method, **(TIGHT if method == "auto" else {"h": 0.05})}
    run = cg.solve_linear(
        rows if vectorized else spin, (0, 1.2), np.eye(3), inputs=pulse, vectorized=vectorized,
        **options,
    )  # fmt: skip
    point = np.eye(3)
    for value, size in zip(pulse.values, np.diff([*pulse.times, 1.2]), strict=True):
        point = SO3().flow(size * spin(0.0, value), point)
    np.testing.assert_allclose(run.y[-1], point, rtol=0, atol=1e-13)


def test_controls_of_a_linear_action(function):
    h = RNG.standard_normal((3, 4, 4))
    frame = LinearAction([m - m.T for m in h])
    pulse = cg.Samples([0.0, 0.4, 0.7], [[1.0, 0.2], [-0.5, 0.0], [0.3, -1.0]])
    run = cg.solve_linear(
        lambda t, u: [1.0, *u], (0, 1), np.eye(4)[0], frame=frame, inputs=pulse, **TIGHT
    )
    other = cg.solve_linear(
        lambda t: [1.0, *pulse(t)], (0, 1), np.eye(4)[0], frame=frame, breakpoints=[0.4, 0.7],
        **TIGHT,
    )  # fmt: skip
    np.testing.assert_array_equal(run.y[-1], other.y[-1])


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
    event = lambda t, y, *_: y[9] - 0.3  # noqa: E731
    run = cg.solve_variational(
        function("blown") if in_c else driven, (0, 2), START, inputs=(curve, GUST), events=event,
        **derivatives, **options,
    )  # fmt: skip
    stops = np.union1d(curve.corners, GUST.corners)
    reference = cg.solve_variational(
        by_hand(curve), (0, 2 - 1e-15), START, events=event, **options,
        breakpoints=stops[(stops > 0) & (stops < 2)],
    )  # fmt: skip
    for name in ("y", "transition", "sensitivity"):
        got, expected = getattr(run, name)[-1], getattr(reference, name)[-1]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7)
    np.testing.assert_allclose(run.dt_events[0], reference.dt_events[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["python", "vectorized", "compiled"])
def test_derivatives_of_members(kind, function):
    f = {"python": driven, "vectorized": driven_rows, "compiled": function("blown")}[kind]
    run = cg.solve_variational_ensemble(
        f, (0, 1.5), START, vectorized=kind == "vectorized", workers=2,
        events=lambda t, y, u, p: y[9] - u[1], **EACH,
    )  # fmt: skip
    for k in (0, MEMBERS - 1):
        expected = cg.solve_variational(
            driven, (0, 1.5), START, parameters=GAINS[k],
            inputs=(cg.Samples(TIMES, OF_EACH[k]), GUST), **ALONE,
        )  # fmt: skip
        for name in ("transition", "sensitivity"):
            got, want = getattr(run[k], name)[-1], getattr(expected, name)[-1]
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-9)


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
    f = lambda t, y, u: (  # noqa: E731
        u[:, None] ** 2 * (y @ matrix.T) + u[:, None] if many else u**2 * (matrix @ y) + u
    )
    solve = cg.solve_ensemble if many else cg.solve_ivp
    run = solve(
        f, (0, 1.5), np.ones((1, 2)) if many else [1.0, 1.0], frame=Euclidean(2), inputs=held,
        method="RadauIIA5", jac=jac, **({"vectorized": True} if many else {}), **TIGHT,
    )  # fmt: skip
    y = np.ones(2)
    for u in held.values:
        rest = -np.linalg.solve(matrix * u**2, [u, u])
        values, vectors = np.linalg.eig(matrix * u**2 * 0.5)
        y = rest + (vectors * np.exp(values)) @ np.linalg.solve(vectors, y - rest)
    np.testing.assert_allclose(run.y[-1].ravel(), y, rtol=0, atol=1e-7)


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
    with pytest.raises(ValueError, match="t must lie within the times of the samples"):
        stepper.advance(2.6)
    with pytest.raises(RuntimeError, match="inputs must lead beyond"):
        stepper.step()


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
    with pytest.raises(ValueError, match="t0 must lie within"):
        cg.Stepper(lambda t, y, u: [u], -1.0, [0.0], frame=LINE, inputs=HELD)


def test_exceptions_say_how_functions_are_called():
    def f(t, y):
        return [0.0]

    with pytest.raises(TypeError) as caught:
        cg.solve_ivp(f, (0, 1), [0.0], frame=LINE, inputs=HELD)
    assert "f is given (t, y, u, ...)" in "".join(caught.value.__notes__)


@pytest.mark.parametrize("in_c", [False, True])
@pytest.mark.parametrize("kind", ["hold", "linear"])
@pytest.mark.parametrize("span", [(0.0, 2.2), (2.0, 0.1)])
def test_derivatives_with_respect_to_values(in_c, kind, span, function):
    f = function("blown") if in_c else driven
    options = {"frame": FRAME, "parameters": GAIN, "rtol": 1e-11, "atol": 1e-11}

    def end(values, gusts=GUSTS[1]):
        inputs = cg.Samples(TIMES, values, kind), cg.Samples(GUSTS[0], gusts, "linear")
        return cg.solve_ivp(f, span, START, inputs=inputs, **options).y[-1]

    inputs = cg.Samples(TIMES, TORQUE, kind), GUST
    run = cg.solve_variational(
        f, span, START, inputs=inputs, input_derivatives=True, control_derivatives=True, **options
    )
    plain = cg.solve_variational(f, span, START, inputs=inputs, control_derivatives=True, **options)
    for name in ("y", "transition", "sensitivity"):
        got, expected = getattr(run, name)[-1], getattr(plain, name)[-1]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    assert run.t[0] == span[0]
    assert np.isin([0.3, 0.45, 1.0, 1.4], run.t).all()
    of_torque, of_gust = run.input_sensitivity
    assert of_torque.shape == (6, *TORQUE.shape)
    assert of_gust.shape == (6, 11)
    center, step = run.y[-1], 1e-4
    for k in range(len(TIMES)):
        change = np.zeros_like(TORQUE)
        change[k, k % 3] = step
        ends = end(TORQUE + change), end(TORQUE - change)
        difference = np.subtract(*(FRAME.local_coordinates(center, y) for y in ends)) / (2 * step)
        np.testing.assert_allclose(of_torque[:, k, k % 3], difference, rtol=0, atol=1e-7)
    for k in range(11):
        change = step * np.eye(11)[k]
        ends = end(TORQUE, GUSTS[1] + change), end(TORQUE, GUSTS[1] - change)
        difference = np.subtract(*(FRAME.local_coordinates(center, y) for y in ends)) / (2 * step)
        np.testing.assert_allclose(of_gust[:, k], difference, rtol=0, atol=1e-7)


def test_derivatives_with_respect_to_pulses_that_vanish():
    """All amplitudes are equal, so that the curve has no corners; the frame is in Python."""
    frame = cg.frames.Sp(2)
    times = np.linspace(0, 1, 11)[:-1]
    pulse = cg.Samples(times, np.zeros((10, 2)))
    f = lambda t, y, u: [u[0], 1.0, u[1]]  # noqa: E731
    mixed = lambda t, y, u: [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]  # noqa: E731
    runs = [
        cg.solve_variational(
            f, (0, 1), np.eye(2), frame=frame, inputs=pulse, input_derivatives=True, df_dp=df_dp,
            **TIGHT,
        )
        for df_dp in (None, mixed)
    ]  # fmt: skip
    sensitivity = runs[0].input_sensitivity
    np.testing.assert_allclose(sensitivity, runs[1].input_sensitivity, rtol=0, atol=1e-8)
    assert runs[0].sensitivity is None
    for k in (0, 4, 9):
        ends = []
        for step in (1e-5, -1e-5):
            values = pulse.values.copy()
            values[k, 0] += step
            ends.append(cg.solve_ivp(
                f, (0, 1), np.eye(2), frame=frame, inputs=cg.Samples(times, values), **TIGHT
            ).y[-1])  # fmt: skip
        moved = [frame.local_coordinates(runs[0].y[-1], y) for y in ends]
        difference = np.subtract(*moved) / 2e-5
        np.testing.assert_allclose(sensitivity[:, k, 0], difference, rtol=0, atol=1e-5)


def test_input_derivatives_with_equal_steps_and_without_any():
    f = lambda t, y, u: [u * y[0]]  # noqa: E731
    held = cg.Samples([0.0, 1.0, 2.0], [0.5, -1.0, 0.25])
    options = {"frame": LINE, "inputs": held, "input_derivatives": True, "method": "CG4a"}
    run = cg.solve_variational(f, (0, 3), [1.0], h=0.02, **options)
    expected = np.exp(-0.25)  # each value acts for one unit of time
    np.testing.assert_allclose(run.input_sensitivity, [[expected] * 3], rtol=1e-7)
    assert run.steps == 150
    nothing = cg.solve_variational(f, (1, 1), [1.0], h=0.02, **options)
    np.testing.assert_array_equal(nothing.input_sensitivity, np.zeros((1, 3)))
    np.testing.assert_array_equal(nothing.t, [1.0])


def test_refused_with_input_derivatives():
    options = {"frame": LINE, "input_derivatives": True}
    f = lambda t, y, u: [u * y[0]]  # noqa: E731
    with pytest.raises(ValueError, match="inputs must be given with input_derivatives"):
        cg.solve_variational(f, (0, 1), [1.0], **options)
    with pytest.raises(ValueError, match='"hold" or "linear"'):
        cg.solve_variational(
            f, (0, 1), [1.0], inputs=cg.Samples([0, 1], [1, 2], "cubic"), **options
        )
    for name, value in (("events", []), ("t_eval", [0.5]), ("dense_output", True)):
        with pytest.raises(ValueError, match=f"{name} must not be given"):
            cg.solve_variational(f, (0, 1), [1.0], inputs=HELD, **{name: value}, **options)
    failed = cg.solve_variational(
        lambda t, y, u: [u * y[0] ** 2], (0, 1.5), [1.0], inputs=HELD, **options
    )
    assert failed.status == -1
    assert failed.input_sensitivity is None
