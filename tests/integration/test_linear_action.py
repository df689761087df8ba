"""Linear equations on vectors with sparse generators: `LinearAction`, and its polynomial flows."""

import pickle

import numpy as np
import pytest
from kinds import MAGNUS
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import cg
from cg.frames import LinearAction, check


class TestLinearAction:
    RNG = np.random.default_rng(5)
    DENSE = RNG.standard_normal((3, 6, 6)) * (RNG.uniform(size=(3, 6, 6)) < 0.4)

    @pytest.mark.parametrize("factor", [1.0, 1j, 0.6 + 0.8j])
    @pytest.mark.parametrize("skew", [False, True])
    @pytest.mark.parametrize("scale", [1e-9, 0.1, 3.0, 40.0])
    def test_flows_of_all_kinds_of_entries(self, factor, skew, scale):
        generators = factor * self.DENSE
        if skew:
            generators = generators - generators.conj().mT
        frame = LinearAction([sparse.csr_array(g) for g in generators])
        assert frame == LinearAction(list(generators))
        v, y = scale * self.RNG.standard_normal(3), self.RNG.standard_normal(6)
        matrix = np.tensordot(v, generators, 1)
        exact, rounding = expm(matrix) @ y, 1e-14 * max(scale, 1)
        np.testing.assert_allclose(frame.field(v, y), matrix @ y, rtol=0, atol=rounding)
        np.testing.assert_allclose(
            frame.flow(v, y), exact, rtol=0, atol=1e-13 * max(scale, 1) * np.abs(exact).max()
        )
        run = cg.solve_linear(lambda t: v, (0, 1), y, frame=frame, h=0.25)
        np.testing.assert_allclose(
            run.y[-1], exact, rtol=0, atol=2e-13 * max(scale, 1) * np.abs(exact).max()
        )

    @pytest.mark.parametrize("factor", [1.0, 1j, 0.6 + 0.8j])
    @pytest.mark.parametrize("skew", [False, True])
    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_all_entries_are_nan_if_a_coefficient_is(self, factor, skew, bad):
        """Also where the generator has no entry in some row, or none at all."""
        generators = factor * np.stack([np.diag([0.0, 1.0, 0.0], 1), np.diag([0.0, 0.0, 0.0, 2.0])])
        if skew:
            generators = generators - generators.conj().mT
        frame = LinearAction([*generators, 0.0 * generators[0]])
        v = np.array([[bad, 0.3, 0.2], [0.1, bad, 0.2], [0.1, 0.3, bad], [0.1, 0.3, 0.2]])
        moved = frame.flow(v, np.ones(4))
        assert np.isnan(moved[:3]).all()
        assert np.isfinite(moved[3]).all()
        overflowing = LinearAction([np.diag([1e300, 1.0]), np.diag([-1e300, 1.0])])
        with pytest.raises(cg.frames.FlowOverflowError, match=r"\|v\| = 1e\+20"):
            overflowing.flow([1e20, 1e20], np.ones(2))

    @pytest.mark.parametrize("factor", [1.0, 1j, 0.6 + 0.8j])
    @pytest.mark.parametrize("columns", [1, 4])
    def test_columns_move_like_vectors(self, factor, columns):
        generators = list(factor * self.DENSE)
        vectors, frame = LinearAction(generators), LinearAction(generators, columns=columns)
        assert frame != vectors
        assert frame.point_shape == (6, columns)
        assert f"columns={columns}" in repr(frame)
        assert pickle.loads(pickle.dumps(frame)) == frame
        v, y = self.RNG.standard_normal((2, 3)), self.RNG.standard_normal((2, 6, columns))
        for name in ("flow", "field"):
            moved = getattr(frame, name)(v, y)
            expected = getattr(vectors, name)(v[:, None], y.mT).mT
            np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
        run, single = (
            cg.solve_linear(
                lambda t: [1.0, np.cos(t), t], (0, 1), start, frame=f, rtol=1e-11, atol=1e-11,
                dense_output=True,
            )
            for f, start in ((frame, y[0]), (vectors, y[0, :, -1]))
        )  # fmt: skip
        np.testing.assert_allclose(run.y[-1][:, -1], single.y[-1], rtol=0, atol=3e-11)
        np.testing.assert_allclose(run.sol(0.3)[:, -1], single.sol(0.3), rtol=0, atol=3e-13)
        with pytest.raises(ValueError, match="columns must be at least 1, got 0"):
            LinearAction(generators, columns=0)

    def test_unitary_flows(self):
        hamiltonian = self.DENSE[0] + self.DENSE[0].T
        rounded = 0.1 * (hamiltonian / 0.1) + 1e-15 * np.triu(hamiltonian)
        exact, frame = (LinearAction([-1j * h], unitary=True) for h in (hamiltonian, rounded))
        assert (exact.is_skew, frame.is_skew) == (True, True)
        assert exact == LinearAction([-1j * hamiltonian])
        message = r"generators\[1\] must be skew-Hermitian if unitary is True"
        for wrong in (hamiltonian, -1j * np.triu(hamiltonian), np.triu(hamiltonian)):
            with pytest.raises(ValueError, match=message):
                LinearAction([-1j * hamiltonian, wrong], unitary=True)

    def test_it_passes_the_checks_of_frames(self):
        check(LinearAction([sparse.csr_array(g) for g in self.DENSE]))
        check(LinearAction([1j * (g + g.T) for g in self.DENSE]))

    def test_frames_are_compared_by_value(self):
        first, second = (LinearAction(list(self.DENSE)) for _ in range(2))
        assert first == second
        assert hash(first) == hash(second)
        distinct = [LinearAction([k * first._matrix(v) for v in np.eye(3)]) for k in range(1, 9)]
        zeros = [LinearAction([np.zeros((n, n), kind)] * m)
                 for n in (1, 2) for m in (1, 3) for kind in (float, complex)]  # fmt: skip
        for frames in (distinct, zeros):
            assert len(set(frames)) == len({hash(frame) for frame in frames}) == len(frames)
        assert first != LinearAction(list(self.DENSE[:2]))


class TestPolynomialFlows:
    """One flow per step of `LinearAction`, along the polynomial that interpolates a."""

    RNG = np.random.default_rng(11)
    DENSE = RNG.standard_normal((2, 5, 5))

    @staticmethod
    def a(t):
        return [np.cos(2 * t), np.exp(np.sin(3 * t))]

    def exact(self, generators, y0, end):
        solution = solve_ivp(
            lambda t, y: np.tensordot(self.a(t), generators, 1) @ y, (0, end), y0, method="DOP853",
            rtol=1e-13, atol=1e-13,
        )  # fmt: skip
        return solution.y[:, -1]

    @pytest.mark.parametrize("name", list(MAGNUS))
    def test_orders(self, name):
        generators = 0.5 * self.DENSE
        y0 = np.ones(5)
        exact = self.exact(generators, y0, 2.0)
        order = {"CFM6(4)b": 8}.get(name, cg.methods[name].order)
        errors = []
        for n in {4: (40, 80), 6: (20, 40), 8: (10, 20)}[order]:
            run = cg.solve_linear(
                self.a, (0, 2), y0, frame=LinearAction(generators), method=name, h=2 / n
            )
            errors.append(np.abs(run.y[-1] - exact).max())
            assert run.nexp == n
        assert order - 0.5 < np.log2(errors[0] / errors[1]) < order + 1

    def test_the_default_has_order_sixteen(self):
        generators = 0.5 * self.DENSE
        exact = self.exact(generators, np.ones(5), 2.0)
        frame, errors = LinearAction(generators), []
        for n in (2, 4):
            run = cg.solve_linear(self.a, (0, 2), np.ones(5), frame=frame, h=2 / n)
            errors.append(np.abs(run.y[-1] - exact).max())
            assert (run.nfev, run.nexp) == (8 * n + 1, n)
        assert errors[0] < 1e-4
        assert np.log2(errors[0] / errors[1]) > 13

    @pytest.mark.parametrize("phase", [0.0, 0.5, 1.0, 1.5])
    @pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
    def test_errors_are_below_the_tolerances(self, phase, tolerance):
        # coefficients of Legendre's polynomials of one parity vanish at some phases
        a = lambda t: [1.0, np.cos(3 * t + phase)]
        frame, y0 = LinearAction(self.DENSE - self.DENSE.mT), np.eye(5)[0]
        exact = cg.solve_linear(a, (0, 5), y0, frame=frame, h=0.05).y[-1]
        run = cg.solve_linear(a, (0, 5), y0, frame=frame, rtol=tolerance, atol=tolerance)
        assert 1e-3 * tolerance < np.abs(run.y[-1] - exact).max() < tolerance

    @pytest.mark.parametrize("tolerance", [1e-3, 1e-9])
    def test_norms_and_traces_are_kept_to_rounding(self, tolerance):
        frame = LinearAction([1j * (g + g.T) for g in self.DENSE])
        run = cg.solve_linear(
            self.a, (0, 5), np.eye(5)[0], frame=frame, rtol=tolerance, atol=tolerance
        )
        np.testing.assert_allclose(np.linalg.norm(run.y, axis=1), 1.0, rtol=0, atol=1e-14)
        stochastic = [g - np.diag(g.sum(axis=0)) for g in abs(self.DENSE)]
        frame = LinearAction(stochastic)
        run = cg.solve_linear(
            self.a, (0, 5), np.eye(5)[0], frame=frame, rtol=tolerance, atol=tolerance
        )
        np.testing.assert_allclose(run.y.sum(axis=1), 1.0, rtol=0, atol=3e-14)

    @pytest.mark.parametrize("factor", [1.0, 1j, 0.6 + 0.8j])
    @pytest.mark.parametrize("skew", [False, True])
    @pytest.mark.parametrize("scale", [1e-9, 0.3, 5.0])
    def test_polynomials_are_solved_exactly_in_one_step(self, factor, skew, scale):
        generators = factor * self.DENSE
        if skew:
            generators = generators - generators.conj().mT
        y0 = self.RNG.standard_normal(5).astype(generators.dtype)

        a = lambda t: [scale * (1 - 3 * t + t**4), scale * (t - 0.5) ** 3]

        def solve(n):
            frame = LinearAction(list(generators))
            return cg.solve_linear(a, (0, 1), y0, frame=frame, method="CFM8(4)", h=1 / n).y[-1]

        whole = solve(1)
        np.testing.assert_allclose(whole, solve(3), rtol=0, atol=1e-12 * np.abs(whole).max())
        matrices = cg.frames.MatrixFrame(list(generators))
        product = cg.solve_linear(a, (0, 1), y0, frame=matrices, method="CFM8(4)", h=0.01).y[-1]
        np.testing.assert_allclose(whole, product, rtol=0, atol=1e-13 * np.abs(whole).max())

    def test_a_step_beyond_double_precision_ends_the_integration(self):
        frame = LinearAction([np.diag([-1.0, -2.0])])
        with pytest.raises(OverflowError, match="no longer finite"):
            cg.solve_linear(lambda t: [1e12], (0, 1), [1.0, 1.0], frame=frame, method="CFM4", h=0.5)

    @pytest.mark.parametrize("nodes", [["1/2"], ["0", "1"], ["1/2", "1/2", "1"]])
    def test_too_few_nodes_take_the_flows_of_the_method(self, nodes):
        weights = [[*[0] * (len(nodes) - 1), part] for part in ("3/4", "1/4")]
        method = cg.MagnusMethod(nodes, weights)
        frame = LinearAction(self.DENSE)
        run = cg.solve_linear(self.a, (0, 1), np.ones(5), frame=frame, method=method, h=0.5)
        assert run.nexp == 4
        same = cg.solve_linear(
            self.a, (0, 1), np.ones(5), frame=cg.frames.MatrixFrame(list(self.DENSE)),
            method=method, h=0.5,
        )  # fmt: skip
        np.testing.assert_allclose(run.y, same.y, rtol=1e-12)


@pytest.mark.parametrize("h", [None, 1.0])
def test_output_just_before_the_end_of_a_step(h):
    """The part of the step there rounds to one."""
    line, last = LinearAction([np.array([[0.0, 1.0], [-1.0, 0.0]])]), np.nextafter(0.1, 0.0)
    options = {"h": h} if h else {"first_step": 1.0, "rtol": 1e-13, "atol": 1e-13}
    for t in ([last], [-0.5, last, 0.1], [-0.5, last]):
        run = cg.solve_linear(lambda t: [1.0], (-0.9, 0.1), [1, 0], frame=line, t_eval=t, **options)
        angle = 0.9 + np.array(t)
        expected = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        np.testing.assert_allclose(run.y, expected, rtol=0, atol=1e-13)


def test_weights_of_a_pair_have_no_effect_and_no_warning():
    """The error is estimated along a polynomial through the nodes, whatever its results are."""
    method = cg.MagnusMethod(
        ["0", "1/2", "1"], [["1/6", "2/3", "1/6"]], embedded=[["1/2", 0, "1/2"]]
    )
    frame = LinearAction([-1j * np.array([[0, 1], [1, 0]])])
    run = cg.solve_linear(lambda t: [np.cos(t)], (0, 1), [1.0, 0j], frame=frame, method=method)
    np.testing.assert_allclose(run.y[-1, 0], np.cos(np.sin(1.0)), rtol=0, atol=1e-3)


Y0 = np.array([0.6, 0.8, 0.0], complex)
TURNS = 2e4


def frame(damping, **kinds):
    diagonal = np.array([1.0, 0.0, 1.0])
    return LinearAction([np.diag(-(1j + damping) * diagonal)], **kinds)


def amplitude_error(y, damping=0.0, turns=TURNS):
    return np.abs(y - np.exp(-(1j + damping) * turns * np.array([1.0, 0.0, 1.0])) * Y0).max()


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("damping", [0.0, 1e-5])
@pytest.mark.parametrize("method", ["auto", *MAGNUS])
def test_every_method_and_tolerance(method, damping, tolerance):
    run = cg.solve_linear(
        lambda t: [TURNS], (0, 1), Y0, frame=frame(damping), method=method,
        rtol=tolerance, atol=tolerance,
    )  # fmt: skip
    assert run.steps < 50
    assert amplitude_error(run.y[-1], damping) < tolerance


@pytest.mark.parametrize("turns", [3e5, 3e6])
def test_errors_do_not_grow_with_the_time(turns):
    run = cg.solve_linear(lambda t: [1.0], (turns, 0), Y0, frame=frame(0.0))
    assert amplitude_error(run.y[-1], turns=-turns) < 1e-3


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_gradients(tolerance):
    run = cg.solve_linear(
        lambda t: [1.0], (0, 5e3), Y0, frame=frame(0.0), rtol=tolerance,
        atol=tolerance, derivatives="adjoint",
    )  # fmt: skip
    gradient = run.gradient(2 * run.y[-1] * [1, 0, 0])
    np.testing.assert_allclose(gradient.y0, [1.2, 0, 0], rtol=0, atol=tolerance)


@pytest.mark.parametrize("end", [1000.0, -1000.0])
def test_all_events_of_long_steps_are_found(end):
    frame = LinearAction([np.array([[0.0, -1.0], [1.0, 0.0]])])
    options = {"frame": frame, "events": lambda t, y: y[0], "rtol": 1e-8, "atol": 1e-8}
    for solution in (
        cg.solve_linear(lambda t: [1.0], (0, end), [1.0, 0.0], **options),
        cg.solve_ivp(lambda t, y: [1.0], (0, end), [1.0, 0.0], **options),
    ):
        assert solution.steps < 20
        times = np.sign(end) * np.pi * (np.arange(318) + 0.5)
        np.testing.assert_allclose(solution.t_events[0], times, rtol=0, atol=1e-8)
