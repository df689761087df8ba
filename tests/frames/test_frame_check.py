"""Frames of the user: `cg.frames.check`, and flows that leave the manifold."""

import numpy as np
import pytest
from bracket_examples import CLOSED, HEISENBERG_GROUP
from frame_examples import FRAMES, name
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean, FieldFrame, MatrixFrame, Sphere, check


@pytest.mark.parametrize("frame", [*FRAMES, CLOSED, HEISENBERG_GROUP], ids=name)
def test_check_passes_for_package_frames(frame):
    assert check(frame, rng=np.random.default_rng(1)) is None


def shear(v, y):
    """Flow of x' = v0 x + v1, z' = v0 z."""
    grown = np.exp(v[0])
    shift = v[1] * (np.expm1(v[0]) / v[0] if v[0] else 1.0)
    return np.array([grown * y[0] + shift, grown * y[1]])


RIGHT = {
    "fields": [lambda y: np.array([y[0], y[1]]), lambda y: np.array([1.0, 0.0])],
    "flow": shear,
    "point_shape": 2,
    "bracket": lambda u, v: np.array([0.0, u[0] * v[1] - u[1] * v[0]]),
    "membership_error": lambda y: max(0.0, -y[1]),
    "random_point": lambda rng: np.array([rng.standard_normal(), 1.0 + rng.random()]),
    "project": lambda y: y,
}


def test_check_passes_for_a_correct_user_frame():
    check(FieldFrame(**RIGHT))
    check(FieldFrame(**RIGHT), points=[[0.3, 1.2], [0.0, 2.0]])


@pytest.mark.parametrize(("change", "message"), [
    ({"flow": lambda v, y: shear(-v, y)}, r"flow has the wrong sign: .* -field\(v, y\)"),
    ({"flow": lambda v, y: shear(v, y) + 0.01}, r"flow\(0, y\) isn't y"),
    ({"flow": lambda v, y: np.array([y[0] + v[0] * y[0] + v[1], y[1] + v[0] * y[1]])},
     r"flow\(a v, flow\(b v, y\)\) isn't flow\(\(a \+ b\) v, y\) \(by"),
    ({"flow": lambda v, y: shear(1.1 * v, y)}, r"field\(v, y\) isn't the derivative of flow"),
    ({"bracket": lambda u, v: np.array([0.0, u[1] * v[0] - u[0] * v[1]])},
     "bracket has the wrong sign"),
    ({"bracket": lambda u, v: np.array([0.0, 2 * (u[0] * v[1] - u[1] * v[0])])},
     r"field\(bracket\(u, v\), y\) isn't the commutator"),
    ({"exp_coordinates": lambda x, y: np.array([0.1, 0.2])},
     r"flow\(exp_coordinates\(y0, y1\), y0\) isn't y1"),
    ({"membership_error": lambda y: abs(y[0])}, "points aren't on the manifold"),
    ({"project": lambda y: y + 1.0}, "project moves points of the manifold"),
], ids=lambda value: next(iter(value)) if isinstance(value, dict) else "")  # fmt: skip
def test_check_reports_inconsistencies(change, message):
    with pytest.raises(ValueError, match=f"^frame is inconsistent: .*{message}"):
        check(FieldFrame(**(RIGHT | change)))


def test_check_reports_brackets_of_no_lie_algebra():
    """Where fields vanish, they are commutators whatever they are."""
    algebra = FieldFrame(
        [lambda y: np.zeros(1)] * 3, lambda v, y: y, point_shape=1,
        bracket=lambda u, v: np.array([0.0, np.cross(u, v)[2], np.cross(u, v)[0]]),
    )  # fmt: skip
    refuses(ValueError, "bracket violates Jacobi's identity", check, algebra, points=[[1.0]])


def test_check_reports_flows_off_the_manifold():
    off = lambda v, y: Sphere(1).flow(v, y) * (1 + 1e-3 * v[0] ** 2)
    circle = FieldFrame(
        [lambda y: np.array([-y[1], y[0]])], off, point_shape=2,
        membership_error=lambda y: abs(np.hypot(*y) - 1),
        random_point=lambda rng: np.array([1.0, 0.0]),
    )  # fmt: skip
    refuses(ValueError, "flow leaves the manifold", check, circle)


def test_arguments():
    refuses(TypeError, "rng must", check, SO3(), rng=3)
    refuses(ValueError, "points must", check, SO3(), points=np.eye(3))
    refuses(ValueError, "points must", check, Euclidean(2), points="x")
    ellipse = MatrixFrame([[[0.0, -1.0], [4.0, 0.0]]], membership_error=lambda y: 0.0)
    refuses(NotImplementedError, "but no random_point", check, ellipse)
    check(ellipse, points=[[1.0, 0.0]])


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("good_until", [-1.0, 0.5])
def test_nonnumeric_flows_raise(value, good_until):
    """The flow fails at the first call or at a later one."""

    flow = lambda v, y: y + v if y[0] + v[0] <= good_until else value * np.ones(1)
    frame = FieldFrame([lambda y: np.ones(1)], flow, point_shape=1)
    solution = cg.solve_ivp(lambda t, y: np.ones(1), (0, 1), [0.0], frame=frame)
    assert not solution.success
    assert "the flow of FieldFrame(" in solution.message
    assert "returned NaN or infinity at t = 0" in solution.message
    assert abs(solution.t[-1] - max(good_until, 0.0)) < 1e-14


def drifting(restore=None):
    """A circle whose flow leaves it slightly."""
    return FieldFrame(
        [lambda y: np.array([-y[1], y[0]])],
        lambda v, y: (1 + 1e-7 * abs(v[0])) * np.array(
            [np.cos(v[0]) * y[0] - np.sin(v[0]) * y[1], np.sin(v[0]) * y[0] + np.cos(v[0]) * y[1]]
        ),
        point_shape=2, membership_error=lambda y: abs(np.hypot(*y) - 1), restore=restore,
    )  # fmt: skip


@pytest.mark.parametrize("many", [False, True])
def test_solution_off_the_manifold_warns(many):
    def solve(frame):
        options = {"frame": frame, "method": "CG4a", "h": 0.1}
        if many:
            return cg.solve_ensemble(lambda t, y: [1.0], (0, 1), [[1.0, 0.0]] * 2, **options)
        return cg.solve_ivp(lambda t, y: [1.0], (0, 1), [1.0, 0.0], **options)

    with pytest.warns(UserWarning, match="the solution has left the manifold: .* 1e-08") as caught:
        solve(drifting())
    assert caught[0].filename == __file__
    solve(drifting(lambda y: y / np.hypot(*y)))
