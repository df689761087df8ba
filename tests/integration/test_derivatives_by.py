"""Derivatives along chosen directions."""

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import GL, SE3, SO3, Euclidean, Hyperbolic, Product, Sphere, UnitQuaternion

RNG = np.random.default_rng(4)
W, V = RNG.normal(size=(2, 8, 9))
FRAMES = {
    "SO3": (SO3(), np.eye(3)),
    "quaternion": (UnitQuaternion("space"), np.array([1.0, 0.0, 0.0, 0.0])),
    "product": (Product(Euclidean(2), SE3()), None),
    "sphere": (Sphere(2), np.array([0.6, 0.0, 0.8])),
    "space in Python": (Hyperbolic(3), np.array([0.3, -0.2, 1.1])),
    "product in Python": (Product(SO3(), GL(2)), np.append(np.eye(3), np.eye(2))),
}


def f(t, y, p):
    y = np.resize(np.real(y).ravel(), 9)
    return np.tanh(W @ y * p[0])[: f.dim] + p[1] * np.sin(t + V @ y)[: f.dim]


def solve(frame, y0, **options):
    f.dim = frame.dim
    return cg.solve_variational(
        options.pop("f", f), options.pop("t_span", (0, 1.5)), y0, frame=frame,
        parameters=[0.7, -0.4], rtol=1e-7, atol=1e-7, control_derivatives=True, **options,
    )  # fmt: skip


@pytest.fixture(params=FRAMES)
def frame_and_start(request):
    frame, y0 = FRAMES[request.param]
    return frame, frame.join([1.0, -1.0], np.eye(4)) if y0 is None else y0


class TestDirections:
    def test_are_combinations_of_all_derivatives(self, frame_and_start):
        frame, y0 = frame_and_start
        matrix = RNG.normal(size=(frame.dim + 2, 3))
        whole = solve(frame, y0)
        every = np.concatenate([whole.transition, whole.sensitivity], axis=-1)
        for by, expected in (
            ("parameters", whole.sensitivity[-1]),
            ("point", whole.transition[-1]),
            (matrix, every[-1] @ matrix),
        ):
            some = solve(frame, y0, derivatives_by=by)
            found = some.transition if isinstance(by, str) and by == "point" else some.sensitivity
            field = lambda columns: [frame.field(column, whole.y[-1]) for column in columns.T]
            np.testing.assert_allclose(field(found[-1]), field(expected), rtol=0, atol=3e-7)
            assert (some.transition is None) != (some.sensitivity is None)

    @pytest.mark.parametrize("rhs", ["coefficients", "derivative"])
    def test_of_flows_in_python(self, rhs):
        """Exponentials of a diagonal matrix, whose entries are parameters."""

        def g(t, y, p):
            matrix = np.diag(p)
            return matrix.ravel() if rhs == "coefficients" else matrix @ y

        for span in ((0, 2), (2, 0)):
            options = {"f": g, "rhs": rhs, "derivatives_by": "parameters", "t_span": span}
            found = solve(GL(2), np.eye(2), **options).sensitivity[-1]
            expected = (span[1] - span[0]) * np.eye(4)[:, [0, 3]]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)

    @pytest.mark.parametrize("given", ["jac", "df_dp", "both"])
    def test_with_given_derivatives(self, given):
        """Also between steps, at events and at jumps."""

        def g(t, y, p):
            return [p[0] * y[1], -p[0] * y[0] + p[1] * t]

        functions = {
            "jac": lambda t, y, p: [[0.0, p[0]], [-p[0], 0.0]],
            "df_dp": lambda t, y, p: [[y[1], 0.0], [-y[0], t]],
        }
        event = cg.Event(lambda t, y, p: y[0] - 0.5, jump=lambda t, y, p: [y[0], y[1] * p[0]])
        options = {"t_span": (0, 3), "f": g, "events": [event], "dense_output": True}
        whole = solve(Euclidean(2), [1.0, 0.0], **options)
        matrix = np.array([[1.0, 0.0], [0.0, 0.0], [0.5, 1.0], [-1.0, 0.0]])
        some = solve(
            Euclidean(2), [1.0, 0.0], derivatives_by=matrix, **options,
            **{name: functions[name] for name in functions if given in (name, "both")},
        )  # fmt: skip
        for t in (1.0, 3.0):
            every = np.concatenate([whole.sol.transition(t), whole.sol.sensitivity(t)], axis=-1)
            np.testing.assert_allclose(some.sol.sensitivity(t), every @ matrix, rtol=0, atol=5e-9)
        assert len(some.t_events[0]) >= 1
        np.testing.assert_allclose(
            some.dt_events[0], whole.dt_events[0] @ matrix, rtol=0, atol=1e-9
        )

    def test_of_ensembles(self):
        """Of one function, or of many members at a time: the same derivatives."""
        parameters = np.array([[0.7, -0.4], [1.1, 0.3]])

        def many(t, y, p):
            return np.stack([p[:, 0] * y[:, 1], np.sin(p[:, 1] * t)], axis=-1)

        def one(t, y, p):
            return many(np.array([t]), y[None], p[None])[0]

        options = {"frame": Euclidean(2), "parameters": parameters, "h": 0.05}
        options |= {"derivatives": "forward", "derivatives_by": "parameters"}
        first = cg.solve_ensemble(one, (0, 1), [1.0, 0.0], **options)
        second = cg.solve_ensemble(many, (0, 1), [1.0, 0.0], vectorized=True, **options)
        np.testing.assert_allclose(first.sensitivity, second.sensitivity, rtol=0, atol=4e-12)
        assert first.transition is None

    @pytest.mark.parametrize(("frame", "by", "each", "control"), [
        *((f, *cost, {"h": 0.1}) for f in (SO3(), GL(2)) for cost in (("parameters", 5), (1, 3))),
        (SO3(), "parameters", 3, {"rtol": 1e-7}), (SO3(), 1, 2, {"rtol": 1e-7}),
    ], ids=str)  # fmt: skip
    def test_cost_one_or_two_evaluations_of_f_each(self, frame, by, each, control):
        by = np.eye(frame.dim + 2, by) if by == 1 else by
        calls = []

        def counted(t, y, p):
            calls.append((t, p, p.copy()))
            return p[0] * np.sin(y.ravel()[: frame.dim]) + p[1] * np.arange(frame.dim)

        options = {"frame": frame, "parameters": [0.5, 1.0], "method": "CF5(4)"} | control
        cg.solve_variational(counted, (0, 1), np.eye(frame.size), derivatives_by=by, **options)
        counts = np.unique([t for t, *_ in calls[2:]], return_counts=True)[1]
        assert (counts % each == 0).sum() > len(counts) / 2
        assert np.median(counts) <= 2 * each  # at most two stages are at one time
        assert all(np.array_equal(kept, copy) for _, kept, copy in calls)

    @pytest.mark.parametrize(("by", "message"), [
        ("initial", "must be 'point', 'parameters' or a matrix"),
        (np.eye(4), "must have 5 rows"), (np.full((5, 1), np.inf), "must be finite"),
    ])  # fmt: skip
    def test_bad_directions(self, by, message):
        refuses(ValueError, f"derivatives_by {message}", solve, SO3(), np.eye(3), derivatives_by=by)
        refuses(
            ValueError,
            r"parameters must be finite, got nan at \[1\]",
            cg.solve_variational,
            lambda t, y, p: y[0],
            (0, 1),
            np.eye(3),
            frame=SO3(),
            parameters=[1.0, np.nan],
        )
        with pytest.raises(ValueError, match="derivatives_by must be None with P0"):
            solve(SO3(), np.eye(3), derivatives_by="point", P0=np.eye(3))
        with pytest.raises(
            ValueError, match="derivatives must be 'forward' with derivatives_by, got None"
        ):
            cg.solve_ivp(lambda t, y: y[0], (0, 1), np.eye(3), frame=SO3(), derivatives_by="point")
