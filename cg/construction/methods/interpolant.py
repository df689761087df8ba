r"""The solution between steps, on the manifold and as accurate as the steps.

On a frame with brackets the coordinates of a step from :math:`y_0` to :math:`y_1`, :math:`y(\theta)
= \exp(u(\theta))\, y_0`, are a polynomial in derivatives :math:`k_j` of coordinates,

.. math::

    u(\theta) = h \sum_d \varphi_d(\theta) \sum_j B_{jd} k_j, \qquad
    \varphi_d = \theta,\ \theta (1 - \theta),\ \theta^2 (1 - \theta),\ \theta^2 (1 - \theta)^2,
    \dots

whose first three terms are the cubic of Hermite. One flow reaches a point. Further derivatives
:math:`k_j = \operatorname{dexp}^{-1}_{u(\theta_j)} f(t_0 + \theta_j h, y(\theta_j))` are evaluated
at nodes on an interpolant of lower order, until the order is reached (bootstrapping: W. H. Enright,
K. R. Jackson, S. P. Nørsett, P. G. Thomsen, "Interpolants for Runge–Kutta formulas", ACM TOMS 12
(1986)). There are three kinds, linear in the unknown :math:`B`:

- Interpolants of a Munthe-Kaas method use its stages. The conditions are those of rooted trees t,
  :math:`\sum_j b_j(\theta) \Phi_j(t) = \theta^{|t|} / \gamma(t)`, through the order of the method;
  of all solutions the one of least norm is taken.
- The interpolant of a collocation method is the collocation polynomial, of the order of its stages,
  since further evaluations would not help where an equation is stiff.
- Interpolants of other methods use the ends alone: :math:`u(1)` is found by Newton's method. Their
  conditions are those of quadrature, :math:`\sum_j b_j(\theta) \theta_j^{k-1} = \theta^k / k`.

On a frame without brackets, and where a step of the second kind is too long for coordinates, the
coefficients :math:`F(\theta) = f(t_0 + \theta h, y(\theta))` are interpolated at nodes :math:`0 =
\theta_1 < \dots < \theta_n = 1` by a polynomial :math:`P`. The solution of :math:`y' = h \sum_i
P_i(\theta) E_i(y)` is then a problem whose right side depends on time alone: the method itself
solves it, to its own order, by the flows to its result, without evaluations of ``f``,

.. math::

    z(\theta) = \prod_m \exp\Bigl(\theta h \sum_k \alpha_{m,k} P(c_k \theta)\Bigr) y_0 ,

and one more flow moves the end to :math:`y_1`,

.. math::

    y(\theta) = e^{w(\theta) v} z(\theta), \qquad e^v z(1) = y_1, \qquad
    w(\theta) = \int_0^\theta \omega \Big/ \int_0^1 \omega, \qquad
    \omega(\theta) = \prod_j (\theta - \theta_j) .

The polynomial is off by :math:`\omega` times a constant up to higher order, and so is its integral
by that of :math:`\omega`; the last flow removes this error and doesn't change derivatives
at nodes. The error is :math:`O(h^{n+2})`. Only flows and differences of nearby points are
needed, so that it works on every frame. Where the fields don't span all directions there may be no
such :math:`v`, since :math:`y_1` is off by the error of the step; :math:`v` is then that of the
tangent nearest to :math:`y_1 - z(1)`, which removes the error in leading order, a combination of
fields. The end of the interpolant differs from :math:`y_1` by an error of the order of the step's.

With n nodes interpolants of the last two kinds have order n + 1, after n - 2 nodes for each order
from four on. They have n = p - 1 nodes for a method of order p, and from order four on one more
where a method has as many stages as this takes evaluations, so that the error within a step is
about that at its ends.

The coefficients of splitting methods are forces. Kicks by :math:`P` and drifts, which are exact,
lead to :math:`z`; without forces there is no other error than rounding. Forces depend on the
position alone, whose error is one order smaller, so that nodes are added two at a time. From order
three on there are p + 1 nodes, and one more where a method has as many stages as this takes
evaluations.

The nodes are those of Lobatto's formula with one node more, without the one in the middle: that
is the node at which the integral condition interpolates the derivative implicitly, so that the
error between the nodes is that of Lobatto's points.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache
from itertools import chain, count
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.methods.paths import MethodPaths, collocation_polynomial
from cg.construction.methods.splitting import Splitting
from cg.construction.trees import density, node_count, rooted_trees_through
from cg.support.arrays import Array
from cg.support.caches import cached_by_identity
from cg.tables import basis_polynomials, stored_table
from cg.tables.table import InterpolantScheme

# Nodes of interpolants that use the stages of a method, in this order. A search over grids chose
# them for small errors and weights of the interpolants of orders 4 to 8.
_NODES = (0.85, 0.15, 0.25, 0.6, 0.05, 0.7, 0.2, 0.35, 0.45, 0.4)
_MAX_NODES = 60
_SOLVED = 1e-10  # residuals below are rounding
_NO_RANK = 1e-11  # singular values below this part of the largest are rounding
_NO_WEIGHT = 1e-8  # weights below this part of the largest are rounding
# Methods whose flows interpolants of methods with brackets use, in increasing order.
_WITH_FLOWS = "CG2", "CFM4", "CFM6(4)", "CFM8(4)"


@cache
def nodes_of(count: int) -> tuple[Array, Polynomial]:
    """Return ``count`` nodes within a step, at least 2, from 0 to 1, and the polynomial w."""
    inner = np.sort(np.real(Legendre.basis(count).deriv().roots()))
    lobatto = np.concatenate([[0.0], 0.5 * (inner + 1.0), [1.0]])
    nodes = np.delete(lobatto, (count + 1) // 2)
    integral = Polynomial.fromroots(nodes).integ()
    return nodes, integral / integral(1.0)


def scheme_of(method: Method, paths: MethodPaths) -> InterpolantScheme:
    """Return how points between steps of a method are computed."""
    extension, polynomial = extension_of(method), paths.polynomial
    nodes = (method.stages, paths.abscissae) if polynomial else (inner_nodes(method), None)
    node, blend = _node_tables(*nodes)
    flows, series = _result_flows(method, paths), inner_nodes(method) + 1
    if isinstance(method, MuntheKaas):
        series = max(method.advancing_method.order, 1)
    return InterpolantScheme(extension.final + 1, series, *extension[1:], node, blend, *flows)


def _node_tables(nodes: int, stages: Array | None) -> tuple[Array, Array]:
    """Return the nodes and the last flows' polynomials of interpolants with 2, ..., n nodes.

    With nodes at given stages there is one interpolant.
    """
    node, blend = np.zeros((nodes, nodes - 1)), np.zeros((nodes + 2, nodes - 1))
    if stages is not None:
        node[:, -1] = stages
        return node, blend
    for size in range(2, nodes + 1):
        node[:size, size - 2], last = nodes_of(size)
        blend[: size + 2, size - 2] = last.coef
    return node, blend


def inner_nodes(method: Method) -> int:
    """Return the number of nodes with which interpolants without stages are accurate enough."""
    step, enough = 1, max(2, method.order - 1, (method.embedded_order or 0) - 1)
    if isinstance(method, Splitting):
        step, enough = 2, method.order + 1 if method.order > 2 else 2
    return enough + (enough > 2 and evaluations_of_nodes(enough + 1, step) <= method.stages)


def evaluations_of_nodes(nodes: int, step: int) -> int:
    """Return the number of evaluations at inner nodes, ``step`` of which are added at a time."""
    return sum(range(nodes - 2, 0, -step))


class Extension(NamedTuple):
    """Coordinates within a step as combinations of their derivatives, see `InterpolantScheme`."""

    final: int  # from 0
    theta: Array
    rows: Array
    basis: Array


@cached_by_identity
def extension_of(method: Method) -> Extension:
    """Return the interpolant in coordinates for steps of a method."""
    if isinstance(method, MuntheKaas) and not method.explicit:
        powers = collocation_polynomial(method.c[1:])
        basis = _powers(len(powers)).T @ powers
        return _extension(len(powers), [], [], np.pad(basis, ((0, 0), (1, 0))))
    if isinstance(method, MuntheKaas):
        return _with_stages(method.advancing_method)
    return _between_ends(inner_nodes(method))


def _with_stages(method: MuntheKaas) -> Extension:
    """Return the interpolant that uses the stages of a Munthe-Kaas method."""
    order = max(method.order, 3)
    trees = _Trees(order)
    a, b, c = method.a, method.b, method.c
    rows = list(a)
    if not (c[-1] == 1.0 and np.array_equal(a[-1], b)):
        rows.append(b)
    final = len(rows) - 1
    weights: Array = np.zeros((len(trees.size), 0))
    for row in rows:
        weights = trees.with_stage(weights, row)
    result = np.pad(b, (0, len(rows) - len(b)))
    # Conditions hold up to the rounding of the tableau itself.
    lower = trees.size <= method.order
    rounding = np.abs(weights @ result - 1.0 / trees.density)[lower].max(initial=0.0)
    theta: list[float] = []
    further = (0.05 + 0.9 * math.modf(k * (math.sqrt(5.0) - 1.0) / 2.0)[0] for k in count(1))
    reached, nodes = 3, chain(_NODES, further)
    basis = _hermite(result, final)
    while True:
        while reached < order:
            higher = trees.size <= reached + 1
            targets = _powers(reached + 1)[trees.size[higher] - 1] / trees.density[higher, None]
            higher_basis, residual = _solve(
                weights[higher], targets, np.pad(result, (0, len(theta))), final
            )
            if residual > _SOLVED + 10.0 * rounding:
                break
            reached, basis = reached + 1, higher_basis
        if reached == order or len(theta) == _MAX_NODES:
            break
        theta.append(next(nodes))
        row = _values(len(basis), theta[-1]) @ basis
        rows.append(row)
        weights = trees.with_stage(weights, row)
    return _extension(final, theta, rows[len(rows) - len(theta) :], basis)


def _between_ends(nodes: int) -> Extension:
    """Return the interpolant that uses the ends of a step and their difference."""
    mean, final = 1, 2
    weights = np.eye(3)[mean]
    basis = _hermite(weights, final)
    theta: list[float] = []
    rows: list[Array] = []
    for level in range(3, nodes + 1):
        inner = nodes_of(level)[0][1:-1]
        theta += inner.tolist()
        rows += [_values(len(basis), node) @ basis for node in inner.tolist()]
        k = np.arange(1, level + 2)[:, None]
        derivatives = np.zeros((level + 1, 3 + len(theta)))
        derivatives[0, 0] = 1.0
        derivatives[:, mean : mean + 1] = 1.0 / k
        derivatives[:, final] = 1.0
        derivatives[:, -len(inner) :] = inner ** (k - 1)
        weights = np.pad(weights, (0, len(inner)))
        basis, _ = _solve(derivatives, _powers(level + 1) / k, weights, final)
    return _extension(final, theta, rows, basis)


def _extension(final: int, theta: list[float], rows: list[Array], basis: Array) -> Extension:
    """Return the interpolant with weights of as many derivatives in all rows."""
    width = basis.shape[1] if not rows else max(basis.shape[1], len(rows[-1]) + 1)
    padded = [np.pad(row, (0, width - len(row))) for row in rows]
    basis = np.pad(basis, ((0, 0), (0, width - basis.shape[1])))
    return Extension(final, np.array(theta), np.array(padded).reshape(-1, width), basis)


class _Trees:
    """The conditions of rooted trees on derivatives k, for interpolants through an order."""

    def __init__(self, order: int) -> None:
        trees = rooted_trees_through(order)
        indices = {tree: i for i, tree in enumerate(trees)}
        self.children = [[indices[child] for child in tree] for tree in trees]
        self.size = np.array(list(map(node_count, trees)))
        self.density = np.array(list(map(density, trees)), dtype=np.float64)

    def with_stage(self, weights: Array, row: Array) -> Array:
        """Return the elementary weights of n + 1 derivatives, shape ``(trees, n + 1)``.

        The last derivative is evaluated at the coordinates with weights ``row``.
        """
        k = min(weights.shape[1], len(row))
        ends = weights[:, :k] @ row[:k]
        new = [math.prod(ends[children].tolist()) for children in self.children]
        return np.column_stack([weights, new])


def _values(degree: int, theta: float) -> Array:
    return np.array([p(theta) for p in basis_polynomials(degree)])


@cache
def _powers(degree: int) -> Array:
    """Return the coefficients of θ, θ², … in terms of φ: integers, shape ``(degree, degree)``."""
    matrix = np.zeros((degree, degree))
    for d, p in enumerate(basis_polynomials(degree)):
        matrix[d, : d + 1] = p.coef[1 : d + 2]
    return np.round(np.linalg.inv(matrix))


def _hermite(result: Array, final: int) -> Array:
    """Return the cubic by the mean of a step and the derivatives at its ends, shape ``(3, n)``."""
    first, last = np.eye(len(result))[[0, final]]
    return np.stack([result, first - result, 2.0 * result - first - last])


def _solve(matrix: Array, targets: Array, result: Array, final: int) -> tuple[Array, float]:
    """Return the coefficients of least norm beyond the cubic of Hermite, and the residual."""
    basis = _hermite(result, final)
    if len(targets.T) > 3:
        further = _minimum_norm(matrix, targets[:, 3:])
        # weights that are only rounding are set to zero
        used = np.abs(further).max(axis=1) > _NO_WEIGHT * np.abs(further).max()
        further[used] = _minimum_norm(matrix[:, used], targets[:, 3:])
        further[~used] = 0.0
        basis = np.concatenate([basis, further.T])
    return basis, float(np.abs(matrix @ basis.T - targets).max())


def _minimum_norm(matrix: Array, targets: Array) -> Array:
    solution = np.linalg.lstsq(matrix, targets, rcond=_NO_RANK)[0]
    return solution + np.linalg.lstsq(matrix, targets - matrix @ solution, rcond=_NO_RANK)[0]


def _result_flows(method: Method, paths: MethodPaths) -> tuple[Array, Array]:
    """Return the flows to the result of a method, for fields that depend on time only.

    They are the abscissae of the stages that the flows use, and their weights in the flows, shape
    ``(flows, stages)``. A method with brackets takes the flows of a method without them.
    """
    if paths.brackets:
        tables = map(stored_table, _WITH_FLOWS)
        fitting = (table for table in tables if table.order >= method.order)
        output = next(fitting, stored_table(_WITH_FLOWS[-1])).output
        return output.flow_c, output.flow_weights
    flows: list[dict[int, Fraction]] = []
    k = paths.result
    while k:
        path = paths.paths[k - 1]
        flows = [*map(dict, path.flows), *flows]
        k = path.origin
    used = sorted({stage for flow in flows for stage in flow})
    weights = [[float(flow.get(k, 0)) for k in used] for flow in flows]
    return paths.abscissae[used], np.array(weights)
