"""The integrator ``method="cg"`` of QuTiP's solvers, registered when this module is imported."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy import sparse

from cg.frames.linear_action import LinearAction, on_one_pattern
from cg.integration.ivp import solve_linear
from cg.integration.rhs.samples import Samples
from cg.support.arrays import Array, check_finite, real_array
from cg.support.checks import check_count

try:
    from qutip import Qobj
    from qutip.core.cy.coefficient import Coefficient, InterCoefficient
    from qutip.core.data import Data, Dense
    from qutip.core.data.dense import fast_from_numpy
    from qutip.solver import MESolver, SESolver
    from qutip.solver.integrator import Integrator, IntegratorException
except ImportError as error:
    raise ImportError("cg.qutip needs qutip>=5: python -m pip install qutip") from error

__all__ = ["LinearIntegrator"]

_KINDS = {1: "hold", 2: "linear"}  # by number of coefficients of a piece, else splines

_INTERVALS = 10.0  # between output times in a step, which has nine nodes
_ENTRY_ERROR = 1e-14  # error of generators, relative to the largest entry


class LinearIntegrator(Integrator):  # type: ignore[misc]  # QuTiP has no types
    r"""Steps of `cg.solve_linear` for Schrödinger's and Lindblad's equations.

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
        if feedback := getattr(self.system, "_feedback_functions", None):  # since QuTiP 5.1
            raise TypeError(
                "the system must not depend on the state for the method 'cg', got feedback in the "
                f"arguments {list(feedback)}"
            )
        self._functions, rows, matrices = _collect(self.system)
        self._pattern, values = on_one_pattern(matrices, symmetric=True)
        self._values = np.zeros((1 + len(self._functions), values.shape[1]), complex)
        for row, added in zip(rows, values, strict=True):
            self._values[row] += added
        self._array_times: dict[float, Array] = {}
        self._is_real, self._is_skew = True, bool(self.system.isoper)
        self._rebuild()

    def _rebuild(self) -> None:
        """Make the generators that the assumptions on the coefficients leave.

        Coefficients are taken as real, and the sum of the terms as skew-Hermitian, until a time at
        which this is wrong; the integration then starts again with all generators.
        """
        pattern, values = self._pattern, self._values
        if not self._is_real:
            values = np.concatenate([values, 1j * values[1:]])
        self._hermitian: Any = np.empty((0, len(values)))
        if self._is_skew:
            adjoints = values[:, pattern.transposed()].conj()
            sums, values = values + adjoints, 0.5 * (values - adjoints)
            if np.abs(sums).max(initial=0.0) > _ENTRY_ERROR * np.abs(values).max(initial=0.0):
                self._hermitian = np.linalg.qr(sums.T, mode="r")
        self._generators = pattern, values
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
            Largest step and first step, by default 0 (automatic): a step is no longer than ten
            intervals between output times if a coefficient is a function, so that a pulse that they
            resolve isn't passed over.

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
        self._t, self._y = float(t), state.to_array().astype(complex)
        self._is_set = True

    def reset(self, hard: bool = False) -> None:
        """Read the system again, whose arguments may have changed."""
        super().reset(hard=True)

    def get_state(self, copy: bool = True) -> tuple[float, Data]:
        """Return the time and the state."""
        return self._t, Dense(self._y)

    def integrate(self, t: float, copy: bool = True) -> tuple[float, Data]:
        """Integrate to a time; return it and the state."""
        for _ in self.run([self._t, t]):
            pass
        return self.get_state()

    def run(self, tlist: Sequence[float]) -> Iterator[tuple[float, Data]]:
        """Integrate through times, the first of which is that of the state."""
        all_times = np.asarray(tlist, dtype=float)
        changes = np.diff(all_times)
        if not (np.all(changes >= 0.0) or np.all(changes <= 0.0)):
            raise ValueError(f"tlist must be sorted, got {all_times}")
        times = all_times[np.append(True, changes != 0.0)]
        if len(times) == 1:
            yield from ((self._t, Dense(self._y)) for _ in changes)
            return
        while True:
            try:
                solution = self._solve(times)
                break
            except _WrongAssumptionError:
                self._rebuild()
        if not solution.success:
            raise IntegratorException(solution.message.replace("max_steps", "nsteps"))
        indices = np.cumsum(changes != 0.0)
        for self._t, self._y in zip(all_times[1:].tolist(), solution.y[indices], strict=True):
            yield self._t, fast_from_numpy(self._y)  # complex and in order; no check takes time

    def _solve(self, times: Array) -> Any:
        options = {name: self.options[name] for name in ("rtol", "atol")}
        options |= {n: self.options[n] for n in ("max_step", "first_step") if self.options[n]}
        in_pieces = all(isinstance(function, InterCoefficient) for function in self._functions)
        if "max_step" not in options and not in_pieces:
            options["max_step"] = _INTERVALS * np.abs(np.diff(times)).max()
        start, end = sorted((times[0], times[-1]))
        if "first_step" in options and options["first_step"] > end - start > 0.0:
            options["first_step"] = end - start  # of a solver that is asked for a short time
        breakpoints = np.atleast_1d(real_array(self.options["breakpoints"], "breakpoints"))
        check_finite("breakpoints", breakpoints)
        ends = np.union1d(breakpoints, self._times_of_arrays(options["rtol"]))
        inside = ends[(ends > start) & (ends < end)]
        return solve_linear(
            self._coefficients,
            (times[0], times[-1]),
            self._y,
            frame=self._frame(),
            t_eval=times,
            max_steps=check_count("nsteps", self.options["nsteps"]),
            breakpoints=(inside if times[0] == start else inside[::-1]) if len(inside) else None,
            **options,
        )

    def _times_of_arrays(self, rtol: float) -> Array:
        """Return the times at which steps end because of coefficients from arrays."""
        if rtol not in self._array_times:
            self._array_times[rtol] = _times_of_arrays(self._functions, rtol)
        return self._array_times[rtol]

    def _frame(self) -> LinearAction:
        columns = self._y.shape[1]
        if columns not in self._frames:
            self._frames[columns] = LinearAction.from_pattern(*self._generators, columns)
        return self._frames[columns]

    def _coefficients(self, t: float) -> list[float]:
        v, imaginary = [1.0], []
        for coefficient in self._functions:
            value = coefficient(t)
            v.append(value.real)
            imaginary.append(value.imag)
        if not self._is_real:
            v += imaginary
        elif any(imaginary):
            self._is_real = False
            raise _WrongAssumptionError
        if len(self._hermitian):
            size = float(np.abs(self._hermitian).max(axis=0, initial=0.0) @ np.abs(v))
            if np.abs(self._hermitian @ v).max() > _ENTRY_ERROR * max(size, 1.0):
                self._is_skew = False
                raise _WrongAssumptionError
        return v


class _WrongAssumptionError(Exception):
    """Coefficients at some time need generators that were left out."""


def _collect(system: Any) -> tuple[list[Any], list[int], list[sparse.csr_array]]:
    """Return the coefficients, and of each term the number of its coefficient and its matrix.

    Coefficients are counted from 1; constant terms have the number 0.
    """
    functions: list[Any] = []
    numbers, matrices = [], []
    for term in system.to_list():
        operator, coefficient = term if isinstance(term, list) else (term, None)
        if not isinstance(operator, Qobj):
            raise TypeError(
                "the system must be a sum of operators with coefficients for the method 'cg', got "
                "a function that returns operators"
            )
        if coefficient is not None and coefficient not in functions:
            functions.append(coefficient)
        numbers.append(0 if coefficient is None else 1 + functions.index(coefficient))
        matrices.append(operator.to("CSR").data.as_scipy())
    return functions, numbers, matrices


def _times_of_arrays(coefficient: Any, tolerance: float) -> Array:
    """Return times at which steps must end, so that none passes over what a coefficient does.

    Sums and products contain others, which are found as for a pickle.
    """
    times, rest = [np.empty(0)], [coefficient]
    while rest:
        item = rest.pop()
        if isinstance(item, tuple | list):
            rest += item
        elif isinstance(item, Coefficient):
            _, arguments, *state = item.__reduce__()
            if isinstance(item, InterCoefficient):
                times.append(_times(arguments[0], arguments[1], tolerance))
            else:
                rest += arguments, *state
    return np.unique(np.concatenate(times))


def _times(times: Array, pieces: Any, tolerance: float) -> Array:
    """Return the times at which steps must end for one array coefficient."""
    values = np.stack([pieces[-1].real, pieces[-1].imag], axis=1)  # the numbers of the array
    curve = Samples(times, values, _KINDS.get(len(pieces), "cubic"))
    ends = curve.times[[0, -1]]
    return np.concatenate([ends, curve.corners(tolerance), curve.max_steps_at(tolerance)[:, 0]])


for solver in (SESolver, MESolver):
    solver.add_integrator(LinearIntegrator, LinearIntegrator.method)
