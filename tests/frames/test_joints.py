"""Joints of phase spaces: their constraints, forces, and what is refused."""

import pickle

import numpy as np
import pytest
from mechanics import (
    BODIES,
    BODY_INERTIA,
    BOTTOM,
    GRAVITY,
    NEXT,
    closed_by_ball,
    closed_by_hinges,
    double_pendulum,
    four_bar,
)
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean, Joint, PhaseSpace, Power, Product, Sphere, UnitQuaternion
from cg.frames.joints import KINDS
from cg.frames.phase_space import linkage_of

TURN = SO3().flow([0.3, -0.5, 0.2], np.eye(3))
CONFIGURATIONS = [
    BODIES,
    Product(Euclidean(3), SO3("space"), UnitQuaternion(scalar_first=True), Euclidean(3)),
    Product(Euclidean(2), Power(Product(UnitQuaternion("space"), Euclidean(3)), 2)),
    Product(SO3(), Product(Euclidean(3), UnitQuaternion())),  # a body that turns about the origin
]


def joint(kind, first, second):
    options = {"length": 1.2} if kind == "distance" else {}
    axes = () if kind in ("ball", "distance") else (TURN,)
    points = [0.3, -0.2, 0.4], [-0.1, 0.5, 0.2]
    ends = [(body, p, *axes) for body, p in zip((first, second), points, strict=True)]
    return Joint(kind, *ends, **options)


@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=repr)
@pytest.mark.parametrize("bodies", [(0, 1), (None, 1), (1, None)], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_joints_stay_closed_along_their_forces(kind, bodies, configuration):
    inertia = None
    if configuration is BODIES:
        inertia = BODY_INERTIA
    frame = PhaseSpace(configuration, inertia, joints=[joint(kind, *bodies)])
    rng = np.random.default_rng(3)
    y = frame.random_point(rng)
    assert frame.membership_error(y) < 1e-13
    force = rng.standard_normal(frame.rhs_dim)
    slope, count, h = frame.complete_rhs(force, y), len(KINDS[kind]), 1e-5
    ahead, behind = (linkage_of(frame).errors(frame.flow(x * slope, y)) for x in (h, -h))
    assert np.abs((ahead - behind) / (2 * h)).max() < 1e-9 * (1 + np.abs(slope).max() ** 3)
    assert np.abs(slope[-frame.rhs_dim :] - PhaseSpace(configuration, inertia).complete_rhs(
        force, y)[-frame.rhs_dim :]).max() > 1e-3  # fmt: skip
    # speeds are derivatives of constraints, of any momenta
    any_momenta = y.copy()
    any_momenta[-frame.rhs_dim :] += rng.standard_normal(frame.rhs_dim)
    moves = np.append(frame.velocity(any_momenta), np.zeros(frame.rhs_dim))
    ahead, behind = (linkage_of(frame).errors(frame.flow(x * moves, y)) for x in (h, -h))
    speed = linkage_of(frame).errors(any_momenta)[count:]
    assert np.abs(speed).max() > 0.01
    apart = np.abs((ahead - behind)[:count] / (2 * h) - speed)
    assert apart.max() < 1e-8 * (1 + np.abs(speed).max())


def test_join_closes_joints_and_removes_momenta_that_open_them():
    problem = double_pendulum()
    q, momentum = problem.frame.split(problem.y0)
    first, at, second, there = BODIES.split(q)
    np.testing.assert_allclose(at + first @ BOTTOM, there + second @ NEXT, rtol=0, atol=1e-15)
    rng = np.random.default_rng(1)
    open_q = BODIES.flow(0.02 * rng.standard_normal((5, 12)), q)
    given = momentum + rng.standard_normal((5, 12))
    y = problem.frame.join(open_q, given)
    assert y.shape == (5, 36)
    assert problem.frame.membership_error(y).max() < 1e-14
    apart = np.abs(PhaseSpace(BODIES, BODY_INERTIA).join(open_q, given) - y)
    assert apart[:, :24].max() < 0.1
    assert problem.frame.membership_error(problem.frame.project(y + 1e-3)).max() < 1e-14
    # what is removed is orthogonal in the metric of the inertia
    kept, force = problem.frame.split(y)[1], rng.standard_normal(12)
    free = PhaseSpace(BODIES, BODY_INERTIA)
    kinetic = lambda p: free.kinetic_energy(free.join(problem.frame.split(y)[0], p))
    assert np.allclose(kinetic(given), kinetic(kept) + kinetic(given - kept), rtol=1e-14, atol=0.0)
    assert len(problem.frame.multipliers(y, force)) == 2


def test_multipliers_are_forces_of_bearings():
    mass, arm = 2.0, 0.4
    pivot = Joint("hinge", (None, [0, 0, 1], [1, 0, 0]), (0, [0, 0, arm], [1, 0, 0]))
    frame = PhaseSpace(Product(SO3(), Euclidean(3)), ([0.1, 0.2, 0.3], mass), joints=[pivot])
    y = frame.join(Product(SO3(), Euclidean(3)).join(np.eye(3), [0, 0, 1 - arm]), np.zeros(6))
    weight = [0, 0, 0, 0, 0, -mass * GRAVITY]
    (held,) = frame.multipliers(y, weight)
    assert np.allclose(held, [0, 0, -mass * GRAVITY, 0, 0], rtol=0.0, atol=1e-13)  # on the ground
    spin = 3.0  # about the hinge adds the centripetal force
    y = frame.join(frame.split(y)[0], [0.1 * spin, 0, 0, 0, mass * arm * spin, 0])
    assert np.isclose(frame.velocity(y)[0], spin, rtol=1e-14, atol=0.0)
    (held,) = frame.multipliers(np.array([y, y]), weight)
    assert np.allclose(held[1, :3], [0, 0, -mass * (GRAVITY + arm * spin**2)], rtol=0.0, atol=1e-13)
    # a torque about the second axis is borne by the constraint between third and first axes
    (held,) = frame.multipliers(y, [0, 0.7, 0, 0, 0, 0])
    assert np.isclose(np.abs(held[3:]).max(), 0.7, rtol=1e-14, atol=0.0)
    assert PhaseSpace(SO3()).multipliers(np.zeros(12), np.zeros(3)) == ()


def test_constraints_of_ones_own_are_those_of_joints():
    rod = Joint("distance", (0, [0, 0, 0]), (1, [0, 0, 0]), length=1.5)
    problem = double_pendulum([rod])

    def g(q):
        difference = BODIES.split(q)[1] - BODIES.split(q)[3]
        return [(difference @ difference - 1.5**2) / 3.0]

    def slopes(q):
        difference = BODIES.split(q)[1] - BODIES.split(q)[3]
        return [[0, 0, 0, *difference / 1.5, 0, 0, 0, *-difference / 1.5]]

    for constraints, bound in ((g, 1e-13), ((g, slopes), 5e-15)):
        own = double_pendulum([], constraints=constraints)
        assert own.frame != problem.frame
        assert np.abs(own.y0 - problem.y0).max() < bound
        both = [x.frame.multipliers(problem.y0, x.forces) for x in (own, problem)]
        assert abs(both[0][0] - both[1][0]) < 3e-11
    wrong = lambda q: 1.01 * np.array(slopes(q))
    refuses(
        ValueError, "must be those along the fields", double_pendulum, [], constraints=(g, wrong)
    )
    narrow = lambda q: np.zeros((1, 3))
    refuses(ValueError, "must have shape", double_pendulum, [], constraints=(g, narrow))
    refuses(ValueError, r"must return shape \(m,\)", double_pendulum, [], constraints=lambda q: 1.0)
    refuses(TypeError, "a function or two", double_pendulum, [], constraints=[g])


@pytest.mark.parametrize("edge", [1e-2, 1e-3, 1e-4])
def test_derivatives_of_constraints_near_the_edge_of_their_domain(edge):
    g = lambda q: [q[2] - 1 - (np.sqrt(q[0] + edge) if q[0] > -edge else np.nan), q[1]]
    slopes = lambda q: [[-0.5 / np.sqrt(q[0] + edge), 0, 1], [0, 1, 0]]
    y0 = [0, 0, 1 + np.sqrt(edge), *0.5 * np.array([2 * np.sqrt(edge), 0, 1])]
    ends = [cg.solve_ivp(lambda t, y: [0, 0, -9.8], (0, 0.1), y0, rtol=1e-8, atol=1e-10,
                         frame=PhaseSpace(Euclidean(3), 1.0, constraints=own)).y[-1]
            for own in (g, (g, slopes))]  # fmt: skip
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-9)


def test_constraints_on_other_manifolds():
    """A point of a sphere on a circle."""
    frame = PhaseSpace(Sphere(2), 2.0, constraints=lambda q: [q[2] - 0.6])
    y = frame.join([0.8, 0.0, 0.6], [1.0, 2.0, 3.0])
    assert frame.membership_error(y) < 5e-15
    assert abs(frame.velocity(y)[1]) < 5e-15


def test_constraints_that_depend_on_each_other_are_named():
    frame, q = four_bar(closed_by_hinges)
    message = "rank 17 of 20 at the configuration"
    refuses(ValueError, message, frame.join, q, np.zeros(18))
    frame, q = four_bar(closed_by_ball)
    y = frame.join(q, np.ones(18))
    frame.check_rank(y)
    assert frame.membership_error(y) < 1e-14
    assert np.abs(frame.velocity(y)).max() > 1e-3  # one freedom is left
    apart = [Joint("distance", (None, [0, 0, 9]), (0, [0, 0, 0]), length=1.0)]
    far = PhaseSpace(Euclidean(3), joints=apart)
    assert far.membership_error(far.join([0, 0, 7.9], np.zeros(3))) < 1e-14
    twice = PhaseSpace(Euclidean(3), joints=apart * 2)
    refuses(ValueError, "rank 1 of 2", twice.join, [0, 0, 8], np.zeros(3))


@pytest.mark.parametrize("kind", ["fixed", "slider"])
def test_axes_that_coincide_are_not_opposite_or_exchanged(kind):
    frame = PhaseSpace(Power(Product(SO3(), Euclidean(3)), 2), joints=[joint(kind, 0, 1)])
    at = frame.random_point(np.random.default_rng(0), 20)
    turns = frame.split(at)[0].reshape(20, 2, 12)[..., :9].reshape(20, 2, 3, 3)
    assert np.abs(turns[:, 0] - turns[:, 1]).max() < 3e-14
    assert np.abs(at[:, :24]).max() < 100.0
    q, p = frame.split(at[0])
    closed = 0
    for angle in (0.3, 1.0, 2.0, 2.5, np.pi):
        for axis in np.eye(3):
            moved = q.copy().reshape(2, 12)
            moved[1, :9] = SO3().flow(angle * axis, moved[1, :9].reshape(3, 3)).ravel()
            try:
                turns_now = frame.split(frame.join(moved, p))[0].reshape(2, 12)[:, :9]
            except ValueError:  # the only other outcome
                continue
            assert np.abs(turns_now[0] - turns_now[1]).max() < 2e-14
            closed += 1
    assert 3 <= closed < 15
    # all cosines are zero, but the axes are exchanged
    swapped = at[0].copy().reshape(-1)
    swapped[12:21] = (turns[0, 1] @ TURN @ np.eye(3)[[1, 2, 0]] @ TURN.T).ravel()
    assert frame.relative_error(swapped) > 1.0


def test_joints_that_diverge_are_refused():
    frame = PhaseSpace(
        Power(Product(SO3(), Euclidean(3)), 2), ([1.0, 2.0, 3.0], 1.5),
        joints=[Joint("slider", (0, [0, 0, 0.5]), (1, [0, 0, -0.5]))],
    )  # fmt: skip
    turn = SO3().flow(-2 * np.pi / 3 * np.ones(3) / 3**0.5, np.eye(3))
    q = [[*np.eye(3).ravel(), 0, 0, 0], [*turn.ravel(), *([0, 0, 0.5] + turn @ [0, 0, 0.5])]]
    refuses(ValueError, "must nearly close joints", frame.join, np.array(q), np.zeros(12))
    apart = [Joint("ball", (None, [0, 0, 0]), END), Joint("ball", (None, [9, 0, 0]), END)]
    frame = PhaseSpace(Product(SO3(), Euclidean(3)), joints=apart)
    refuses(ValueError, "near random points", frame.random_point, np.random.default_rng(0))


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e9])
def test_joints_are_closed_relative_to_their_size(unit):
    body = Product(SO3(), Euclidean(3))
    inertia = unit**2 * np.array([0.2, 0.3, 0.4]), 1.0
    pin = [Joint("ball", (None, [0, 0, 0]), (0, [0, 0, unit]))]
    frame = PhaseSpace(body, inertia, joints=pin)
    y = frame.join([*np.eye(3).ravel(), 0, 0, -unit], unit**2 * np.array([0.3, 0.1, 0.2, 0, 0, 0]))
    assert frame.relative_error(y) < 5e-15
    open_by = y.copy()
    open_by[9] += 1e-6 * unit
    assert 1e-7 < frame.relative_error(open_by) < 1e-5


def test_what_phase_spaces_with_joints_refuse():
    frame = double_pendulum().frame
    y = frame.random_point(np.random.default_rng(0))
    refuses(ValueError, r"f must have shape \(..., 12\)", frame.multipliers, y, 3.0)
    refuses(ValueError, r"f must have shape \(..., 12\)", frame.multipliers, y, [1.0, 2.0, 3.0])
    q, rng = frame.split(y)[0], np.random.default_rng(0)
    refuses(ValueError, "temperature must be", frame.random_momentum, q, -1.0, rng)
    refuses(TypeError, "rng must be a generator", frame.random_momentum, q, 1.0, 0)
    refuses(ValueError, "frame must not be a PhaseSpace", cg.export, "CF4", "c", frame=frame)
    for joined in Product(Euclidean(1), frame), Power(frame, 2), Product(Power(frame, 1), SO3()):
        y0 = joined.random_point(rng)
        refuses(ValueError, "with joints as a factor", cg.solve_ivp, abs, (0, 1), y0, frame=joined)


def test_a_jointed_phase_space_is_a_value():
    frame = double_pendulum().frame
    again = pickle.loads(pickle.dumps(frame))
    assert again == frame == eval(repr(frame))
    assert len({frame, again}) == 1
    assert frame != PhaseSpace(BODIES, BODY_INERTIA)


END = (0, [0.0, 0.0, 0.0])


@pytest.mark.parametrize(("arguments", "options", "error", "message"), [
    (("weld", END, (1, NEXT)), {}, ValueError, "kind must be one of .ball."),
    (("ball", END, END), {}, ValueError, "different bodies"),
    (("ball", (0,), (1, NEXT)), {}, ValueError, r"first must be \(body, point\)"),
    (("ball", END, (1.0, NEXT)), {}, TypeError, "body of second must be an integer"),
    (("ball", END, (-1, NEXT)), {}, ValueError, "body of second must be at least 0, got -1"),
    (("ball", END, (1, [1, 2])), {}, ValueError, "three finite numbers"),
    (("ball", END, (1, NEXT, np.eye(3))), {}, ValueError, "axes of second must not be given"),
    (("ball", END, (1, NEXT, [])), {}, ValueError, "axes of second must not be given"),
    (("hinge", (0, NEXT, []), END), {}, ValueError, "axes of first must be the columns"),
    (("slider", END, (1, NEXT, [0, 0, 1])), {}, ValueError, "columns of a rotation matrix"),
    (("hinge", END, (1, NEXT, [0, 0, 0])), {}, ValueError, "finite length"),
    (("hinge", END, (1, NEXT, 5)), {}, ValueError, "columns of a rotation matrix, got 5"),
    (("fixed", END, (1, NEXT, 2 * np.eye(3))), {}, ValueError, "columns of a rotation matrix"),
    (("ball", END, (1, NEXT)), {"length": 1.0}, ValueError, "'distance' alone"),
    (("distance", END, (1, NEXT)), {}, ValueError, "'distance' alone"),
    (("distance", END, (1, NEXT)), {"length": -1.0}, ValueError, "length must be finite and pos"),
])  # fmt: skip
def test_joints_are_checked(arguments, options, error, message):
    refuses(error, message, Joint, *arguments, **options)


def test_phase_spaces_check_their_joints():
    far = Joint("ball", (0, NEXT), (2, NEXT))
    refuses(ValueError, r"bodies of joints\[0\] must be less than 2", double_pendulum, [far])
    refuses(TypeError, r"joints\[0\] must be a cg.frames.Joint", double_pendulum, ["ball"])
