"""Phase spaces: points, inertia, velocities, and what is refused."""

import pickle

import numpy as np
import pytest
from mechanics import INERTIA, MATRIX
from refusals import refuses

import cg
from cg import frames as fr

BODIES = fr.Power(fr.Product(fr.Euclidean(3), fr.UnitQuaternion()), 2)
FRAMES = [
    fr.PhaseSpace(fr.SO3(), INERTIA), fr.PhaseSpace(fr.SU(3)),
    fr.PhaseSpace(fr.Euclidean(3), MATRIX), fr.PhaseSpace(BODIES, (2.0, MATRIX)),
    fr.PhaseSpace(fr.Product(fr.Sphere(2), fr.SO(4)), (3.0, None)),
]  # fmt: skip


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_a_phase_space_is_a_frame(frame):
    fr.check(frame)
    assert frame.dim == 2 * frame.configuration.dim == 2 * frame.rhs_dim
    assert pickle.loads(pickle.dumps(frame)) == frame
    assert len({frame, fr.PhaseSpace(frame.configuration, frame.inertia)}) == 1
    assert eval(repr(frame), {name: getattr(fr, name) for name in fr.__all__}) == frame
    rng = np.random.default_rng(1)
    y = frame.random_point(rng, 3)
    q, momentum = frame.split(y)
    assert np.allclose(frame.join(q, momentum), y, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("inertia", [INERTIA, np.diag(INERTIA), MATRIX, 2.5, None])
def test_velocities_are_those_of_the_inertia(inertia):
    frame = fr.PhaseSpace(fr.UnitQuaternion(), inertia)
    full = np.eye(3) * 1.0 if inertia is None else np.array(inertia)
    full = full if full.ndim == 2 else np.diag(np.broadcast_to(full, 3))
    rng = np.random.default_rng(2)
    y, force = frame.random_point(rng, 4), rng.normal(size=(4, 3))
    momentum = frame.split(y)[1]
    velocity = np.linalg.solve(full, momentum.T).T
    assert np.allclose(frame.velocity(y), velocity, rtol=0.0, atol=1e-14)
    assert np.allclose(
        frame.kinetic_energy(y), 0.5 * (velocity * momentum).sum(axis=-1), rtol=0.0, atol=1e-14
    )
    # the term of the momentum is that of the brackets, on all sides
    term = [momentum[k] @ frame.configuration.bracket(np.eye(3), velocity[k]).T for k in range(4)]
    expected = np.concatenate([velocity, force + term], axis=-1)
    assert np.allclose(frame.complete_rhs(force, y), expected, rtol=0.0, atol=1e-14)


def test_inertia_of_equal_and_of_different_factors():
    frame = fr.PhaseSpace(BODIES, (2.0, INERTIA))
    same = fr.PhaseSpace(fr.Product(*BODIES.factor.factors * 2), (2.0, INERTIA) * 2)
    y = frame.random_point(np.random.default_rng(3))
    assert np.array_equal(frame.velocity(y), same.velocity(y))
    assert fr.PhaseSpace(fr.SO3(), INERTIA) == fr.PhaseSpace(fr.SO3(), np.diag(INERTIA))
    assert fr.PhaseSpace(fr.SO3(), INERTIA) != fr.PhaseSpace(fr.SO3())


@pytest.mark.parametrize(("frame", "inertia", "message"), [
    (fr.SO3("space"), INERTIA, "in space axes .* take convention='body'"),
    (fr.UnitQuaternion("space"), MATRIX, "must be a multiple of the identity"),
    (fr.SU(3), np.arange(1.0, 9.0), "invariant on both sides"),
    (fr.SO(4), [1.0] * 5 + [2.0], "invariant on both sides"),
    (fr.Sphere(2), INERTIA, "must be a multiple of the identity"),
    (fr.SE3(), None, r"frame must be one whose free motion is known"),
    (fr.Stiefel(3, 2), None, "frame must be one whose free motion is known"),
    (fr.PhaseSpace(fr.SO3()), None, "frame must be one whose free motion is known"),
    (fr.Sphere(3), None, "frame must be compiled"),
    (fr.SO3(), [1.0, 2.0], r"inertia must have shape \(3,\) or \(3, 3\), got \(2,\)"),
    (fr.SO3(), [1.0, -2.0, 1.0], "inertia must be positive definite"),
    (fr.SO3(), [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "inertia must be symmetric"),
    (fr.Euclidean(1), np.nan, "inertia must be finite"),
    (BODIES, INERTIA, "inertia must be a tuple of 2, one of each factor"),
    (BODIES, (1.0, [1.0, 2.0]), r"inertia\[1\] must have shape"),
    (fr.Power(fr.SO3(), 3), np.eye(3), r"may mean one matrix or 3 diagonals"),
    (fr.Power(fr.SO3(), 4), np.ones((5, 3)), r"or one for each body, \(4, 3\) or \(4, 3, 3\)"),
    (fr.Power(fr.SO3(), 2), [INERTIA, [1.0, -1.0, 1.0]], r"inertia\[1\] must be positive def"),
    (fr.SO3(), [1.0, 1.0, 0.0], r"a linear rotor, is a Sphere\(2\)"),
])  # fmt: skip
def test_what_is_refused(frame, inertia, message):
    refuses(ValueError, message, fr.PhaseSpace, frame, inertia)


def test_other_mistakes():
    refuses(TypeError, "frame must be a Frame", fr.PhaseSpace, 3)
    with pytest.raises(ValueError, match="parts must be a configuration and a momentum, got 1"):
        FRAMES[0].join(np.eye(3))
    refuses(ValueError, r"parts\[1\] must have shape", FRAMES[0].join, np.eye(3), [1.0, 2.0])


def test_momenta_along_points_of_spheres_are_refused():
    frame = fr.PhaseSpace(fr.Product(fr.SO3(), fr.Sphere(2)), ([1.0, 1.6, 2.3], 2.0))
    good = frame.random_point(np.random.default_rng(0), 3)
    np.testing.assert_array_equal(frame.join(*frame.split(good)), good)
    bad = good + np.array([*np.zeros(15), *(0.1 * good[1, 9:12])])
    f, why = lambda t, y: np.zeros(6), r"join\(q, momentum\) removes the momentum along"
    event = cg.Event(lambda t, y: t - 0.5, jump=lambda t, y: bad[1])
    refuses(ValueError, why, cg.solve_ivp, f, (0, 1), bad[1], frame=frame)
    refuses(ValueError, why, cg.solve_ensemble, f, (0, 1), bad, frame=frame)
    refuses(ValueError, why, cg.solve_ivp, f, (0, 1), good[1], frame=frame, events=event)
    refuses(ValueError, why, cg.Stepper(f, 0.0, good[1], frame=frame).restart, y=bad[1])
