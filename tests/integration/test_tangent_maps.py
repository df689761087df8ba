"""Derivatives of solutions by splitting methods: tangent maps of kicks and drifts."""

import numpy as np
import pytest
from mechanics import INERTIA, MATRIX, system
from refusals import refuses

import cg
from cg.frames import SO, SO3, SU, Euclidean, PhaseSpace, Product, Sphere, UnitQuaternion

SYSTEMS = {
    "SO3": (SO3(), INERTIA), "quaternion": (UnitQuaternion(), MATRIX),
    "Euclidean": (Euclidean(3), MATRIX), "SU3": (SU(3), None), "space axes": (SO3("space"), 2.0),
    "sphere": (Sphere(2), 2.0),
    "product": (Product(SO3(), SO(4), Euclidean(2)), (INERTIA, None, 2.0)),
}  # fmt: skip
SIXTH = {"method": "BlanesMoan6", "h": 0.05, "derivatives": "forward"}


def symplectic_form(frame, y):
    """Return the matrix of the form in coordinates of the configuration and the momentum."""
    m, momentum = frame.rhs_dim, frame.split(y)[1]
    brackets = [frame.configuration.bracket(e, np.eye(m)) @ momentum for e in np.eye(m)]
    return np.block([[np.array(brackets), -np.eye(m)], [np.eye(m), np.zeros((m, m))]])


def defect(frame, transition, y0, y1):
    form = symplectic_form(frame, y1)
    return np.abs(transition.T @ form @ transition - symplectic_form(frame, y0)).max()


@pytest.mark.parametrize("name", SYSTEMS)
def test_tangent_maps_are_symplectic_and_those_of_other_methods(name):
    top = system(*SYSTEMS[name])
    run = top.run(t_eval=[0.33, 1.0], **SIXTH)
    plain = top.run("BlanesMoan6", h=0.05, t_eval=[0.33, 1.0])
    assert np.array_equal(run.y, plain.y)
    assert defect(top.frame, run.transition[-1], top.y0, run.y[-1]) < 1e-10
    other = top.reference(t_eval=[0.33, 1.0], derivatives="forward", control_derivatives=True)
    # differences of forces have errors of 1e-10
    assert np.allclose(run.transition, other.transition, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("h", [0.3, 40.0])
@pytest.mark.parametrize("name", ["SO3", "quaternion", "product"])
def test_tangents_of_drifts_are_exact(name, h):
    frame = PhaseSpace(*SYSTEMS[name])
    y0 = frame.random_point(np.random.default_rng(2))
    run = cg.solve_ivp(
        lambda t, y: np.zeros(frame.rhs_dim), (0, h), y0, frame=frame, h=h, method="Leapfrog",
        derivatives="forward",
    )  # fmt: skip
    transition = run.transition[-1]
    size = 1 + np.abs(transition).max()
    # the exact motion itself has roundings in proportion to the turns
    assert defect(frame, transition, y0, run.y[-1]) < 1e-14 * (1 + h) * size**2


def test_members_and_parameters():
    frame = PhaseSpace(SO3(), INERTIA)

    def f(t, y, row):
        return row[..., :1] * np.cross([0.0, 0.0, 1.0], frame.split(y)[0][..., 2, :])

    y0 = frame.join(np.eye(3), [0.5, 0.1, 1.0])
    rows = np.array([[-1.0], [-1.5]])
    each = [
        cg.solve_variational(f, (0, 2), y0, frame=frame, parameters=row, method="BlanesMoan4",
                             h=0.1, P0=np.eye(6)) for row in rows
    ]  # fmt: skip
    for vectorized in (False, True):
        both = cg.solve_variational_ensemble(
            f, (0, 2), y0, frame=frame, parameters=rows, method="BlanesMoan4", h=0.1,
            vectorized=vectorized,
        )  # fmt: skip
        for k, one in enumerate(each):
            assert np.allclose(both.transition[-1, k], one.transition[-1], rtol=0.0, atol=1e-10)
            assert np.allclose(both.sensitivity[-1, k], one.sensitivity[-1], rtol=0.0, atol=3e-11)
    ends = [
        cg.solve_ivp(f, (0, 2), y0, frame=frame, parameters=rows[0] + d, method="BlanesMoan4",
                     h=0.1).y[-1] for d in (1e-5, -1e-5)
    ]  # fmt: skip
    moved = frame.exp_coordinates(ends[1], ends[0]) / 2e-5
    assert np.allclose(each[0].sensitivity[-1, :, 0], moved, rtol=0.0, atol=1e-8)
    transition = each[0].transition
    assert np.allclose(each[0].covariance, transition @ transition.mT, rtol=0.0, atol=1e-13)


def test_events_and_dense_output_have_derivatives():
    top = system(SO3(), INERTIA)
    event = cg.Event(lambda t, y: y[0], terminal=True)
    options = {"derivatives": "forward", "events": event, "dense_output": True}
    run = top.run("BlanesMoan6", (0, 10), h=0.05, **options)
    other = top.reference((0, 10), control_derivatives=True, **options)
    assert np.allclose(run.t_events[0], other.t_events[0], rtol=0.0, atol=4e-13)
    assert np.allclose(run.dt_events[0], other.dt_events[0], rtol=0.0, atol=1e-10)
    t = 0.71 * run.t[-1]
    assert np.allclose(run.sol(t), top.reference((0, t)).y[-1], rtol=0.0, atol=5e-13)


def test_what_is_refused():
    top = system(SO3(), INERTIA)
    for more in ({"derivatives": "adjoint"}, {"noise": np.eye(6)}):
        options = SIXTH | more
        refuses(ValueError, "must not be a splitting method with", top.run, **options)
