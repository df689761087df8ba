"""QuTiP's linear equations on `cg.frames.LinearAction`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from qutip import Qobj
from qutip.core.data import Data, Dense
from qutip.solver.integrator import Integrator, IntegratorException
from scipy import sparse

from cg.frames.linear_action import LinearAction
from cg.integration.ivp import solve_linear
from cg.qutip.arrays import times_of_arrays

_ROUNDING = 1e-14  # error of entries of generators, relative to the largest one


class LinearIntegrator(Integrator):  # type: ignore[misc]  # QuTiP has no types
    r"""Commutator-free Magnus steps for Schrödinger's and Lindblad's equations.

    ``qutip.sesolve`` and ``qutip.mesolve`` take it as ``options={"method": "cg"}`` after
    ``import cg.qutip``. The system :math:`y' = \sum_k c_k(t) A_k y` becomes a problem of
    `cg.solve_linear` on `cg.frames.LinearAction`, with the real and imaginary parts of the
    coefficients :math:`c_k` as coefficients of :math:`A_k` and :math:`i A_k`. Hermitian parts
    that cancel in the sum are left out, so that the norm of a state vector is kept to rounding.

    Raises
    ------
    TypeError
        If the system is a function that returns operators, or depends on the state.
    """

    integrator_options = {  # noqa: RUF012  # QuTiP's interface
        "rtol": 1e-6,
        "atol": 1e-8,
        "nsteps": 100_000,
        "max_step": 0.0,
        "first_step": 0.0,
        "breakpoints": (),
    }
    support_time_dependant = True
    supports_blackbox = False
    method = "cg"
    name = "cg"

    def _prepare(self) -> None:
        self._terms = _collect(self.system)
        self._stops: dict[float, NDArray[np.float64]] = {}
        self._is_real, self._is_skew = True, bool(self.system.isoper)
        self._rebuild()

    def _rebuild(self) -> None:
        """Make the generators for what is known of the coefficients.

        They are taken as real, and the sum of the terms as skew-Hermitian, until a time at which
        this is wrong; the integration then starts again with all generators.
        """
        matrices = [matrix for _, matrix in self._terms]
        if not self._is_real:
            matrices += [1j * matrix for matrix in matrices[1:]]
        adjoints = [matrix.conj().T for matrix in matrices]
        pairs = list(zip(matrices, adjoints, strict=True))
        if self._is_skew:
            columns = sparse.hstack([(a + b).reshape((-1, 1)) for a, b in pairs])
            self._hermitian = np.linalg.qr(columns.toarray(), mode="r")
            matrices = [0.5 * (a - b) for a, b in pairs]
        self._matrices = matrices
        self._frames: dict[int, LinearAction] = {}

    @property
    def options(self) -> dict[str, Any]:
        """Options of the method "cg", added to those of the solver.

        rtol
            Relative tolerance of the error in a step, by default 1e-6.

        atol
            Absolute tolerance of the error in a step, by default 1e-8.

        nsteps
            Largest number of steps between two calls, by default 100,000.

        max_step, first_step
            Largest step and first step, by default 0 (automatic).

        breakpoints
            Times at which coefficients jump, by default none; those of arrays are known.
        """
        options: dict[str, Any] = self._options
        return options

    @options.setter
    def options(self, new_options: dict[str, Any]) -> None:
        Integrator.options.fset(self, new_options)

    def set_state(self, t: float, state: Data) -> None:
        """Set the time and the state, a vector or a matrix whose columns evolve alike."""
        columns = state.to_array()
        self._t, self._shape = float(t), columns.shape
        self._y = columns.reshape(-1, order="F").astype(complex)
        self._is_set = True

    def reset(self, hard: bool = False) -> None:
        """Read the system again, whose arguments may have changed."""
        super().reset(hard=True)

    def get_state(self, copy: bool = True) -> tuple[float, Data]:
        """Return the time and the state."""
        return self._t, self._state(self._y)

    def integrate(self, t: float, copy: bool = True) -> tuple[float, Data]:
        """Integrate to a time; return it and the state."""
        for _ in self.run([self._t, t]):
            pass
        return self.get_state()

    def run(self, tlist: Sequence[float]) -> Iterator[tuple[float, Data]]:
        """Integrate through times, the first of which is that of the state."""
        times = np.asarray(tlist, dtype=float)
        while True:
            try:
                solution = self._solve(times)
                break
            except _WrongAssumptionError:
                self._rebuild()
        if not solution.success:
            raise IntegratorException(solution.message)
        for t, y in zip(times[1:], solution.y[1:], strict=True):
            self._t, self._y = float(t), y
            yield self.get_state()

    def _state(self, y: NDArray[Any]) -> Dense:
        return Dense(np.asarray(y).reshape(self._shape, order="F"))

    def _solve(self, times: NDArray[np.float64]) -> Any:
        options = {name: self.options[name] for name in ("rtol", "atol")}
        options |= {n: self.options[n] for n in ("max_step", "first_step") if self.options[n]}
        start, end = sorted((times[0], times[-1]))
        stops = np.union1d(self.options["breakpoints"], self._times_of_arrays(options["rtol"]))
        inside = stops[(stops > start) & (stops < end)]
        return solve_linear(
            self._coefficients,
            (times[0], times[-1]),
            self._y,
            frame=self._frame(self._shape[1]),
            t_eval=times,
            max_steps=self.options["nsteps"],
            breakpoints=inside if times[0] == start else inside[::-1],
            **options,
        )

    def _times_of_arrays(self, rtol: float) -> NDArray[np.float64]:
        """Return the times at which steps end because of coefficients from arrays."""
        if rtol not in self._stops:
            coefficients = [coefficient for coefficient, _ in self._terms[1:]]
            self._stops[rtol] = times_of_arrays(coefficients, rtol)
        return self._stops[rtol]

    def _frame(self, columns: int) -> LinearAction:
        if columns not in self._frames:
            each = sparse.eye_array(columns)
            self._frames[columns] = LinearAction([sparse.kron(each, a) for a in self._matrices])
        return self._frames[columns]

    def _coefficients(self, t: float) -> NDArray[np.float64]:
        values = np.array([coefficient(t) for coefficient, _ in self._terms[1:]], dtype=complex)
        if self._is_real and values.imag.any():
            self._is_real = False
            raise _WrongAssumptionError
        v = np.concatenate([[1.0], values.real, [] if self._is_real else values.imag])
        if self._is_skew:
            size = float(np.abs(self._hermitian).max(axis=0, initial=0.0) @ np.abs(v))
            if np.abs(self._hermitian @ v).max() > _ROUNDING * max(size, 1.0):
                self._is_skew = False
                raise _WrongAssumptionError
        return v


class _WrongAssumptionError(Exception):
    """Coefficients at some time need generators that were left out."""


def _collect(system: Any) -> list[tuple[Any, sparse.csr_array]]:
    """Return the coefficients and the matrices of a system, the constant part first."""
    constant = sparse.csr_array(system.shape, dtype=complex)
    terms: list[tuple[Any, sparse.csr_array]] = []
    for part in system.to_list():
        operator, coefficient = part if isinstance(part, list) else (part, None)
        if not isinstance(operator, Qobj):
            raise TypeError(
                "the system must be a sum of operators with coefficients for the method 'cg', got "
                "a function that returns operators"
            )
        matrix = operator.to("CSR").data.as_scipy()
        same = [k for k, (other, _) in enumerate(terms) if other == coefficient]
        if coefficient is None:
            constant = constant + matrix
        elif same:
            terms[same[0]] = coefficient, terms[same[0]][1] + matrix
        else:
            terms.append((coefficient, matrix))
    return [(None, constant), *terms]
