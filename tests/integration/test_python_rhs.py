"""Arguments and results of Python functions called by compiled code."""

import warnings

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SO3, SU, Euclidean, PhaseSpace, Power, Product, UnitQuaternion

FRAME = Product(SO3(), Euclidean(3))
Y0 = FRAME.join(np.eye(3), [0.1, -0.2, 0.3])
OPTIONS = {"frame": FRAME, "method": "CF4", "h": 0.125}


def rates(t, y):
    return np.array([y[9], y[1], t, y[10] * y[0], y[11], -y[9]])


def run(f, y0=Y0, **options):
    return cg.integrate(f, (0.0, 1.0), y0, **{**OPTIONS, **options}).y


@pytest.mark.parametrize("convert", [
    list, tuple, np.ndarray.tolist, lambda v: tuple(v.tolist()),
    lambda v: [*v[:3], *v[3:].tolist()], lambda v: v[::-1][::-1],
    lambda v: np.stack([v, v], axis=1)[:, 0], lambda v: v.astype(object),
    lambda v: [np.longdouble(x) for x in v],
])  # fmt: skip
def test_all_that_stands_for_numbers_is_the_same(convert):
    np.testing.assert_array_equal(run(lambda t, y: convert(rates(t, y))), run(rates))


def test_integers_are_numbers():
    expected = run(lambda t, y: np.array([1.0, 0.0, 2.0, 0.0, -1.0, 3.0]))
    for value in ([1, 0, 2.0, 0, -1, 3], (1, 0, 2, 0, -1, 3), np.array([1, 0, 2, 0, -1, 3])):
        np.testing.assert_array_equal(run(lambda t, y, value=value: value), expected)


@pytest.mark.parametrize("way", ["equal steps", "chosen steps", "implicit", "members"])
@pytest.mark.parametrize(("value", "message"), [
    ([1.0] * 5, r"array of shape \(6,\), got shape \(5,\) at t = 0.5"),
    ((1.0,) * 7, r"array of shape \(6,\), got shape \(7,\)"),
    ([[1.0]] * 6, r"array of shape \(6,\), got shape \(6, 1\)"),
    (1.0, r"got shape \(\)"),
    (None, "got None at t = 0.5"),
    ([True] * 6, "6 real numbers"),
    ([1.0] * 5 + ["1"], "6 real numbers"),
    ([1.0] * 5 + [1j], "6 real numbers"),
    (np.array([1j] * 6), "6 real numbers"),
    ([1.0] * 5 + [[2.0]], "6 real numbers"),
    ("rotation", "6 real numbers, got 'rotation'"),
])  # fmt: skip
def test_other_results_are_rejected(value, message, way):
    f = lambda t, y: np.zeros(6) if t < 0.5 else value
    options = {"frame": FRAME} if way == "chosen steps" else OPTIONS
    if way == "implicit":
        options = OPTIONS | {"method": "ImplicitMidpoint", "h": 0.25}
    call, y0 = (cg.solve_ensemble, [Y0, Y0]) if way == "members" else (cg.solve_ivp, Y0)
    message = message.replace("at t = 0.5", r"at t = 0\.[5-9]")
    refuses(ValueError, f"f must return .*{message}", call, f, (0.0, 1.0), y0, **options)
    with pytest.raises(ValueError, match="f must return"):
        cg.solve_ensemble(lambda t, y: value, (0, 1), [Y0, Y0], vectorized=True, **options)


def points_seen(keep, frame=FRAME, y0=Y0):
    """Return the objects that f stored of its points, and copies of the points."""
    stored, copies = [], []

    def f(t, y):
        stored.append(keep(y))
        copies.append(y.copy())
        return np.linspace(0.1, 0.7, frame.dim)

    run(f, y0, frame=frame)
    return stored, copies


def test_points_stored_by_f_do_not_change():
    stored, copies = points_seen(lambda y: y)
    np.testing.assert_array_equal(stored, copies)
    assert len({y.tobytes() for y in stored}) > 8
    stored, copies = points_seen(lambda y: y[9:])
    np.testing.assert_array_equal(stored, np.array(copies)[:, 9:])
    stored, copies = points_seen(memoryview)
    np.testing.assert_array_equal([np.array(view) for view in stored], copies)
    every_third = [0]

    def sometimes(y):
        every_third[0] += 1
        return y if every_third[0] % 3 else None

    stored, copies = points_seen(sometimes)
    pairs = [(y, z) for y, z in zip(stored, copies, strict=True) if y is not None]
    np.testing.assert_array_equal(*zip(*pairs, strict=True))


@pytest.mark.parametrize("frame", [FRAME, SU(3), Power(SO3(), 2)], ids=repr)
def test_changes_of_the_point_by_f_have_no_effect(frame):
    y0 = frame.random_point(np.random.default_rng(1))
    v = np.linspace(0.1, 0.7, frame.dim)
    points = []

    def spoil(t, y):
        points.append((y.shape, y.dtype, y.flags.writeable))
        y.flags.writeable = True
        y[...] = 7.0
        y.flags.writeable = False
        if len(points) % 2:
            with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
                y.shape = (y.size,)
        return v

    refuses(ValueError, r"y = y.copy\(\)", run, lambda t, y: y.fill(0.0), y0, frame=frame)
    actual = run(spoil, y0, frame=frame)
    np.testing.assert_array_equal(actual, run(lambda t, y: v, y0, frame=frame))
    assert set(points) == {(frame.point_shape, frame.dtype, False)}


@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize(
    "frame", [UnitQuaternion(), Product(UnitQuaternion(), Euclidean(3))], ids=repr
)
def test_the_derivative_of_the_point_is_recognised(frame, batch):
    start = np.broadcast_to(frame.random_point(np.random.default_rng(1)), (*batch, frame.dim + 1))

    def solve(f):
        if batch:
            cg.solve_ensemble(f, (0, 1), start, frame=frame, vectorized=True)
        else:
            cg.solve_ivp(f, (0, 1), start, frame=frame)

    with pytest.raises(ValueError, match="rhs='derivative' takes derivatives of y"):
        solve(lambda t, y: np.zeros_like(y))


@pytest.mark.parametrize("options", [{}, {"linear": True}, {"frame": PhaseSpace(SO3())}], ids=str)
def test_derivatives_are_named_only_for_their_shape_where_they_are_taken(options):
    options = {"frame": SO3()} | options
    start = options["frame"].random_point(np.random.default_rng(1))
    vee = r"; vee of SO3\(\) makes those of a matrix of its Lie algebra"
    hint = vee if "linear" in options else ""
    refuses(
        ValueError, rf"^f must return .*, got shape \(9,\) at t = 0{hint}\nat t = 0; f is given",
        cg.solve_ivp, lambda *given: np.zeros(9), (0, 1), start, **options,
    )  # fmt: skip


NUMBERED = {"frame": SO3(), "parameters": np.arange(5.0)[:, None]}


class TestNotes:
    """Notes to exceptions of f say when they happened, and how f is called."""

    @pytest.mark.parametrize("f", [lambda t: 0, lambda y, t: [y[0], 0, 0]])
    def test_how_it_is_called(self, f):
        with pytest.raises(TypeError) as caught:
            cg.solve_ivp(f, (0, 1), np.eye(3), frame=SO3())
        note = "at t = 0; f is given (t, y) with y of shape (3, 3)"
        assert caught.value.__notes__ == [note]

    @pytest.mark.parametrize("name", ["events[0]", "events[0].jump"])
    @pytest.mark.parametrize("vectorized", [False, True])
    def test_events_and_jumps(self, name, vectorized):
        def fail(t, y):
            raise KeyError("mine")

        event = cg.Event(fail) if name == "events[0]" else cg.Event(lambda t, y: t - 0.5, jump=fail)
        t = "0" if name == "events[0]" else "0.5"
        with pytest.raises(KeyError, match="mine") as caught:
            cg.solve_ivp(
                lambda t, y: [1.0], (0, 1), [0.0], frame=Euclidean(1), events=event, h=0.25,
                method="CF4",
            )  # fmt: skip
        assert caught.value.__notes__ == [f"in {name}(t, y, ...) at t = {t}"]
        with pytest.raises(KeyError, match="mine") as caught:
            cg.solve_ensemble(
                lambda t, y: np.ones((*np.shape(t), 1)), (0, 1), [[0.0], [1.0]],
                frame=Euclidean(1), events=event, h=0.25, method="CF4", vectorized=vectorized,
            )  # fmt: skip
        assert caught.value.__notes__ == [f"in {name}(t, y, ...) at t = {t} in member 0"]

    def test_vectorized(self):
        with pytest.raises(ValueError, match="broadcast") as caught:
            cg.solve_ensemble(
                lambda t, y: y[:2] * np.ones(7), (0, 1), [np.eye(3)] * 4, frame=SO3(),
                vectorized=True,
            )  # fmt: skip
        note = "at t = 0; f is given (t, y) with y of shape (k, 3, 3), and t of shape (k,)"
        assert caught.value.__notes__ == [note]

    @pytest.mark.parametrize("workers", [None, 2])
    def test_member(self, workers):
        f = lambda t, y, row: [0, 0, 1][: 2 if row[0] == 3 and t > 0.5 else 3]
        with pytest.raises(ValueError, match=r"got shape .* at t = 0") as caught:
            cg.solve_ensemble(f, (0, 1), np.eye(3), workers=workers, **NUMBERED)
        assert "in member 3; f is given" in caught.value.__notes__[0]

    @pytest.mark.parametrize(("name", "vectorized"), [
        *((name, False) for name in ("f", "events[0]", "events[0].jump", "observe")),
        *((name, True) for name in ("events[0]", "events[0].jump", "observe")),
    ])  # fmt: skip
    def test_a_member_of_a_later_chunk(self, name, vectorized):
        def raising(where, value):
            def function(t, y, p):
                if name == where and p[0] == 1777.0 and t > 0.3:
                    raise KeyError("mine")
                return value(t, y)

            return function

        f = raising("f", lambda t, y: [1.0])
        event = cg.Event(
            raising("events[0]", lambda t, y: t - 0.5),
            jump=raising("events[0].jump", lambda t, y: y),
        )
        with pytest.raises(KeyError, match="mine") as caught:
            cg.solve_ensemble(
                (lambda t, y, p: np.ones((len(t), 1))) if vectorized else f, (0, 1),
                np.zeros((2000, 1)), frame=Euclidean(1), parameters=np.arange(2000.0)[:, None],
                method="CF4", h=0.25, events=event, observe=raising("observe", lambda t, y: t),
                t_eval=[0.5, 1.0], vectorized=vectorized, workers=2,
            )  # fmt: skip
        assert "in member 1777" in caught.value.__notes__[0]


def test_frames_without_hash():
    plain = type("Plain", (Euclidean,), {"__hash__": None})(1)
    options = {"frame": plain, "derivatives": "forward", "rtol": 1e-9, "atol": 1e-9}
    for rhs in ("coefficients", "derivative"):
        solution = cg.solve_ivp(lambda t, y: -y, (0, 1), [1.0], rhs=rhs, **options)
        assert np.isclose(solution.y[-1, 0], np.exp(-1.0), rtol=2e-9, atol=0.0)
