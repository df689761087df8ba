"""QuTiP's solvers with ``method="cg"``."""

import numpy as np
import pytest
from refusals import refuses

qutip = pytest.importorskip("qutip", minversion="5.0")

import cg  # noqa: E402
import cg.qutip  # noqa: E402

TIMES = np.linspace(0, 5, 11)
TIGHT = {"rtol": 1e-10, "atol": 1e-10, "progress_bar": "", "nsteps": 100_000}
X, Z, UP, DOWN = qutip.sigmax(), qutip.sigmaz(), qutip.sigmap(), qutip.sigmam()


def cosine(t, w):
    return np.cos(w * t)


def turning(t, w):
    return np.exp(1j * w * t)


def turning_back(t, w):
    return np.exp(-1j * w * t)


SYSTEMS = {
    "constant": Z + 0.3 * X,
    "driven": qutip.QobjEvo([Z, [X, cosine]], args={"w": 2.0}),
    "rotating": qutip.QobjEvo([Z, [UP, turning], [DOWN, turning_back]], args={"w": 2.0}),
    "array": qutip.QobjEvo([Z, [X, np.sin(TIMES)]], tlist=TIMES),
    "damped": qutip.QobjEvo([Z - 0.1j * DOWN * UP, [UP, turning]], args={"w": 1.0}),
}


def solve(solver, system, state, method, *rest):
    options = {**TIGHT, "method": method, "normalize_output": False, "store_states": True}
    return solver(system, state, TIMES, *rest, options=options).states


@pytest.mark.parametrize("state", [qutip.basis(2, 0), qutip.qeye(2)], ids=["ket", "propagator"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_schroedinger_equations_agree(name, state):
    ours, theirs = (solve(qutip.sesolve, SYSTEMS[name], state, m) for m in ("cg", "vern9"))
    assert max((a - b).norm() for a, b in zip(ours, theirs, strict=True)) < 1e-7


@pytest.mark.parametrize("name", ["constant", "driven", "rotating", "array"])
def test_lindblad_equations_agree(name):
    rest = [np.sqrt(0.2) * DOWN, qutip.QobjEvo([Z, lambda t: 0.1 * np.exp(-t)])]
    state = qutip.basis(2, 0)
    ours, theirs = (solve(qutip.mesolve, SYSTEMS[name], state, m, rest) for m in ("cg", "vern9"))
    assert max((a - b).norm() for a, b in zip(ours, theirs, strict=True)) < 1e-8


@pytest.mark.parametrize("name", ["driven", "rotating"])
def test_unitary_evolution_keeps_the_norm(name):
    states = solve(qutip.sesolve, SYSTEMS[name], qutip.basis(2, 0), "cg")
    assert max(abs(state.norm() - 1) for state in states) < 1e-14


def test_steps_arguments_and_breakpoints():
    system = qutip.QobjEvo([Z, [X, lambda t, w: float(t > w)]], args={"w": 0.5})
    options = {**TIGHT, "method": "cg", "breakpoints": [0.5]}
    solver = qutip.SESolver(system, options=options)
    solver.start(qutip.basis(2, 0), 0.0)
    solver.step(0.4)
    state = solver.step(1.0)
    first, second = (-0.5j * Z).expm(), (-0.5j * (Z + X)).expm()
    assert (state - second * first * qutip.basis(2, 0)).norm() < 1e-11
    solver.start(qutip.basis(2, 0), 0.0)
    state = solver.step(0.5, args={"w": -1.0})
    assert (state - second * qutip.basis(2, 0)).norm() < 4e-11


@pytest.mark.parametrize("order", [0, 1, 3])
def test_no_step_passes_over_a_pulse_in_an_array(order):
    times = np.arange(0.0, 20001.0)
    x = (times - 13000) / 200
    pulse = np.where(abs(x - 0.5) < 0.5, (1 - np.cos(2 * np.pi * x)) / 200, 0.0)
    array = qutip.coefficient(pulse, tlist=times, order=order)
    constant = qutip.coefficient(lambda t: 1.0)
    for coefficient in (array, array * constant, array + array.conj() * constant):
        angle = abs(coefficient(13100) / array(13100))  # the integral of the pulse is one
        run = qutip.sesolve(
            qutip.QobjEvo([[X / 2, coefficient]]), qutip.basis(2, 0), [0, 20000], e_ops=[Z],
            options={"method": "cg", "rtol": 1e-4, "atol": 1e-4, "progress_bar": ""},
        )  # fmt: skip
        assert abs(run.expect[0][-1] - np.cos(angle)) < 3e-6


@pytest.mark.parametrize(("end", "width"), [(40.0, 0.1), (100.0, 0.1), (100.0, 0.3)])
def test_no_step_passes_over_a_pulse_that_output_times_resolve(end, width):
    pulse = qutip.coefficient(lambda t: np.exp(-(((t - 0.53 * end) / width) ** 2)) / width)
    runs = [
        qutip.sesolve(
            qutip.QobjEvo([Z, [X, pulse]]), qutip.basis(2, 0), np.linspace(0, end, 401), e_ops=[Z],
            options={"method": method, "rtol": 1e-8, "atol": 1e-8, "progress_bar": ""},
        ).expect[0]
        for method in ("cg", "vern9")
    ]  # fmt: skip
    assert abs(runs[0][-1]) < 0.9
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-7)


def test_output_times_may_be_equal():
    system, start = qutip.QobjEvo([Z, [X, cosine]], args={"w": 2.0}), qutip.basis(2, 0)
    options = {"method": "cg", "progress_bar": ""}
    once = qutip.sesolve(system, start, [0, 1, 2], options=options).states
    again = qutip.sesolve(system, start, [0, 0, 1, 1, 1, 2], options=options).states
    for k, state in enumerate(again):
        np.testing.assert_array_equal(state.full(), once[[0, 0, 1, 1, 1, 2][k]].full())
    still = qutip.sesolve(system, start, [0, 0], options=options).states
    np.testing.assert_array_equal(still[1].full(), start.full())
    with pytest.raises(ValueError, match="tlist must be sorted, got"):
        qutip.sesolve(system, start, [0, 2, 1], options=options)


def test_refuses_other_systems():
    feedback = qutip.QobjEvo([X, cosine], args={"w": qutip.SESolver.ExpectFeedback(Z)})
    function = qutip.QobjEvo(lambda t: t * X)
    for system, message in ((function, "function"), (feedback, "on the state")):
        with pytest.raises(TypeError, match=message):
            qutip.sesolve(system, qutip.basis(2, 0), TIMES, options={**TIGHT, "method": "cg"})


@pytest.mark.parametrize("make", [cg.frames.LinearAction, cg.frames.MatrixFrame])
def test_frames_take_operators_as_generators(make):
    operators = [-1j * X, -1j * Z]
    assert make(operators) == make([operator.full() for operator in operators])


def test_failures_are_those_of_qutip():
    def solve(**changed):
        options = {**TIGHT, "method": "cg", **changed}
        return qutip.sesolve(SYSTEMS["driven"], qutip.basis(2, 0), TIMES, options=options)

    refuses(qutip.solver.integrator.IntegratorException, "1 steps .nsteps.", solve, nsteps=1)
    refuses(ValueError, "^nsteps must be", solve, nsteps=0)
    refuses(ValueError, "^breakpoints must be finite", solve, breakpoints=[1.0, np.nan])
    refuses(ValueError, "^breakpoints must be", solve, breakpoints="a")
    assert (solve(first_step=1e3).states[-1] - solve().states[-1]).norm() < 1e-8
