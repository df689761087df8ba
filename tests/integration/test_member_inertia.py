"""Ensembles whose members have inertia of their own."""

import numpy as np
import pytest
from mechanics import INERTIA, MATRIX, system
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean, Joint, PhaseSpace, Power, Product, UnitQuaternion

TOP = system(SO3(), INERTIA)
PIVOT = Joint("ball", (None, [0, 0, 0]), (0, [0, 0, 1]))
HUNG = {
    "frame": PhaseSpace(Product(SO3(), Euclidean(3)), joints=[PIVOT]),
    "inertia": [(1.0, 1.0), (2.0, 1.0)],
}
Y_HUNG = [*np.eye(3).ravel(), 0, 0, -1, *np.zeros(6)]
ROWS = [INERTIA, MATRIX, 2.0, [2.0, 1.5, 1.5]]
METHODS = [{"method": "BlanesMoan4", "h": 0.1}, {"method": "DOP853", "rtol": 1e-6}]


@pytest.mark.parametrize("options", METHODS, ids=["splitting", "adaptive"])
@pytest.mark.parametrize("how", [{}, {"workers": 2}, {"vectorized": True}])
def test_members_move_as_with_frames_of_their_own(options, how):
    result = cg.solve_ensemble(
        TOP.f, (0, 2), TOP.y0, frame=TOP.frame, inertia=ROWS, t_eval=[0.55, 2.0],
        dense_output=True, **options, **how,
    )  # fmt: skip
    for k, inertia in enumerate(ROWS):
        own = PhaseSpace(SO3(), inertia)
        alone = cg.solve_ivp(
            TOP.f, (0, 2), TOP.y0, frame=own, t_eval=[0.55, 2.0], dense_output=True, **options
        )
        assert np.allclose(result.y[:, k], alone.y, rtol=0.0, atol=1e-13)
        between = [0.31, 0.55, 1.77]
        assert np.allclose(result[k].sol(between), alone.sol(between), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(("options", "how"), [
    (METHODS[0], {}), (METHODS[0], {"workers": 2}), (METHODS[1], {"executor": "processes"}),
])  # fmt: skip
def test_derivatives_are_those_of_frames_of_their_own(options, how):
    low = cg.Event(height, terminal=False)
    both = {"t_eval": [0.55, 2.0], "derivatives": "forward", "events": low, **options}
    spread = np.array([k * np.eye(TOP.frame.dim) for k in range(1, 5)])
    adaptive = {"P0": spread, "noise": 0.1 * np.eye(TOP.frame.dim)} if "rtol" in options else {}
    result = cg.solve_ensemble(
        gravity, (0, 2), TOP.y0, frame=TOP.frame, inertia=ROWS, parameters=[[1.0]] * 4,
        **both, **adaptive, **how,
    )  # fmt: skip
    for k, inertia in enumerate(ROWS):
        adaptive |= {"P0": spread[k]} if adaptive else {}
        own = PhaseSpace(SO3(), inertia)
        alone = cg.solve_ivp(
            gravity, (0, 2), TOP.y0, frame=own, parameters=[1.0], **both, **adaptive
        )
        for name in ("y", "transition", "sensitivity", "covariance")[: 3 + bool(adaptive)]:
            assert np.array_equal(getattr(result, name)[:, k], getattr(alone, name)), name
        assert len(alone.t_events[0])
        for name in ("t_events", "dt_events"):
            assert np.array_equal(getattr(result[k], name)[0], getattr(alone, name)[0]), name


def gravity(t, y, p):
    return p[0] * TOP.f(t, y)


def height(t, y, p):
    return y[8]


BOUNCE = cg.Event(lambda t, y: y[6] - 0.995, jump=lambda t, y: [*y[:7], *-y[7:]])


def test_jointed_members_move_as_with_frames_of_their_own():
    body, arm, force = Product(UnitQuaternion(), Euclidean(3)), [0.0, 0.0, 1.0], np.zeros(6)
    force[5] = -9.81
    joint = Joint("ball", (None, np.zeros(3)), (0, np.negative(arm)))
    rows = [(INERTIA, 1.3), (MATRIX, 0.4), (2.0, 1.0)]
    frames = [PhaseSpace(body, row, joints=[joint]) for row in rows]
    q, turning = body.join([0.0, 0.0, 0.0, 1.0], arm), [0.3, 0.2, 0.5, 0.0, 0.0, 0.0]
    y0 = np.stack([frame.join(q, turning) for frame in frames])
    bath = cg.Langevin(1.0, 0.7, seed=5)
    for options in (
        {"method": "RATTLE4", "h": 0.05, "dense_output": True},
        {"method": "RATTLE", "h": 0.05, "thermostat": bath},
        {"method": "RATTLE4", "h": 0.05, "events": BOUNCE},
        {"rtol": 1e-6, "derivatives": "forward", "events": BOUNCE},
    ):  # fmt: skip
        result = cg.solve_ensemble(
            lambda t, y: force, (0, 1), y0, frame=frames[0], inertia=rows, **options
        )
        for k, frame in enumerate(frames):
            if "thermostat" in options and k:  # the noise is that of the member's number
                assert frame.membership_error(result.y[-1, k]) < 1e-13
                continue
            alone = cg.solve_ivp(lambda t, y: force, (0, 1), y0[k], frame=frame, **options)
            assert np.array_equal(result.y[-1, k], alone.y[-1])
            if "dense_output" in options:
                assert np.array_equal(result[k].sol(0.33), alone.sol(0.33))
            if "derivatives" in options:
                assert np.array_equal(result.transition[-1, k], alone.transition[-1])
                assert np.array_equal(result[k].dt_events[0], alone.dt_events[0])
            if "events" in options:
                assert len(alone.t_events[0])
    refuses(ValueError, r"y0 must be a point of PhaseSpace.*0\.371", cg.solve_ensemble,
            lambda t, y: force, (0, 1), y0[0], frame=frames[0], inertia=rows)  # fmt: skip


@pytest.mark.parametrize("options", [{"method": "RATTLE4", "h": 0.05}, {"rtol": 1e-6}])
def test_members_on_constraints_move_as_with_frames_of_their_own(options):
    frames = [
        PhaseSpace(Euclidean(3), mass, constraints=lambda q: [q @ q - 1.0]) for mass in (1.0, 3.0)
    ]
    y0 = frames[0].join([0.6, 0.0, 0.8], [0.0, 0.5, 0.0])
    push = np.array([0.0, 0.0, -1.0])
    result = cg.solve_ensemble(
        lambda t, y: push, (0, 1), y0, frame=frames[0], inertia=[1.0, 3.0], **options
    )
    for k, frame in enumerate(frames):
        alone = cg.solve_ivp(lambda t, y: push, (0, 1), y0, frame=frame, **options)
        assert np.array_equal(result.y[-1, k], alone.y[-1])
        assert frame.membership_error(result.y[-1, k]) < 1e-13


def test_a_heat_bath_has_the_inertia_of_the_member():
    bath = cg.Langevin(1.0, 0.7, seed=5)
    options = {"method": "Leapfrog", "h": 0.2, "thermostat": bath}
    frame = PhaseSpace(Product(Euclidean(1), SO3()), (1.0, INERTIA))
    y0 = frame.join(frame.configuration.join([0.0], np.eye(3)), np.zeros(4))
    rows = [(3.0, MATRIX), (1.0, INERTIA)]
    both = cg.solve_ensemble(lambda t, y: np.zeros(4), (0, 2), y0, frame=frame, inertia=rows,
                             **options).y[-1]  # fmt: skip
    own = PhaseSpace(frame.configuration, rows[0])
    alone = cg.solve_ivp(lambda t, y: np.zeros(4), (0, 2), y0, frame=own, **options).y[-1]
    assert np.allclose(both[0], alone, rtol=0.0, atol=2e-14)
    assert np.abs(both[0] - both[1]).max() > 0.1


@pytest.mark.parametrize(("changes", "message"), [
    ({"inertia": ROWS[:3], "y0": np.stack([TOP.y0] * 4)}, "inertia must have 4 entries"),
    ({"inertia": []}, "inertia must have 1 entries"),
    ({**HUNG, "inertia": [(1.0, 1.0)], "y0": Y_HUNG, "parameters": np.eye(3)}, "3 entries, .* 1"),
    ({"inertia": [INERTIA, [1.0, 0.0, 1.0]]}, r"inertia\[1\] must be positive definite"),
    ({"derivatives": "forward", "common_steps": True}, "False with inertia and derivatives"),
    ({"frame": SO3(), "y0": np.eye(3)}, "unless frame is a phase space"),
    ({"inertia": 2.0, "y0": np.stack([TOP.y0] * 4)}, "inertia must have 4 entries, .* got 1"),
    ({**HUNG, "y0": np.zeros((2, 17))}, r"y0 must have shape \(..., 18\), got \(2, 17\)"),
    ({**HUNG, "y0": np.zeros((1, 2, 18))}, "y0 must have at most one axis of members"),
    ({**HUNG, "y0": [Y_HUNG, np.zeros(18)]}, r"y0\[1\] must be a point of PhaseSpace"),
])  # fmt: skip
def test_what_is_refused(changes, message):
    options = {"y0": TOP.y0, "frame": TOP.frame, "inertia": ROWS, **changes}
    refuses(ValueError, message, cg.solve_ensemble, TOP.f, (0, 1), options.pop("y0"), **options)


def test_each_body_of_a_power_has_its_inertia():
    n = 4
    rows = np.arange(12.0).reshape(n, 3) / 10 + 1
    masses = np.array([[1.0], [2.0], [3.0], [4.0]])
    matrices = np.stack([MATRIX] * 3 + [np.diag(INERTIA)])
    for factor, given, each in [
        (UnitQuaternion(), rows, rows), (UnitQuaternion(), matrices, matrices),
        (Euclidean(3), masses, np.repeat(masses, 3, axis=1)),
    ]:  # fmt: skip
        frame = PhaseSpace(Power(factor, n), given)
        same = PhaseSpace(Product(*[factor] * n), tuple(each))
        y = frame.random_point(np.random.default_rng(3))
        flat = same.join(frame.split(y)[0].ravel(), frame.split(y)[1])
        assert np.array_equal(frame.velocity(y), same.velocity(flat))
        assert eval(repr(frame)) == frame
        assert frame != PhaseSpace(Power(factor, n), each[0])
        options = {"method": "Leapfrog", "h": 0.1}
        runs = [
            cg.solve_ivp(lambda t, y: np.zeros(3 * n), (0, 1), point, frame=space, **options)
            for space, point in ((frame, y), (same, flat))
        ]
        assert np.array_equal(*(run.y[-1].ravel() for run in runs))
