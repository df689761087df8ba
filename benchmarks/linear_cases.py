"""Linear equations y' = A(t) y, for this package, QuTiP and SciPy."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.integrate import solve_ivp

import cg
from cg.frames import SU, Frame, LinearAction, UnitQuaternion

from .cases import Case
from .solvers import Run

Matrix = Any
Solve = Callable[[float], Run]
TimeFunction = Callable[[float], list[float]]

_X, _Y, _Z = (
    np.array(m, dtype=complex) for m in ([[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]])
)
_LOWER = np.array([[0, 1], [0, 0]], dtype=complex)
_SITES = 10
_DAMPING = 0.1


@dataclass(frozen=True)
class LinearCase:
    """A problem with the data that other packages need.

    Attributes
    ----------
    case : Case
    a : callable
        ``a(t)`` returns the coefficients.
    matrices : tuple of matrices
        Those that the coefficients multiply; points are their columns, or one column.
    hamiltonians : tuple of matrices or None
        Hermitian matrices with the same coefficients, for QuTiP.
    damping : tuple of matrices
        Collapse operators.
    """

    case: Case
    a: TimeFunction
    matrices: tuple[Matrix, ...]
    hamiltonians: tuple[Matrix, ...] | None = None
    damping: tuple[Matrix, ...] = ()


def with_qutip() -> bool:
    """Return whether QuTiP is installed."""
    return importlib.util.find_spec("qutip") is not None


def linear_cases(quick: bool) -> Iterator[LinearCase]:
    """Yield all problems, or the two fastest."""
    yield _two_levels()
    yield _rotation()
    if not quick:
        yield _coupled_spins()
        yield _master_equation()
        yield _chain()


def _two_levels() -> LinearCase:
    def a(t: float) -> list[float]:
        return [math.cos(4.0 * t), 0.0, 4.0]

    spins = tuple(0.5 * m for m in (_X, _Y, _Z))
    case = _case("driven two-level system", SU(2), a, np.eye(2, dtype=complex), 20.0, 4000)
    return LinearCase(case, a, tuple(-1j * m for m in spins), spins)


def _rotation() -> LinearCase:
    def a(t: float) -> list[float]:
        return [math.sin(t), math.cos(2.0 * t), 1.0 + 0.5 * math.sin(3.0 * t)]

    frame = UnitQuaternion()
    case = _case("prescribed rotation", frame, a, np.array([0.0, 0.0, 0.0, 1.0]), 10.0, 2000)
    matrices = tuple(np.stack([frame.field(v, y) for y in np.eye(4)], axis=1) for v in np.eye(3))
    return LinearCase(case, a, matrices)


def _master_equation() -> LinearCase:
    def a(t: float) -> list[float]:
        return [1.0, math.cos(3.0 * t)]

    one = np.eye(2)
    first, second = (np.kron(_Z, one), np.kron(one, _Z))
    still = 1.5 * first + 1.0 * second + 0.5 * np.kron(_X, _X)
    hamiltonians = still, np.kron(_X, one)
    damping = tuple(np.sqrt(_DAMPING) * m for m in (np.kron(_LOWER, one), np.kron(one, _LOWER)))
    matrices = tuple(_commutator(h) for h in hamiltonians)
    matrices = (matrices[0] + sum(map(_dissipator, damping)), matrices[1])
    y0 = np.zeros(16, dtype=complex)
    y0[0] = 1.0
    case = _case("Lindblad equation of two qubits", LinearAction(matrices), a, y0, 10.0, 1000)
    return LinearCase(case, a, matrices, hamiltonians, damping)


def _coupled_spins() -> LinearCase:
    """Return the propagator of two coupled spins, each with its own drive."""

    def a(t: float) -> list[float]:
        return [1.0, math.cos(2.0 * t), math.sin(3.0 * t)]

    one, frame = np.eye(2), SU(4)
    still = np.kron(_Z, one) + 1.5 * np.kron(one, _Z) + 0.5 * np.kron(_Z, _Z)
    hamiltonians = still, np.kron(_X, one), np.kron(one, _Y)
    columns = np.array([frame.coefficients(-1j * h) for h in hamiltonians]).T

    def coefficients(t: float) -> list[float]:
        values: list[float] = (columns @ a(t)).tolist()
        return values

    y0 = np.eye(4, dtype=complex)
    case = _case("two coupled spins", frame, coefficients, y0, 10.0, 2000)
    return LinearCase(case, coefficients, tuple(frame.basis))


def _chain() -> LinearCase:
    def a(t: float) -> list[float]:
        return [1.0, 0.5 + 0.5 * math.cos(2.0 * t)]

    def at(matrix: Any, site: int) -> Any:
        factors = [matrix if k == site else sparse.eye_array(2) for k in range(_SITES)]
        return reduce(sparse.kron, factors)

    pairs = sum(at(_Z.real, k) @ at(_Z.real, k + 1) for k in range(_SITES - 1))
    hamiltonians = tuple(
        sparse.csr_array(h) for h in (pairs, sum(at(_X.real, k) for k in range(_SITES)))
    )
    matrices = tuple(-1j * h for h in hamiltonians)
    y0 = np.zeros(2**_SITES, dtype=complex)
    y0[0] = 1.0
    case = _case(f"spin chain of {_SITES} sites", LinearAction(matrices), a, y0, 2.0, 100)
    return LinearCase(case, a, matrices, hamiltonians)


def _case(
    title: str, frame: Frame, a: TimeFunction, y0: NDArray[Any], end: float, steps: int
) -> Case:
    exact = cg.solve_linear(a, (0.0, end), y0, frame=frame, method="CFM8(4)", h=end / steps).y[-1]
    return Case(title, title, frame, lambda t, y: a(t), y0, end, exact, linear=True)


def _commutator(h: Matrix) -> Matrix:
    """Return the matrix of ρ ↦ -i (h ρ - ρ h), on the rows of ρ one after the other."""
    one = np.eye(len(h))
    return -1j * (np.kron(h, one) - np.kron(one, h.T))


def _dissipator(c: Matrix) -> Matrix:
    one, product = np.eye(len(c)), c.conj().T @ c
    return np.kron(c, c.conj()) - 0.5 * (np.kron(product, one) + np.kron(one, product.T))


def dop853(problem: LinearCase) -> Solve:
    """Return SciPy's DOP853 on the entries of the point."""
    case, a = problem.case, problem.a
    matrices = [m if sparse.issparse(m) else np.asarray(m) for m in problem.matrices]
    shape, used = case.y0.shape, [k for k, x in enumerate(a(0.3)) if x]

    def f(t: float, y: NDArray[Any]) -> NDArray[Any]:
        coefficients, point = a(t), y.reshape(shape)
        total = coefficients[used[0]] * (matrices[used[0]] @ point)
        for k in used[1:]:
            total += coefficients[k] * (matrices[k] @ point)
        return np.asarray(total).reshape(-1)

    def solve(tolerance: float) -> Run:
        solution = solve_ivp(
            f, (0.0, case.end), case.y0.reshape(-1), method="DOP853", rtol=tolerance, atol=tolerance
        )
        return Run(solution.y[:, -1:].T.reshape(1, *shape), solution.nfev, 0)

    return solve


def qutip_solver(problem: LinearCase) -> Solve:
    """Return QuTiP's sesolve or mesolve with the method vern9."""
    import qutip

    case, a = problem.case, problem.a
    assert problem.hamiltonians is not None
    dims = [[2] * round(np.log2(problem.hamiltonians[0].shape[0]))] * 2

    def operator(matrix: Matrix) -> Any:
        return qutip.Qobj(matrix, dims=dims)

    terms: list[Any] = []
    for k, matrix in enumerate(problem.hamiltonians):
        if a(0.0)[k] == a(0.3)[k]:
            if a(0.0)[k]:
                terms.append(a(0.0)[k] * operator(matrix))
        else:
            terms.append([operator(matrix), lambda t, k=k: a(t)[k]])
    hamiltonian, shape = qutip.QobjEvo(terms), case.y0.shape
    if problem.damping:
        start = qutip.Qobj(case.y0.reshape(4, 4), dims=dims)
    else:
        start = qutip.Qobj(
            case.y0.reshape(shape[0], -1), dims=[dims[0], dims[0] if len(shape) == 2 else [1]]
        )

    def solve(tolerance: float) -> Run:
        options = {
            "method": "vern9", "rtol": tolerance, "atol": tolerance, "nsteps": 10**6,
            "progress_bar": "",
        }  # fmt: skip
        if problem.damping:
            collapse = [operator(c) for c in problem.damping]
            result = qutip.mesolve(hamiltonian, start, [0.0, case.end], collapse, options=options)
        else:
            result = qutip.sesolve(hamiltonian, start, [0.0, case.end], options=options)
        return Run(result.states[-1].full().reshape(1, *shape), 0, 0)

    return solve
