"""Methods of Munthe-Kaas: what they are, their orders on all frames, their estimates and output."""

import ctypes
import pickle
from unittest.mock import patch

import numpy as np
import pytest
import scipy.integrate
from compiled_examples import PROBLEMS
from frame_examples import HEISENBERG, LARGEST_SCALE, name
from test_brackets import HEISENBERG_GROUP, WITH

import cg
from cg.catalogue import dumps, load, loads, munthe_kaas, resolve_method, save
from cg.convergence import observed_order
from cg.frames import (
    SE3,
    SO,
    SO3,
    SU,
    CoadjointOrbit,
    Euclidean,
    MatrixFrame,
    Power,
    Product,
    Sphere,
    Stiefel,
    U,
    UnitQuaternion,
)
from cg.integration.built_in import integrate_affine
from cg.integration.error_norm import ErrorNorm
from cg.integration.flows import _Dexpinv, _Flows, dexpinv_of
from cg.integration.problem import Problem
from cg.integration.step import Step
from cg.integration.stepper import error_exponent
from cg.low_storage import from_two_registers
from cg.points import MethodError
from cg.problems.affine import AffineField

METHODS = dict(munthe_kaas)
EULER = cg.Tableau([[]], [1])
HEUN = cg.Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0], name="Heun")


def generic(frame, seed=11):
    rng = np.random.default_rng(seed)
    y0 = frame.random_point(rng)
    weights = rng.standard_normal((frame.dim, 2 * y0.size)) / np.sqrt(2 * y0.size)

    def f(t, y):
        flat = y.reshape(*y.shape[: y.ndim - y0.ndim], -1)
        both = np.concatenate([flat.real, flat.imag], axis=-1)
        return np.sin(both @ weights.T + np.arange(frame.dim) + t)

    return f, y0


class TestMethods:
    def test_orders(self):
        found = {key: (m.order, m.embedded_order, m.third_order) for key, m in METHODS.items()}
        assert found == {
            "RKMK3(2)": (3, 2, None),
            "RKMK4": (4, None, None),
            "RKMK5(4)": (5, 4, None),
            "RKMK8(5,3)": (8, 5, 3),
        }

    def test_flows(self):
        found = {key: (m.stages, m.exponentials, m.pair_exponentials) for key, m in METHODS.items()}
        assert found == {
            "RKMK3(2)": (4, 3, 3),
            "RKMK4": (4, 4, 4),
            "RKMK5(4)": (7, 6, 6),
            "RKMK8(5,3)": (12, 12, 12),
        }

    @pytest.mark.parametrize("key", METHODS)
    def test_they_can_be_written_and_read(self, key, tmp_path):
        method = METHODS[key]
        assert loads(dumps(method)) == method
        save(method, tmp_path / "method.toml")
        again = load(tmp_path / "method.toml")
        assert (again, again.name, again.source) == (method, method.name, method.source)
        assert pickle.loads(pickle.dumps(method)) == method
        assert hash(again) == hash(method)
        assert resolve_method(key) is method

    def test_coefficients_of_scipy(self):
        for key, theirs in (
            ("RKMK3(2)", scipy.integrate.RK23),
            ("RKMK5(4)", scipy.integrate.RK45),
            ("RKMK8(5,3)", scipy.integrate.DOP853),
        ):
            method, stages = METHODS[key], len(theirs.B)
            size = min(theirs.A.shape[1], stages)
            a = theirs.A[:stages, :size]
            np.testing.assert_allclose(method.a[:stages, :size], a, rtol=0, atol=1e-14)
            np.testing.assert_allclose(method.b[:stages], theirs.B, rtol=0, atol=1e-15)
        weights = np.array(METHODS["RKMK8(5,3)"].error_weights, dtype=float)
        np.testing.assert_allclose(weights[0], scipy.integrate.DOP853.E5[:-1], rtol=0, atol=1e-15)
        np.testing.assert_allclose(weights[1], scipy.integrate.DOP853.E3[:-1], rtol=0, atol=1e-15)

    def test_one_of_a_user(self):
        method = cg.MuntheKaas(HEUN)
        assert (method.name, method.order, method.embedded_order, method.stages) == (
            "Heun",
            2,
            1,
            2,
        )
        assert method.exact == HEUN.exact
        assert method.exact_embedded == (1, 0)
        assert method.principal_error() == pytest.approx(np.sqrt(2.0) / 6.0)
        assert method.largest_residual() == 0
        assert method.largest_residual(3) == pytest.approx(1 / 6)
        assert repr(method) == "<MuntheKaas Heun: 2 stages, explicit, a pair>"
        assert method == cg.MuntheKaas(HEUN, name="other")
        assert method != cg.MuntheKaas(EULER)
        assert method != HEUN
        assert method.embedded == cg.MuntheKaas(cg.Tableau([[], [1]], [1, 0]))

    def test_the_weights_of_higher_order_make_the_steps(self):
        swapped = cg.Tableau([[], [1]], [1, 0], b_embedded=["1/2", "1/2"])
        f, y0 = generic(SO3())
        options = {"frame": SO3(), "rtol": 1e-5, "atol": 1e-5}
        runs = [
            cg.solve_ivp(f, (0, 1), y0, method=cg.MuntheKaas(m), **options) for m in (HEUN, swapped)
        ]
        np.testing.assert_array_equal(runs[0].y, runs[1].y)

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: cg.MuntheKaas(cg.methods["CF4"]), "tableau must be a Tableau, got"),
            (lambda: cg.MuntheKaas("RK4"), "tableau must be a Tableau, got 'RK4'"),
            (lambda: cg.MuntheKaas(cg.methods["ImplicitMidpoint"]), "tableau must be explicit"),
            (lambda: cg.MuntheKaas(EULER, third=[1]), "third must be None unless"),
            (lambda: cg.MuntheKaas(HEUN, third=[1]), "third must have 2 entries, got 1"),
            (lambda: cg.MuntheKaas(HEUN, third=[1, 0]), "third must differ"),
            (lambda: cg.MuntheKaas(HEUN, third="ab"), "third must be a sequence"),
            (lambda: cg.MuntheKaas(HEUN, third=["x", 0]), "third_1: expected a finite real"),
            (lambda: cg.MuntheKaas(cg.Tableau([[]], [0])), "result must depend on a stage"),
            (lambda: cg.MuntheKaas(HEUN, name=3), "name must be a str"),
            (lambda: loads(dumps(METHODS["RKMK4"]).replace("e-K", "e-k")), "kind must be"),
        ],
    )
    def test_what_is_refused(self, make, message):
        with pytest.raises(MethodError, match=message):
            make()

    def test_there_are_no_certificates(self):
        with pytest.raises(TypeError, match="method must be a Tableau or CommutatorFree, got <Mun"):
            cg.certify("RKMK4")

    def test_a_name_that_is_none(self):
        with pytest.raises(ValueError, match=r"method must be one of .*RKMK5\(4\).*, got 'RKMK9'"):
            resolve_method("RKMK9")

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


STEPS = {"RKMK3(2)": (2, 8), "RKMK4": (1, 4), "RKMK5(4)": (1, 4)}


@pytest.mark.parametrize("frame", WITH, ids=name)
def test_order_on_all_frames_with_brackets(frame):
    f, y0 = generic(frame)
    first = 0.06 if frame in LARGEST_SCALE else 0.125  # flows that grow

    def solution(key, steps):
        options = {"frame": frame, "method": key, "h": first / steps, "save_every": steps}
        return cg.integrate(f, (0, 4 * first), y0, **options).y[1:]

    fine = solution("RKMK8(5,3)", 4)
    for key, counts in STEPS.items():
        errors = [frame.distance(solution(key, n), fine).max() for n in counts]
        if min(errors) > 2e-12:
            assert np.log2(errors[0] / errors[1]) / 2 > METHODS[key].order - 0.5
        else:
            assert max(errors) < 1e-8  # next to exact: one field, or flows that commute
    assert frame.distance(solution("CF5a", 3), fine).max() < 1e-6


ORDERS = {
    **{key: (m, m.order) for key, m in METHODS.items()},
    **{
        f"{key}, second": (m.embedded, m.embedded_order) for key, m in METHODS.items() if m.embedded
    },
}


@pytest.fixture(scope="module", params=["SO3 body", "SE3 space"])
def solved(request):
    problem = PROBLEMS[request.param]
    return problem, problem.reference([1], bits=128).values[0][:-1]


@pytest.mark.parametrize("key", ORDERS)
def test_slopes_in_quadruple_precision(solved, key):
    (problem, exact), (method, order) = solved, ORDERS[key]
    counts = [8, 16, 32] if order > 5 else [64, 128, 256]
    errors = []
    for n in counts:
        end = integrate_affine(problem, method=method, h=f"1/{n}", steps=n, kind="real128")
        errors.append(float(max(abs(x - y) for x, y in zip(end.exact(-1), exact, strict=True))))
    slope = observed_order(1 / np.array(counts), errors, floor=1e-31)
    assert slope.order == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize("key", METHODS)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_compiled_code_and_python_take_the_same_steps(problem, key):
    problem, method = PROBLEMS[problem], METHODS[key]
    run = cg.integrate(problem.f, (0, 1), problem.y0, frame=problem.frame, method=key, h=0.25)
    step = Step(problem.f, problem.frame, method)
    point = problem.y0
    for k in range(4):
        point = step(0.25 * k, point, 0.25)
    np.testing.assert_allclose(run.y[-1], point, rtol=1e-14, atol=1e-14)
    assert (run.nfev, run.nexp) == (step.counts.nfev, step.counts.nexp)
    assert run.nexp == 4 * method.exponentials


def test_reuse_of_the_last_stage():
    f, y0 = generic(SO3())
    steps = {"RKMK3(2)": 3, "RKMK4": 4, "RKMK5(4)": 6, "RKMK8(5,3)": 12}
    for key, evaluations in steps.items():
        run = cg.integrate(f, (0, 1), y0, frame=SO3(), method=key, h=0.1)
        assert run.nfev == 10 * evaluations + (evaluations < METHODS[key].stages)


class TestEuclideanSpaceIsScipy:
    def f(self, t, y):
        return np.array([y[1], -np.sin(y[0]) + 0.1 * t, y[0] * y[2] - 0.2])

    y0 = np.array([1.0, 0.3, 0.7])

    @pytest.mark.parametrize(
        ("key", "solver"),
        [
            ("RKMK3(2)", scipy.integrate.RK23),
            ("RKMK5(4)", scipy.integrate.RK45),
            ("RKMK8(5,3)", scipy.integrate.DOP853),
        ],
    )
    def test_steps_and_estimates(self, key, solver):
        method = METHODS[key]
        theirs = solver(self.f, 0.0, self.y0, 5.0, rtol=1e-6, atol=1e-8)
        frame = Euclidean(3)
        step = Step(self.f, frame, method)
        norm = ErrorNorm(frame, self.y0, 1e-6, np.array(1e-8))
        while theirs.status == "running":
            theirs.step()
            h = theirs.t - theirs.t_old
            y, error = step.trial(theirs.t_old, theirs.y_old, h, norm)
            np.testing.assert_allclose(y, theirs.y, rtol=1e-14, atol=1e-15)
            scale = 1e-8 + 1e-6 * np.maximum(np.abs(theirs.y_old), np.abs(theirs.y))
            expected = theirs._estimate_error_norm(theirs.K, h, scale)
            assert error == pytest.approx(expected, rel=1e-6)
        assert error_exponent(method) == -theirs.error_exponent

    def test_the_loop_in_compiled_code_estimates_the_same(self):
        for key in ("RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)"):
            options = {"rtol": 1e-7, "atol": 1e-7, "method": key}
            here = cg.solve_ivp(self.f, (0, 5), self.y0, frame=Euclidean(3), **options)
            # translations as matrices, which aren't compiled
            matrices = np.zeros((3, 4, 4))
            matrices[range(3), range(3), 3] = 1.0
            there = cg.solve_ivp(
                lambda t, y: self.f(t, y[:3]),
                (0, 5),
                [*self.y0, 1.0],
                frame=_Measured(matrices),
                **options,
            )
            assert (here.steps, here.nrejected) == (there.steps, there.nrejected)
            # the estimates of tiny first steps are rounding
            np.testing.assert_allclose(here.y, there.y[:, :3], rtol=0, atol=1e-6)


class _Measured(MatrixFrame):
    """Translations, with the coordinates of Euclidean space."""

    def exp_coordinates(self, y0, y1):
        return np.asarray(y1)[..., :3] - np.asarray(y0)[..., :3]

    def coordinate_sizes(self, y):
        return np.abs(np.asarray(y)[..., :3])


@pytest.mark.parametrize("key", ["RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)"])
@pytest.mark.parametrize(
    "frame",
    [SO3(), SE3("space"), UnitQuaternion(), SU(3), Sphere(2), Sphere(3), Stiefel(4, 2)],
    ids=name,
)
def test_errors_follow_tolerances(frame, key):
    f, y0 = generic(frame)
    fine = cg.integrate(f, (0, 2), y0, frame=frame, method="RKMK8(5,3)", h=0.02).y[-1]
    for tolerance in (1e-4, 1e-7):
        run = cg.solve_ivp(f, (0, 2), y0, frame=frame, method=key, rtol=tolerance, atol=tolerance)
        assert run.success
        assert 1e-5 * tolerance < frame.distance(run.y[-1], fine) < 20 * tolerance


def test_turns_about_the_point_of_a_sphere_are_no_error():
    f, y0 = generic(Sphere(2))

    def spun(t, y):
        return f(t, y) + 3.0 * np.sin(9.0 * t) * y

    steps = [
        cg.solve_ivp(g, (0, 2), y0, frame=Sphere(2), method="RKMK5(4)", rtol=1e-7, atol=1e-7).steps
        for g in (f, spun)
    ]
    assert steps[1] < 2.5 * steps[0]


def test_a_constant_field_is_solved_exactly():
    v = np.array([0.0, 0.0, 50.0])
    run = cg.solve_ivp(
        lambda t, y: v, (0, 1), np.eye(3), frame=SO3(), method="RKMK5(4)", h=1.0, dense_output=True
    )
    t = np.linspace(0, 1, 40)
    exact = SO3().flow(np.multiply.outer(t, v), np.eye(3))
    np.testing.assert_allclose(run.sol(t), exact, rtol=0, atol=1e-13)


ALL = [SO3(), Product(UnitQuaternion(), Euclidean(2)), SO(4), CoadjointOrbit(SE3(), range(6))]


class TestOutput:
    @pytest.mark.parametrize("frame", ALL, ids=name)
    @pytest.mark.parametrize("key", ["RKMK4", "RKMK5(4)", "RKMK8(5,3)"])
    def test_between_steps_it_is_as_accurate_as_at_the_steps(self, frame, key):
        f, y0 = generic(frame, seed=5)
        choice = {"h": 0.1} if key == "RKMK4" else {"rtol": 1e-8, "atol": 1e-8}
        run = cg.solve_ivp(f, (0, 1), y0, frame=frame, method=key, dense_output=True, **choice)
        at = np.linspace(0, 1, 5)
        t = run.t[:-1, None] + np.diff(run.t)[:, None] * at
        t[:, -1] = run.t[1:]
        times = np.unique(t)
        options = {"frame": frame, "method": "RKMK8(5,3)", "rtol": 1e-12, "atol": 1e-13}
        fine = cg.solve_ivp(f, (0, 1), y0, t_eval=times, max_step=0.1, **options).y
        errors = frame.distance(run.sol(times), fine)[np.searchsorted(times, t)]
        ends = np.maximum(np.maximum(errors[:, 0], errors[:, -1]), 1e-13)
        worst = (errors[:, 1:-1].max(axis=1) / ends).max()
        assert worst < 3.0

    @pytest.mark.parametrize("frame", ALL, ids=name)
    def test_t_eval_and_dense_output_agree(self, frame):
        f, y0 = generic(frame)
        t = np.linspace(0, 2, 9)
        options = {"frame": frame, "method": "RKMK5(4)", "rtol": 1e-6, "atol": 1e-6}
        dense = cg.solve_ivp(f, (0, 2), y0, dense_output=True, **options)
        some = cg.solve_ivp(f, (0, 2), y0, t_eval=t, **options)
        np.testing.assert_allclose(some.y, dense.sol(t), rtol=0, atol=1e-13)
        np.testing.assert_array_equal(dense.sol(dense.t), dense.y)
        again = pickle.loads(pickle.dumps(dense.sol))
        np.testing.assert_array_equal(again(t), dense.sol(t))
        assert frame.membership_error(some.y).max() < 1e-12

    @pytest.mark.parametrize("key", ["RKMK5(4)", "RKMK8(5,3)"])
    def test_events(self, key):
        run = cg.solve_ivp(
            lambda t, y: [0.0, 0.0, t],
            (0, 10),
            np.eye(3),
            frame=SO3(),
            method=key,
            rtol=1e-9,
            atol=1e-9,
            max_step=0.5,
            events=_turned,
        )
        np.testing.assert_allclose(run.t_events[0], [np.sqrt(4 * np.pi)], rtol=0, atol=1e-8)
        assert run.status == 1

    def test_backward(self):
        f, y0 = generic(SO3())
        there = cg.solve_ivp(f, (0, 1), y0, frame=SO3(), method="RKMK5(4)", rtol=1e-10, atol=1e-10)
        back = cg.solve_ivp(
            f, (1, 0), there.y[-1], frame=SO3(), method="RKMK5(4)", rtol=1e-10, atol=1e-10
        )
        np.testing.assert_allclose(back.y[-1], y0, rtol=0, atol=1e-8)


def _turned(t, y):
    return y[1, 0]


_turned.terminal, _turned.direction = True, 1


@pytest.mark.parametrize("frame", [SO3(), SE3(), SO(4), Sphere(2)], ids=name)
def test_members_of_ensembles(frame):
    f, _ = generic(frame)
    points = frame.random_point(np.random.default_rng(0), 4)
    fixed = {"frame": frame, "method": "RKMK5(4)", "h": 0.125}
    whole = cg.integrate(f, (0, 1), points, **fixed)
    for i, point in enumerate(points):
        alone = cg.integrate(f, (0, 1), point, **fixed)
        np.testing.assert_allclose(whole.y[:, i], alone.y, rtol=0, atol=1e-13)
    for key in ("RKMK5(4)", "RKMK8(5,3)"):
        options = {"frame": frame, "method": key, "rtol": 1e-6, "atol": 1e-6, "dense_output": True}
        together = cg.solve_ivp(f, (0, 1), points, **options)
        assert together.success
        steps = [cg.solve_ivp(f, (0, 1), point, **options).steps for point in points]
        assert max(steps) <= together.steps <= 2 * max(steps)


class TestBadInput:
    @pytest.mark.parametrize(
        ("frame", "reason"),
        [
            (HEISENBERG, "give it one"),
            (Product(SO3(), HEISENBERG), "give it one"),
            (MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]]]), "commutators"),
        ],
        ids=["functions", "product", "matrices"],
    )
    def test_frames_without_brackets(self, frame, reason):
        y0 = frame.random_point(np.random.default_rng(0))
        for call in (cg.solve_ivp, cg.integrate):
            with pytest.raises(ValueError, match=rf"method must be .*RKMK4.*brackets: .*{reason}"):
                call(
                    lambda t, y: np.ones(frame.dim), (0, 1), y0, frame=frame, method="RKMK4", h=0.1
                )

    def test_steps_of_no_pair(self):
        with pytest.raises(ValueError, match="method must be a pair unless h"):
            cg.solve_ivp(*generic_problem(), frame=SO3(), method="RKMK4")

    def test_overflow(self):
        frame = Euclidean(1)
        with np.errstate(over="ignore"):
            with pytest.raises(OverflowError, match="no longer finite"):
                cg.integrate(
                    lambda t, y: 10.0 * np.minimum(y, 1e307),
                    (0, 900),
                    [3.0],
                    frame=frame,
                    method="RKMK4",
                    h=0.5,
                )
            run = cg.solve_ivp(
                lambda t, y: y**2, (0, 9), [3.0], frame=frame, method="RKMK5(4)", max_steps=2000
            )
        assert not run.success

    def test_an_error_of_f(self):
        def f(t, y):
            raise KeyError("mine")

        for frame in (SO3(), SO(4)):
            with pytest.raises(KeyError, match="mine"):
                cg.solve_ivp(f, (0, 1), np.eye(frame.n), frame=frame, method="RKMK5(4)")


def generic_problem():
    f, y0 = generic(SO3())
    return f, (0, 1), y0


def test_a_frame_of_functions_with_a_bracket():
    f, y0 = generic(HEISENBERG_GROUP)
    run = cg.solve_ivp(
        f, (0, 1), y0, frame=HEISENBERG_GROUP, method="RKMK5(4)", rtol=1e-8, atol=1e-8
    )
    exact = cg.integrate(f, (0, 1), y0, frame=HEISENBERG_GROUP, method="CF5a", h=0.01).y[-1]
    assert run.success
    np.testing.assert_allclose(run.y[-1], exact, rtol=0, atol=1e-7)


def test_third_weights_make_the_estimate_smaller():
    third = cg.Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0])
    method = cg.MuntheKaas(third, third=[0, 0])
    assert (method.third_order, error_exponent(method)) == (0, 1 / 3)
    f, y0 = generic(SO3())
    norm = ErrorNorm(SO3(), y0, 1e-3, np.array(1e-3))
    first, second = (
        Step(f, SO3(), m).trial(0.0, y0, 0.1, norm)[1] for m in (cg.MuntheKaas(third), method)
    )
    assert second < first


@pytest.mark.parametrize("key", ["RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)"])
@pytest.mark.parametrize("entry", ["product", "SE3 body", "sphere", "SU2 body"])
def test_a_function_in_c_takes_the_steps_of_the_loop_in_python(entry, key, affine):
    problem = PROBLEMS[entry]
    f, _keep = affine(problem)
    options = {"frame": problem.frame, "method": key, "rtol": 1e-6, "atol": 1e-6}
    fast = cg.solve_ivp(f, (0.2, 2.0), problem.y0, dense_output=True, **options)
    with patch.object(Problem, "in_compiled_code", property(lambda self: False)):
        slow = cg.solve_ivp(f, (0.2, 2.0), problem.y0, dense_output=True, **options)
    assert (fast.steps, fast.nrejected) == (slow.steps, slow.nrejected)
    assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)
    # the estimate of a tiny first step is not far from rounding
    np.testing.assert_allclose(fast.t, slow.t, rtol=1e-6)
    t = np.linspace(0.2, 2.0, 7)
    np.testing.assert_allclose(fast.sol(t), slow.sol(t), rtol=0, atol=1e-9)


def test_members_of_a_function_in_c_take_steps_of_their_own(affine):
    problem = PROBLEMS["SE3 body"]
    f, _keep = affine(problem)
    points = problem.frame.random_point(np.random.default_rng(2), 5)
    options = {"frame": problem.frame, "method": "RKMK8(5,3)", "rtol": 1e-8, "atol": 1e-8}
    whole = cg.solve_ivp(f, (0, 1), points, t_eval=[0.5, 1.0], **options)
    for i, point in enumerate(points):
        alone = cg.solve_ivp(f, (0, 1), point, t_eval=[0.5, 1.0], **options)
        np.testing.assert_array_equal(whole.y[:, i], alone.y)
    fixed = {"frame": problem.frame, "method": "RKMK5(4)", "h": 0.01}
    runs = [cg.integrate(f, (0, 1), points, workers=w, **fixed).y for w in (1, 2)]
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("frame", [SO3(), SO(4)], ids=name)
def test_rows_that_repeat_or_are_zero(frame):
    """A stage at the initial point, two at one point, and one at the result that isn't the last."""
    rows = [[], [0], ["1/2", 0], ["1/2", 0, 0], ["1/4", 0, 0, "3/4"], [0, 0, 0, 1, 0]]
    weights = ["1/12", "1/12", "1/3", "1/3", 0, "1/6"]
    method = cg.MuntheKaas(cg.Tableau(rows, weights))
    # the same points, once each
    plain = cg.MuntheKaas(
        cg.Tableau(
            [[], ["1/2"], ["1/4", "3/4"], [0, 1, 0]],
            ["1/6", "2/3", 0, "1/6"],
        )
    )
    f, y0 = generic(frame)
    options = {"frame": frame, "h": 0.1, "dense_output": True}
    one, other = (cg.solve_ivp(f, (0, 1), y0, method=m, **options) for m in (method, plain))
    np.testing.assert_allclose(one.y, other.y, rtol=0, atol=1e-14)
    t = np.linspace(0, 1, 23)
    np.testing.assert_allclose(one.sol(t), other.sol(t), rtol=0, atol=1e-13)


def test_a_function_may_write_into_its_point():
    def spoil(t, y, f, data):
        for i in range(3):
            f[i] = 0.3 * (i + 1) + y[i]
        for i in range(9):
            y[i] = 7.0
        return 0

    def keep(t, y):
        return 0.3 * np.arange(1.0, 4.0) + y.ravel()[:3]

    doubles = ctypes.POINTER(ctypes.c_double)
    pointer = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, doubles, doubles, ctypes.c_void_p)
    for key in METHODS:
        options = {"frame": SO3(), "method": key, "h": 0.25}
        runs = [cg.integrate(g, (0, 1), np.eye(3), **options).y for g in (pointer(spoil), keep)]
        np.testing.assert_allclose(*runs, rtol=0, atol=1e-14)


GROUPS = [SO(2), SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(1), U(2), Power(SU(3), 2)]


@pytest.mark.parametrize("frame", GROUPS, ids=name)
@pytest.mark.parametrize("key", [*METHODS, "CF4(3)", "CG4a"])
def test_groups_of_matrices_in_compiled_code(frame, key):
    f, y0 = generic(frame)
    method = resolve_method(key)
    fixed = {"frame": frame, "method": key, "h": 0.125}
    tight = {"frame": frame, "method": key, "rtol": 1e-6, "atol": 1e-6}

    def both():
        yield cg.integrate(f, (0, 1), y0, **fixed)
        if method.embedded_order:
            yield cg.solve_ivp(f, (0, 1), y0, dense_output=True, **tight)

    fast = list(both())
    with (
        patch.object(Problem, "in_compiled_code", property(lambda self: False)),
        patch("cg.integration.step.flows_of", _Flows),
        patch("cg.integration.step.dexpinv_of", _Dexpinv),
    ):
        slow = list(both())
    np.testing.assert_allclose(fast[0].y, slow[0].y, rtol=0, atol=1e-13)
    assert frame.membership_error(fast[0].y).max() < 2e-15
    if method.embedded_order:
        assert (fast[1].steps, fast[1].nfev) == (slow[1].steps, slow[1].nfev)
        np.testing.assert_allclose(fast[1].y, slow[1].y, rtol=0, atol=1e-6)
        t = np.linspace(0, 1, 5)
        np.testing.assert_allclose(fast[1].sol(t), slow[1].sol(t), rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("frame", GROUPS, ids=name)
def test_the_series_in_compiled_code(frame, order):
    u, v = np.random.default_rng(0).standard_normal((2, 3, frame.dim))
    expected = frame.dexpinv(u, v, order=order)
    found = dexpinv_of(frame, order)(u, v)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("key", ORDERS)
def test_slopes_on_matrices_in_quadruple_precision(key):
    method, order = ORDERS[key]
    problem = AffineField(SO(4, "space"), np.eye(4), seed=3)
    counts = [8, 16, 32] if order > 5 else [64, 128]
    ends = []
    for n in counts:
        run = integrate_affine(problem, method=method, h=f"1/{n}", steps=n, kind="real128")
        ends.append(np.array(run.exact(-1)))
    fine = integrate_affine(problem, method="RKMK8(5,3)", h="1/200", steps=200, kind="real128")
    exact = np.array(fine.exact(-1))
    errors = [float(np.abs(end - exact).max()) for end in ends]
    slope = observed_order(1 / np.array(counts), errors, floor=1e-27)
    assert slope.order == pytest.approx(order, abs=0.3)
