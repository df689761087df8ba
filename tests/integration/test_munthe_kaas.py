"""Munthe-Kaas methods: steps, orders on all frames, error estimates, output."""

from functools import partial

import numpy as np
import pytest
import scipy.integrate
from bracket_examples import CLOSED, CLOSED_COORDINATES, HEISENBERG_GROUP, vectors
from frame_examples import HEISENBERG, generic, name
from kinds import MUNTHE_KAAS
from python_steps import Step, uncompiled
from refusals import refuses

import cg
from cg import frames as fr
from cg.construction.catalogue import dumps, loads
from cg.construction.methods.compile import error_exponent
from cg.construction.methods.low_storage import from_two_registers
from cg.construction.points import MethodError
from cg.frames import SO, SO3, Euclidean, MatrixFrame, Product, Sphere, UnitQuaternion
from cg.frames.facts import dexpinv_of, facts_of


def test_reuse_of_the_last_stage():
    f, y0 = generic(SO3())
    for key, evaluations in {"RKMK3(2)": 3, "RKMK4": 4, "RKMK5(4)": 6, "RKMK8(5,3)": 12}.items():
        run = cg.integrate(f, (0, 1), y0, frame=SO3(), method=key, h=0.1)
        assert run.nfev == 10 * evaluations + (evaluations < MUNTHE_KAAS[key].stages)


class TestEuclideanSpaceIsScipy:
    def f(self, t, y):
        return np.array([y[1], -np.sin(y[0]) + 0.1 * t, y[0] * y[2] - 0.2])

    y0 = np.array([1.0, 0.3, 0.7])

    @pytest.mark.parametrize(("key", "solver"), [
        *((key, scipy.integrate.RK23) for key in ("RKMK3(2)", "BS3(2)")),
        *((key, scipy.integrate.RK45) for key in ("RKMK5(4)", "DP5(4)")),
        *((key, scipy.integrate.DOP853) for key in ("RKMK8(5,3)", "DOP853")),
    ])  # fmt: skip
    def test_steps_and_estimates(self, key, solver):
        method = cg.methods[key]
        theirs = solver(self.f, 0.0, self.y0, 5.0, rtol=1e-6, atol=1e-8)
        assert error_exponent(method) == -theirs.error_exponent
        step, compared = Step(self.f, Euclidean(3), method), 0
        while theirs.status == "running":
            theirs.step()
            t, h = theirs.t_old, theirs.t - theirs.t_old
            scale = 1e-8 + 1e-6 * np.maximum(np.abs(theirs.y_old), np.abs(theirs.y))
            expected = theirs._estimate_error_norm(theirs.K, h, scale)
            # in tolerances, that of the points where these are compared, else that of the sum
            rounding = 4 * np.finfo(float).eps / 1e-6
            if method.error_weights:
                weights = theirs.E5 if hasattr(theirs, "E5") else theirs.E
                terms = h * np.abs(theirs.K).T @ np.abs(weights) / scale
                rounding = np.finfo(float).eps * np.sqrt(np.mean(terms**2))
            y, error = step.trial(t, theirs.y_old, h, 1e-6, 1e-8)
            np.testing.assert_allclose(y, theirs.y, rtol=1e-14, atol=1e-15)
            assert error == pytest.approx(expected, rel=1e-6, abs=rounding)
            y, factor = self.first_step(method, t, theirs.y_old, h)
            np.testing.assert_allclose(y, theirs.y, rtol=1e-14, atol=1e-15)
            if factor < 5.0 - 1e-9:
                error = (factor / 0.9) ** (-1.0 / (0.7 * error_exponent(method)))
                assert error == pytest.approx(expected, rel=1e-6)
                compared += 1
        assert compared > 3

    def first_step(self, method, t, y, h):
        """Return the end of a step, and how much longer the next one is by its estimate."""
        times = []

        def f(t, y):
            times.append(t)
            return self.f(t, y)

        options = {"frame": Euclidean(3), "method": method, "rtol": 1e-6, "atol": 1e-8}
        run = cg.solve_ivp(f, (t, t + 100.0), y, first_step=h, max_steps=2, **options)
        # the first time after the first step is that of the second stage of the second one
        after = next(time for time in times if time > run.t[1] + 1e-12)
        return run.y[1], (after - run.t[1]) / float(method.c[1]) / (run.t[1] - t)


def test_turns_about_the_point_of_a_sphere_are_no_error():
    f, y0 = generic(Sphere(2))

    spun = lambda t, y: f(t, y) + 3.0 * np.sin(9.0 * t) * y
    steps = [
        cg.solve_ivp(g, (0, 2), y0, frame=Sphere(2), method="RKMK5(4)", rtol=1e-7, atol=1e-7).steps
        for g in (f, spun)
    ]
    assert steps[1] < 2.5 * steps[0]


@pytest.mark.parametrize("key", [key for key, method in MUNTHE_KAAS.items() if method.explicit])
@pytest.mark.parametrize("frame", [
    UnitQuaternion(), SO3(), Sphere(2), fr.SE3(), SO(4), fr.SU(2), fr.SU(3),
    fr.IsospectralOrbit((0.0, 1.0, 3.0)),
], ids=name)  # fmt: skip
def test_constant_fields_may_turn_any_number_of_times(frame, key):
    """Brackets that should vanish are rounding, which dexp^-1 amplifies near its pole at a turn."""
    v = np.resize([0.7, -0.2, 0.55, 0.3, 0.2, 0.1], frame.dim)
    y0, turn = frame.random_point(np.random.default_rng(5)), 2 * np.pi / np.linalg.norm(v[:3])
    for h in turn * np.array([0.9, 1.0, 1.1, 1.4, 1.5, 3.3]):
        options = {"frame": frame, "method": key, "h": h, "dense_output": True}
        run = cg.solve_ivp(lambda t, y: v, (0, 5 * h), y0, **options)
        t = np.linspace(0, 5 * h, 23)
        expected = np.array([frame.flow(x * v, y0) for x in t])
        np.testing.assert_allclose(run.sol(t), expected, rtol=0, atol=2e-12)
    if cg.methods[key].embedded_order:
        options |= {"h": None, "max_step": 1.5 * turn}
        assert cg.solve_ivp(lambda t, y: v, (0, 40 * turn), y0, **options).nrejected == 0


class TestBadInput:
    @pytest.mark.parametrize(("frame", "reason"), [
        (HEISENBERG, "span a Lie algebra, pass"),
        (Product(SO3(), HEISENBERG), "span a Lie algebra, pass"),
        (MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]]]), "do not span a"),
    ], ids=["functions", "product", "matrices"])  # fmt: skip
    def test_frames_without_brackets(self, frame, reason):
        y0 = frame.random_point(np.random.default_rng(0))
        for call in (cg.solve_ivp, cg.integrate):
            with pytest.raises(ValueError, match=rf"method must be .*RKMK4.*brackets: .*{reason}"):
                call(
                    lambda t, y: np.ones(frame.dim), (0, 1), y0, frame=frame, method="RKMK4", h=0.1
                )


@pytest.mark.parametrize("frame", [SO3(), SO(4)], ids=name)
def test_rows_that_repeat_or_are_zero(frame):
    """A stage at the initial point, two at one point, and one at the result that isn't the last."""
    rows = [[], [0], ["1/2", 0], ["1/2", 0, 0], ["1/4", 0, 0, "3/4"], [0, 0, 0, 1, 0]]
    weights = ["1/12", "1/12", "1/3", "1/3", 0, "1/6"]
    method = cg.MuntheKaas(cg.Tableau(rows, weights))
    # the same points, once each
    without = cg.MuntheKaas(
        cg.Tableau([[], ["1/2"], ["1/4", "3/4"], [0, 1, 0]], ["1/6", "2/3", 0, "1/6"])
    )
    f, y0 = generic(frame)
    options = {"frame": frame, "h": 0.1, "dense_output": True}
    one, other = (cg.solve_ivp(f, (0, 1), y0, method=m, **options) for m in (method, without))
    np.testing.assert_allclose(one.y, other.y, rtol=0, atol=1e-14)
    t = np.linspace(0, 1, 23)
    np.testing.assert_allclose(one.sol(t), other.sol(t), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["BS3(2)", "DVERK6(5)", "Verner7(6)", "Verner8(7)"])
def test_interpolants_of_any_tableau_meet_the_conditions_of_their_order(name):
    """On a quadrature and on an equation in the plane, where the flat order is seen."""
    method = cg.MuntheKaas(cg.Tableau(*cg.methods[name].exact))
    known = {"BS3(2)": 0, "DVERK6(5)": 4, "Verner7(6)": 6, "Verner8(7)": 9}
    assert len(method.table().output.theta) == known[name]

    f = lambda t, y: [-y[1] + 0.3 * np.sin(t), y[0] * y[1]]
    sizes, t = np.array([0.2, 0.1]), np.linspace(0.1, 0.9, 9)
    options = {"frame": Euclidean(2), "rtol": 1e-13, "atol": 1e-15, "dense_output": True}
    exact = cg.solve_ivp(f, (0, 0.2), [1.0, 0.5], **options).sol
    errors = []
    for h in sizes:
        interpolant = cg.solve_ivp(
            f, (0, h), [1.0, 0.5], frame=Euclidean(2), method=method, h=h, dense_output=True
        ).sol
        errors.append(np.abs(interpolant(h * t) - exact(h * t)).max())
    assert np.log2(errors[0] / errors[1]) > method.order + 0.6


EULER = cg.Tableau([[]], [1])
HEUN = cg.Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0], name="Heun")


class TestMethods:
    def test_orders_stages_and_flows(self):
        assert {
            key: (m.order, m.embedded_order, m.third_order, m.stages, m.exponentials)
            for key, m in MUNTHE_KAAS.items()
        } == {
            "RKMK3(2)": (3, 2, None, 4, 3), "RKMK4": (4, None, None, 4, 4),
            "RKMK5(4)": (5, 4, None, 7, 6), "RKMK8(5,3)": (8, 5, 3, 12, 12),
            "RadauIIA5": (5, 3, None, 4, 3),
        }  # fmt: skip
        assert all(m.pair_exponentials == m.exponentials for m in MUNTHE_KAAS.values())

    def test_one_of_a_user(self):
        method = cg.MuntheKaas(HEUN)
        assert (method.name, method.order, method.embedded_order, method.stages) == (
            "Heun", 2, 1, 2,
        )  # fmt: skip
        assert method.exact == HEUN.exact
        assert method.exact_embedded == (1, 0)
        assert method.principal_error == pytest.approx(np.sqrt(2.0) / 6.0, abs=5e-15)
        assert method.max_residual() == 0
        assert method.max_residual(3) == pytest.approx(1 / 6, abs=5e-15)
        assert repr(method) == "<MuntheKaas Heun: order 2(1), 2 evaluations, 2 flows>"
        assert method == cg.MuntheKaas(HEUN, name="other")
        assert method != cg.MuntheKaas(EULER)
        assert method != HEUN
        assert method.embedded == cg.MuntheKaas(cg.Tableau([[], [1]], [1, 0]))

    @pytest.mark.parametrize(("make", "message"), [
        (lambda: cg.MuntheKaas(cg.methods["CF4"]), "tableau must be a Tableau, got"),
        (lambda: cg.MuntheKaas("RK4"), "tableau must be a Tableau, got 'RK4'"),
        (lambda: cg.MuntheKaas(cg.methods["ImplicitMidpoint"]), "tableau must be explicit"),
        (lambda: cg.MuntheKaas(EULER, third=[1]), "third must be None unless"),
        (lambda: cg.MuntheKaas(HEUN, third=[1]), "third must have 2 entries, got 1"),
        (lambda: cg.MuntheKaas(HEUN, third=[1, 0]), "third must differ"),
        (lambda: cg.MuntheKaas(HEUN, third="ab"), "third must be a sequence"),
        (lambda: cg.MuntheKaas(HEUN, third=["x", 0]), r"third\[0\]: expected a finite real"),
        (lambda: cg.MuntheKaas(cg.Tableau([[]], [0])), "result must depend on a stage"),
        (lambda: cg.MuntheKaas(HEUN, name=3), "name must be a str"),
        (lambda: loads(dumps(MUNTHE_KAAS["RKMK4"]).replace("e-K", "e-k")), "kind must be"),
    ])  # fmt: skip
    def test_rejected_arguments(self, make, message):
        refuses(MethodError, message, make)

    def test_it_is_no_method_of_two_registers(self):
        chain = from_two_registers([0], ["1"])
        euler = cg.MuntheKaas(cg.Tableau([[]], chain.exact[1]))
        f, y0 = generic(SO3())
        runs = [cg.integrate(f, (0, 1), y0, frame=SO3(), method=m, h=0.5) for m in (chain, euler)]
        np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=1e-15)

    def test_warnings_of_pairs(self):
        close = cg.Tableau(
            [[], [1]], ["1/2", "1/2"], b_embedded=["50000001/100000000", "49999999/100000000"]
        )
        f, y0 = generic(SO3())
        with pytest.warns(UserWarning, match="both its results|nearly coincide"):
            cg.solve_ivp(f, (0, 1), y0, frame=SO3(), method=cg.MuntheKaas(close))
        nothing = cg.MuntheKaas(cg.Tableau([[], [1]], ["1/2", "1/4"]))
        with pytest.warns(UserWarning, match="has order 0"):
            cg.integrate(f, (0, 1), y0, frame=SO3(), method=nothing, h=0.5)


TURN = 2 * np.pi
WITH_SERIES = [
    fr.SO(4), fr.SO(5, "space"), fr.SU(3), fr.SU(4, "body"), fr.U(2), fr.SL(3), fr.Sphere(3),
    fr.Stiefel(4, 2), fr.IsospectralOrbit((1.0, 2.0, 4.0, 7.0)), fr.Semidirect(fr.SO(4)), CLOSED,
    fr.Power(fr.SU(3), 2), fr.SO(8),
]  # fmt: skip
ALL = [frame for frame in CLOSED_COORDINATES if not isinstance(frame, fr.Euclidean)] + WITH_SERIES


def sized(frame, radius, seed=3):
    """Return coefficients whose brackets have a given spectral radius, and general ones."""
    u, v = vectors(frame, seed, 2)
    adjoint = frame.bracket(u, np.eye(frame.dim))
    return u * (radius / np.abs(np.linalg.eigvals(adjoint)).max()), v


def functions(frame):
    in_python = partial(frame.dexpinv, order=8)
    return [in_python, dexpinv_of(frame, 8)] if facts_of(frame).compiled else [in_python]


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_beyond_it_there_is_no_derivative(frame):
    for radius in (1.3 * TURN, 3.5 * TURN):
        u, v = sized(frame, radius)
        for dexpinv in functions(frame):
            assert np.isnan(dexpinv(u, v)).any()
            members = dexpinv(np.stack([u, 0.1 * u]), np.stack([v, v]))
            assert np.isnan(members[0]).any()
            assert np.isfinite(members[1]).all()


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_within_it_there_is(frame):
    u, v = sized(frame, 0.98 * TURN)
    first, *others = (dexpinv(u, v) for dexpinv in functions(frame))
    assert np.isfinite(first).all()
    for other in others:
        np.testing.assert_allclose(other, first, rtol=0, atol=2e-14 * np.abs(first).max())


@pytest.mark.parametrize("frame", ALL, ids=name)
def test_commuting_coefficients_are_unchanged(frame):
    u, _ = sized(frame, 3.5 * TURN)
    for dexpinv in functions(frame):
        np.testing.assert_allclose(dexpinv(u, -2.0 * u), -2.0 * u, rtol=1e-14, atol=1e-14)


def test_a_nilpotent_algebra_has_no_radius():
    u, v = 1e3 * vectors(HEISENBERG_GROUP, 1, 2)
    expected = v - HEISENBERG_GROUP.bracket(u, v) / 2
    np.testing.assert_allclose(HEISENBERG_GROUP.dexpinv(u, v), expected, rtol=1e-14)


FAST = 40.0
STEPPED = [
    fr.SO3(), fr.SE3("space"), fr.UnitQuaternion(), fr.SU(2), fr.Sphere(2), fr.SO(4), fr.SU(3),
    fr.Product(fr.Euclidean(2), fr.SO3("space")), fr.SL(3), fr.Sphere(3), fr.Stiefel(4, 2), CLOSED,
]  # fmt: skip


def fast(frame):
    f, y0 = generic(frame)
    return (lambda t, y: FAST * f(t, y)), y0


@pytest.mark.parametrize("key", ["RKMK4", "RKMK8(5,3)"])
@pytest.mark.parametrize("frame", STEPPED, ids=name)
def test_an_equal_step_that_is_too_long_is_named(frame, key):
    f, y0 = fast(frame)
    message = r"step from t = 0.5 .*too long.*smaller h"

    late = lambda t, y: f(t, y) if t > 0.5 else 0.001 * f(t, y)
    for same in (frame, uncompiled(frame)):
        with pytest.raises(cg.StepTooLongError, match=message):
            cg.integrate(late, (0, 4), y0, frame=same, method=key, h=0.5)


@pytest.mark.parametrize("frame", STEPPED, ids=name)
def test_a_chosen_step_that_is_too_long_is_rejected(frame):
    f, y0 = fast(frame)
    # tolerances that anything meets
    options = {"method": "RKMK5(4)", "rtol": 0.5, "atol": 1e6, "first_step": 0.25}
    actual, again = (
        cg.solve_ivp(f, (0, 0.25), y0, frame=same, **options) for same in (frame, uncompiled(frame))
    )
    assert actual.success
    assert actual.nrejected >= 1
    assert actual.steps >= 2
    assert frame.membership_error(actual.y).max() < 1e-9
    for count in ("steps", "nrejected", "nfev"):
        assert getattr(actual, count) == getattr(again, count)
