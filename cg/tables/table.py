"""The table of a method: its constants as compiled code reads them, and facts about it."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import Polynomial

from cg.support.arrays import Array
from cg.support.shared_numbers import EstimateForm, StepKind
from cg.support.shared_records import METHOD, fields_of

_INTEGERS = {"origin", "path_first", "flow_first", "flow_stage", "stage_path"}


class Kind(StrEnum):
    """How a method takes a step."""

    GROUP = "group"  # explicit stages, by flows
    ALGEBRA = "algebra"  # explicit stages, by coordinates in the Lie algebra
    IMPLICIT = "implicit"  # stages that are solved for, by flows
    COLLOCATION = "collocation"  # all stages solved together, by coordinates
    LINEAR = "linear"  # for linear equations, whose coefficients depend on time alone
    SPLITTING = "splitting"  # kicks and drifts of mechanical systems


class HasTable(Protocol):
    """A method: anything that has a table."""

    def table(self) -> MethodTable:
        """Return the constants that integrations read."""
        ...

    def __hash__(self) -> int: ...


class MethodRecord(ctypes.Structure):
    """The structure of compiled code with the constants of a method."""

    _fields_ = fields_of(METHOD)


@dataclass(frozen=True, eq=False)
class InterpolantScheme:
    """How points between steps are computed; `cg.construction.methods.interpolant` explains it.

    ``flow_c`` and ``flow_weights`` are the flows to the result of a method for fields that depend
    on time alone; ``node`` and ``blend`` are one column for each interpolant with 2, 3, … nodes.
    """

    final: int  # the index, from 1, of the derivative at the end
    series: int  # the order up to which the series of dexp⁻¹ is needed
    theta: Array  # further nodes, in the order of evaluation, shape (n,)
    rows: Array  # weights of earlier derivatives in the coordinates of each node, (n, k)
    basis: Array  # coefficients of the polynomials φ, shape (degree, k)
    node: Array  # (n, n - 1)
    blend: Array  # (n + 2, n - 1)
    flow_c: Array  # (stages)
    flow_weights: Array  # (flows, stages)

    @property
    def interpolant_vectors(self) -> int:
        """Number of vectors of an interpolant."""
        return max(len(self.basis), len(self.node) + 1)


@dataclass(frozen=True, eq=False, repr=False)
class MethodTable:
    """A method as integrations read it.

    ``numbers`` and ``arrays`` are the entries of `MethodRecord`. A step keeps ``kept_vectors``: one
    register, or coefficients at its stages, with the end where the error estimate needs it, and
    brackets. Magnus methods of three nodes or more also keep ``kept_nodes`` vectors of the step
    before. Steps are proportional to errors to the power ``exponent``, 0 without estimates.
    """

    name: str
    kind: Kind
    label: str  # the method in messages
    order: int
    embedded_order: int | None
    stages: int
    exponent: float
    kept_vectors: int
    kept_nodes: int
    # whether the weights of the result add up to one, and why the estimate of a pair is unreliable
    converges: bool
    estimate_fault: str
    numbers: Mapping[str, float]
    arrays: Mapping[str, Array]
    output: InterpolantScheme
    # on actions of matrices: one flow along the polynomial through the coefficients at the nodes
    polynomial: MethodTable | None = None
    real_stability: float | None = None
    method: Any = None  # the method that the table was made of, unless it is stored

    def __repr__(self) -> str:
        return self.label

    def __reduce__(self) -> tuple[Any, ...]:
        # processes read stored tables themselves
        restore = import_module("cg.tables.stored").unique_table
        method = self.name if self.method is None else self.method
        return restore, (method, True) if self.is_polynomial else (method,)

    @property
    def c(self) -> Array:
        """The abscissae of the stages, then 1 where error estimates need the end as a stage."""
        return self.arrays["c"]

    @cached_property
    def explicit(self) -> bool:
        """Whether no equations have to be solved for the stages."""
        return self.kind not in (Kind.IMPLICIT, Kind.COLLOCATION)

    @property
    def on_algebra(self) -> bool:
        """Whether stages are coordinates in the Lie algebra, whose brackets the method needs."""
        return self.kind in (Kind.ALGEBRA, Kind.COLLOCATION)

    @property
    def composes_leapfrogs(self) -> bool:
        """Whether each drift of a splitting method has half its length of kick on both sides."""
        drifts, kicks = self.arrays["drifts"], self.arrays["weight"]
        halves = (drifts + np.append(0.0, drifts[:-1])) / 2.0
        return halves.shape == kicks.shape and bool(np.allclose(halves, kicks, rtol=0, atol=1e-15))

    @property
    def symmetric(self) -> bool:
        """Whether a splitting method is symmetric."""
        drifts, kicks = self.arrays["drifts"], self.arrays["weight"]
        if len(drifts) == len(kicks):
            drifts = np.append(0.0, drifts)
        return all(np.allclose(x, x[::-1], rtol=0.0, atol=1e-12) for x in (drifts, kicks))

    @property
    def is_polynomial(self) -> bool:
        """Whether the flows of the only path are one along a polynomial."""
        return bool(self.numbers["polynomial"])

    @property
    def has_brackets(self) -> bool:
        """Whether steps use brackets of coefficients."""
        return bool(self.numbers["bracket_count"])

    @property
    def estimate(self) -> EstimateForm:
        """The form of the error estimate."""
        return EstimateForm(int(self.numbers["estimate"]))

    def real_limit(self) -> float | None:
        """Return the limit of stability along the negative real axis, None if there is none."""
        if self.method is None:
            return self.real_stability
        summary = import_module("cg.construction.catalogue.summary").summary_of(self.method)
        return summary.real_stability  # type: ignore[no-any-return]

    @property
    def combined_vectors(self) -> int:
        """Number of vectors that flows combine: coefficients at stages, then brackets."""
        return len(self.c) + int(self.numbers["bracket_count"])

    @cached_property
    def paths(self) -> tuple[tuple[int, Array], ...]:
        """The paths: the number of the path that each starts at, 0 for the step, and its flows.

        Flows are weights of stages and brackets, shape ``(flows, combined_vectors)``.
        """
        arrays, first_terms = self.arrays, self.arrays["flow_first"] - 1
        weights = np.zeros((len(first_terms) - 1, self.combined_vectors))
        for row, (begin, end) in zip(weights, pairwise(first_terms), strict=True):
            row[arrays["flow_stage"][begin:end] - 1] = arrays["weight"][begin:end]
        flows = (weights[begin:end] for begin, end in pairwise(arrays["path_first"] - 1))
        return tuple(zip(arrays["origin"].tolist(), flows, strict=True))

    @property
    def result_flows(self) -> Array:
        """All flows from the start to the result, shape ``(flows, combined_vectors)``."""
        flows, k = [], int(self.numbers["result"])
        while k:
            k, last = self.paths[k - 1]
            flows.append(last)
        return np.concatenate([np.zeros((0, self.combined_vectors)), *reversed(flows)])

    @property
    def errors(self) -> Array:
        """Weights of error estimates, shape ``(errors, combined_vectors)``."""
        return self.arrays["error"].reshape(-1, self.combined_vectors)

    @property
    def brackets(self) -> Array:
        """Weights of both sides of brackets, shape ``(brackets, 2, combined_vectors)``."""
        return self.arrays["brackets"].reshape(-1, 2, self.combined_vectors)

    @cached_property
    def record(self) -> MethodRecord:
        """The structure that compiled code reads; it keeps its arrays alive."""
        arrays = {name: np.asarray(array, np.float64) for name, array in self.arrays.items()}
        addresses = {name: array.ctypes.data for name, array in arrays.items()}
        numbers = {name: x for name, x in self.numbers.items() if name in METHOD}
        kind = StepKind[self.kind.name]
        if "registers" in self.arrays:
            kind = StepKind.REGISTERS
        if self.is_polynomial:
            kind = StepKind.POLYNOMIAL
        output = self.output
        names = "theta", "rows", "basis", "node", "blend", "flow_c", "flow_weights"
        kept = {name: np.ascontiguousarray(getattr(output, name)) for name in names}
        record = MethodRecord(
            kind=kind, kept_nodes=self.kept_nodes, final=output.final, output_series=output.series,
            further=len(output.theta), derivatives=output.basis.shape[1], degree=len(output.basis),
            nodes=len(output.node), result_stages=len(output.flow_c),
            result_flows=len(output.flow_weights), **numbers, **addresses,
            **{name: array.ctypes.data for name, array in kept.items()},
        )  # fmt: skip
        record.arrays = arrays | kept
        return record

    def as_dict(self) -> dict[str, Any]:
        """Return the table as data for JSON."""
        return _plain(self)  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    """Return a value as data for JSON."""
    if isinstance(value, MethodTable | InterpolantScheme):
        value = {x.name: getattr(value, x.name) for x in fields(value) if x.name != "method"}
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def basis_polynomials(degree: int) -> list[Polynomial]:
    """Return the basis polynomials φ of interpolants in coordinates."""
    x, rest = Polynomial([0.0, 1.0]), Polynomial([1.0, -1.0])
    return [x ** ((d + 1) // 2) * rest ** (d // 2) for d in range(1, degree + 1)]


def from_dict(data: dict[str, Any]) -> MethodTable:
    """Return the table that `MethodTable.as_dict` wrote."""
    polynomial, output = data["polynomial"], dict(data["output"])
    output |= {name: np.array(x, np.float64) for name, x in output.items() if isinstance(x, list)}
    output["rows"] = output["rows"].reshape(len(output["theta"]), output["basis"].shape[1])
    converted = {
        "kind": Kind(data["kind"]),
        "arrays": {
            name: np.array(entry, np.intc if name in _INTEGERS else np.float64)
            for name, entry in data["arrays"].items()
        },
        "output": InterpolantScheme(**output),
        "polynomial": None if polynomial is None else from_dict(polynomial),
    }
    return MethodTable(**(data | converted))
