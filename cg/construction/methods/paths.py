r"""Methods as paths of flows between points, as compiled code takes them.

Point m of a method is reached from its parent by one flow, of fields :math:`F_k` that are frozen
at stages k,

.. math:: y_m = \exp\Bigl(h \sum_k \alpha_{mk} F_k\Bigr) y_{\mathrm{parent}(m)} .

Points are stored only where they are needed again: stages, results, and points with several
children. A `Path` is the sequence of flows from one stored point to the next; equal points are
merged, and points that lead to no stage or result are left out. A row of a tableau is a path from
the start, with one flow for each coefficient that isn't zero (P. E. Crouch, R. Grossman, "Numerical
integration of ordinary differential equations on manifolds", J. Nonlinear Sci. 3 (1993), 1-33);
stages of a commutator-free method may share the first flows (E. Celledoni, A. Marthinsen,
B. Owren, "Commutator-free Lie group methods", Future Gener. Comput. Syst. 19 (2003), 341-352).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import accumulate, chain
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import Rows
from cg.construction.methods.coefficients import values_of
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.end_weights import end_weights, kink_weights
from cg.construction.methods.low_storage import Registers, two_registers
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method, frozen
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.tableau import Tableau
from cg.construction.points import START, PointTree
from cg.support.arrays import Array
from cg.support.caches import cached_by_identity
from cg.support.shared_numbers import EstimateForm

_TIME_ROUNDING = Fraction(1, 10**14)  # error of the sum of drifts

Flow = tuple[tuple[int, Fraction], ...]
"""The stages (from 0) and their weights that make the field of one flow."""

Brackets = tuple[tuple[tuple[Fraction, ...], ...], ...]


@dataclass(frozen=True)
class Path:
    """Flows from one stored point to another."""

    origin: int  # the path at whose end it starts, counting from 1; 0 is the start of the step
    flows: tuple[Flow, ...]  # the first one first


@dataclass(frozen=True)
class MethodPaths:
    """A method as paths, with the other fields of the structure `METHOD` of compiled code.

    Stored points are stages, results, and points from which several paths start. Paths are in the
    order in which a step needs them and counted from 1; 0 is the start of the step.

    `errors` are the weights of the second estimate of a pair, or its `end_weights`, for which the
    end of the step is one more stage; `kink_weights` are last but one.
    """

    paths: tuple[Path, ...]
    stages: tuple[int, ...]  # the path to each stage
    result: int  # the path to the result of the step, the one of higher order of a pair
    c: tuple[Fraction, ...]  # abscissae
    embedded: int = 0  # the path to the second result of a pair, or 0
    final_stage: int = 0  # the stage (from 1) that is the first one of the next step, or 0
    registers: Registers | None = None
    series: int = 0  # order up to which the series of dexp⁻¹ is needed, 0 for none
    errors: tuple[tuple[Fraction, ...], ...] = ()
    transformation: tuple[Fraction, ...] = ()  # see `transformation`
    third: int = 0  # the path to a third result, or 0
    estimate: EstimateForm = EstimateForm.WHOLE
    power: int = 1  # see `error_power`
    factor: Fraction = Fraction(1, 10)  # weight of e2 in the quotient, as in DOP853
    # whether the flows of the only path are the coefficients of a polynomial in 2θ - 1
    polynomial: bool = False
    brackets: Brackets = ()  # flows and errors have weights on them after those on stages
    blocks: int = 0  # systems of stage equations, solved one after the other
    drifts: tuple[Fraction, ...] = ()  # after each kick of splitting methods

    @cached_property
    def abscissae(self) -> NDArray[np.float64]:
        """The abscissae as a read-only array."""
        return frozen(self.c)

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers among the fields of the structure `METHOD`, by name."""
        flows = [flow for path in self.paths for flow in path.flows]
        return {
            "paths": len(self.paths), "flows": len(flows), "terms": sum(map(len, flows)),
            "stages": len(self.stages), "errors": len(self.errors),
            "bracket_count": len(self.brackets), "result": self.result, "embedded": self.embedded,
            "third": self.third, "final_stage": self.final_stage, "series": self.series,
            "estimate": int(self.estimate), "power": self.power, "factor": float(self.factor),
            "blocks": self.blocks, "polynomial": int(self.polynomial),
        }  # fmt: skip

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of that record."""
        flows = [flow for path in self.paths for flow in path.flows]
        terms = [term for flow in flows for term in flow]
        integers = {
            "origin": [path.origin for path in self.paths],
            "path_first": [*accumulate((len(path.flows) for path in self.paths), initial=1)],
            "flow_first": [*accumulate(map(len, flows), initial=1)],
            "flow_stage": [stage + 1 for stage, _ in terms],
            "stage_path": self.stages,
        }
        vectors = len(self.stages) + len(self.brackets)
        sides = [(*side, *[Fraction(0)] * (vectors - len(side))) for side in chain(*self.brackets)]
        reals = {
            "weight": [weight for _, weight in terms],
            "c": self.c,
            "error": [*chain(*self.errors)],
            "transformation": self.transformation,
            "brackets": [*chain(*sides)],
        }
        if self.drifts:
            reals["drifts"] = self.drifts
        if self.registers is not None:
            reals["registers"] = [*chain(*self.registers)]
        arrays = {name: np.array(row, np.intc) for name, row in integers.items()}
        return arrays | {name: np.array(row, np.float64) for name, row in reals.items()}


def error_power(method: Method) -> int:
    """Return the n of the error estimate e₁ (e₁ / hypot(e₁, c e₂))ⁿ.

    With results of orders p, q and r, e₁ = O(h^(q + 1)) and e₂ = O(h^(r + 1)). This n leads to
    the order of the error of the step, O(h^(p + 1)), or one below.
    """
    third = method.third_order
    second = None if third is None else method.embedded_order
    if second is None or third is None or third >= second:
        return 1
    return max((method.order - second) // (second - third), 1)


@cached_by_identity
def paths_of(method: Method) -> MethodPaths:
    """Return the paths of a method."""
    if isinstance(method, Splitting):
        return _splitting_paths(method)
    if isinstance(method, MuntheKaas) and not method.explicit:
        return _collocation_paths(method)
    series = 0
    if isinstance(method, MuntheKaas):
        method = method.advancing_method
        series = max(method.order, 1)
    errors, tree = method.error_weights, method.tree.without_repetitions()
    result, *second = (method.tree.merged[end] for end in method.advancing_results)
    builder = PathBuilder(tree, method.explicit)
    stages = tuple(map(builder.path_to, tree.stage_points))
    result_path = builder.path_to(result)
    c = method.abscissae
    ends = [k for k, path in enumerate(stages, 1) if path == result_path > 0 and c[k - 1] == 1]
    final = ends[0] if ends and method.explicit else 0
    embedded_path = builder.path_to(second[0]) if second else 0
    third, factor, brackets = 0, MethodPaths.factor, MethodPaths.brackets
    estimate = MethodPaths.estimate
    if isinstance(method, MagnusMethod):
        factor = method.third_factor.value
        brackets = values_of(method.brackets)
        if len(errors) > 1:
            estimate = EstimateForm.PARTS_OF_SUMS
    if series and len(errors) > 1:
        estimate = EstimateForm.PARTS_OF_SERIES
    if method.third_flow is not None:
        flow = tuple((k, a.value) for k, a in enumerate(method.third_flow) if a.value != 0)
        builder.paths.append(Path(0, (flow,)))
        third, estimate = len(builder.paths), EstimateForm.PARTS_OF_RESULTS
    if end := end_weights(method):
        stages, c, final = (*stages, result_path), (*c, Fraction(1)), len(stages) + 1
        errors, factor, estimate = end.rows, end.factor, EstimateForm.AT_END
    if kinks := kink_weights(method):
        errors = (*errors[:-1], kinks, errors[-1])
    one_block = isinstance(method, Tableau) and method.rows is Rows.FULL
    blocks = 0 if method.explicit else 1 if one_block else method.stages
    registers = None if series or isinstance(method, MagnusMethod) else two_registers(method)
    return MethodPaths(
        tuple(builder.paths), stages, result_path, c, embedded=embedded_path, final_stage=final,
        registers=registers, series=series, errors=errors, third=third, estimate=estimate,
        power=error_power(method), factor=factor, blocks=blocks, brackets=brackets,
    )  # fmt: skip


def _collocation_paths(method: MuntheKaas) -> MethodPaths:
    """Return the paths of a collocation method: one flow to the result."""
    flow = tuple((k, weight) for k, weight in enumerate(method.exact[1]) if weight)
    return MethodPaths(
        (Path(0, (flow,)),), (0,) * method.stages, 1, method.abscissae, series=method.order,
        errors=method.error_weights, transformation=transformation(method), blocks=1,
    )  # fmt: skip


def collocation_polynomial(c: Array) -> Array:
    """Return the integrals of Lagrange's polynomials at nodes, of θ, θ², …: ``(powers, nodes)``."""
    powers = np.arange(len(c))
    return np.asarray(np.linalg.inv(c[:, None] ** powers) / (powers + 1.0)[:, None])


def transformation(method: MuntheKaas) -> tuple[Fraction, ...]:
    """Return the entries of ``transformation_t`` in ``fortran/steps/method.f90``, by columns."""
    inverse = np.linalg.inv(method.a[1:, 1:])
    values, vectors = np.linalg.eig(inverse)
    real, pair = np.argmin(np.abs(values.imag)), np.argmin(values.imag)
    basis = np.column_stack([vectors[:, real].real, vectors[:, pair].real, vectors[:, pair].imag])
    matrices = inverse, basis, np.linalg.inv(basis), collocation_polynomial(method.c[1:])
    eigenvalues = values[real].real, values[pair].real, -values[pair].imag
    numbers = np.concatenate([*(matrix.ravel(order="F") for matrix in matrices), eigenvalues])
    return tuple(map(Fraction, numbers.tolist()))


def _splitting_paths(method: Splitting) -> MethodPaths:
    """Return the paths of a splitting method, whose flows are kicks followed by drifts.

    The force depends on time and position alone. So at the end of the step it is that of the last
    stage, if the step ends with a kick.
    """
    drifts = [drift.value for drift in method.drift_coefficients]
    kicks: list[Flow] = [((k, kick.value),) for k, kick in enumerate(method.kick_coefficients)]
    first = int(drifts[0] != 0)  # a kick of zero before it
    flows: list[Flow] = [(), *kicks][1 - first :]
    paths = tuple(Path(k, (flow,)) for k, flow in enumerate(flows))
    stages = tuple(range(first, first + len(kicks)))
    c = method.abscissae
    final = drifts[0] == drifts[-1] == 0 and abs(c[-1] - 1) < _TIME_ROUNDING
    return MethodPaths(
        paths, stages, len(paths), c, final_stage=method.stages if final else 0,
        drifts=tuple(drifts[1 - first :]),
    )  # fmt: skip


@cached_by_identity
def polynomial_paths(method: Method) -> MethodPaths | None:
    """Return the flow along the polynomial that interpolates coefficients at the nodes of a method.

    The order of a step is at least that of the method. The error is estimated from the highest
    coefficients of the polynomial in Legendre polynomials, extrapolated to the next one as a
    geometric sequence; they are taken in pairs, since those of one parity may vanish. ``factor``
    was measured on eight equations, so that errors at the end are below the tolerances. Return
    None if there are fewer than three nodes, or two are equal.
    """
    nodes = method.abscissae
    if not 3 <= len(set(nodes)) == len(nodes):
        return None
    coefficients = []  # of Lagrange's polynomials, by powers of s = 2θ - 1
    for k, node in enumerate(nodes):
        row = [Fraction(1)]
        for other in nodes[:k] + nodes[k + 1 :]:
            scale, root = 2 * (node - other), 2 * other - 1
            shifted = [Fraction(0), *row], [*row, Fraction(0)]
            row = [(a - root * b) / scale for a, b in zip(*shifted, strict=True)]
        coefficients.append(row)
    by_power = [tuple(enumerate(column)) for column in zip(*coefficients, strict=True)]
    last = len(nodes) - 1
    # s^d is a multiple of Legendre's polynomial of degree d, and polynomials of degree d - 2, ...
    errors = tuple(
        tuple(Fraction(2**d, comb(2 * d, d)) * weight for _, weight in by_power[d])
        for d in range(last, max(last - 4, -1), -1)
    )
    return MethodPaths(
        (Path(0, tuple(by_power)),), (0,) * len(nodes), 1, nodes, errors=errors,
        factor=Fraction(100), power=1, polynomial=True,
    )  # fmt: skip


class PathBuilder:
    """Builds the paths of a tree without repetitions, leaving out unused points."""

    def __init__(self, tree: PointTree, explicit: bool) -> None:
        self.points = tree.points
        ends = {*tree.stage_points, *tree.results}
        used = {m for end in ends for m in tree.path(end)}
        children = Counter(tree.points[m].parent for m in used)
        self.stored = ends | {point for point in used if children[point] > 1}
        if not explicit:  # iterations repeat the last flow of a stage
            self.stored |= {tree.points[at].parent for at in tree.stage_points}
        self.index = {START: 0}
        self.paths: list[Path] = []

    def path_to(self, point: int) -> int:
        """Return the number of the path to a stored point, adding it and those before it."""
        if point not in self.index:
            links = [point]
            while (parent := self.points[links[-1]].parent) not in self.stored and parent != START:
                links.append(parent)
            origin = self.path_to(parent)
            flows = tuple(tuple(self.points[i].weights.items()) for i in reversed(links))
            self.paths.append(Path(origin, flows))
            self.index[point] = len(self.paths)
        return self.index[point]
