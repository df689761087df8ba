"""The statements of certificates: methods as vectors of coefficients, conditions as equations.

The coefficients y of the method, except those that `box` fixes, can be changed by at most
``box.radius`` so that all `conditions` of `orders` hold. The catalogue has a TOML file for each
method with a certificate; whether it fits the method is checked before anything is proved.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import accumulate, pairwise, product
from math import prod
from typing import Any, TypeAlias

from cg.construction.catalogue import find_method
from cg.construction.catalogue.entries import certificate_path
from cg.construction.conditions import MAX_ORDER
from cg.construction.conditions.exact import (
    Condition,
    EquationSystem,
    Word,
    condition_words,
    conditions_of,
    nodes,
)
from cg.construction.conditions.linear_equations import (
    Series,
    exponential,
    nystrom_residuals,
    nystrom_trees,
    nystrom_values,
    product_of_exponentials,
    times,
)
from cg.construction.layouts import Layout
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.proofs.certificate import Box, Certificate, CertificationError
from cg.construction.trees import RootedTree, node_count
from cg.support import flint
from cg.support.checks import check_instance
from cg.support.quads import to_ball

_DRIFTS: Word = ()
"""Stands for the condition Σ d = 1, which has no tree."""

_MAX_PRECISION = 1 << 14


@dataclass(frozen=True)
class PolynomialEquations:
    """Equations by a function of coefficients of any type of numbers."""

    residuals: Callable[[Sequence[Any]], list[Any]]

    def linearise(self, z: Sequence[flint.arb]) -> tuple[list[flint.arb], flint.arb_mat]:
        """Return the residuals and their derivatives by all coefficients."""
        columns = []
        for k in range(len(z)):
            line = [flint.arb_series([x, int(j == k)], prec=2) for j, x in enumerate(z)]
            columns.append([value[1] for value in self.residuals(line)])
        return self.residuals(z), flint.arb_mat(columns).transpose()


Equations = EquationSystem | PolynomialEquations
Linearised: TypeAlias = "tuple[list[flint.arb], flint.arb_mat]"  # flint may be missing
"""Residuals, and their derivatives by all coefficients."""


@dataclass(frozen=True)
class PackedMethod(ABC):
    """A method as a vector of coefficients, with the orders of its results."""

    name: str
    coefficients: tuple[Coefficient, ...]
    orders: tuple[int, ...]

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """The names of the coefficients."""

    @property
    def of_time(self) -> bool:
        """Whether conditions are those of words in powers of the time, as for linear equations."""
        return True

    @property
    def conditions(self) -> list[Condition]:
        """The independent conditions of all rows of weights."""
        return conditions_of(self.orders, self.of_time)

    @abstractmethod
    def equations(self, conditions: Sequence[Condition]) -> Equations:
        """Return conditions as equations."""

    def words(self, order: int) -> list[Word]:
        """Return the words of the independent conditions of one order."""
        words = condition_words(order, True, self.of_time)
        return [word for word in words if nodes(word) == order]

    def spread(self, z: Sequence[Any]) -> Sequence[Any]:
        """Return all coefficients of the method."""
        return z

    def system(self, left_out: Sequence[Condition] = ()) -> Equations:
        """Return the conditions as equations, without those that are left out."""
        omitted = set(left_out)
        return self.equations([c for c in self.conditions if c not in omitted])

    def without(self, linearised: Linearised, left_out: Sequence[Condition]) -> Linearised:
        """Return linearised conditions without those to leave out."""
        omitted, (values, slopes) = set(left_out), linearised
        kept = [k for k, c in enumerate(self.conditions) if c not in omitted]
        rows = slopes.tolist()
        return [values[k] for k in kept], flint.arb_mat([rows[k] for k in kept])

    def balls(self) -> list[flint.arb]:
        """Return balls, as small as the precision allows, that hold the values."""
        return [to_ball(coefficient.value) for coefficient in self.coefficients]

    def movable(self, box: Box) -> list[int]:
        """Return the indices of the coefficients that aren't fixed."""
        fixed = set(box.fixed)
        return [k for k, name in enumerate(self.names) if name not in fixed]

    def enclosure(self, box: Box) -> list[flint.arb]:
        """Return balls that hold the exact solution."""
        y = self.balls()
        radius = to_ball(Fraction(box.radius)).upper()
        for k in self.movable(box):
            y[k] = y[k] + flint.arb(0, radius)
        return y


@dataclass(frozen=True)
class PackedWeights(PackedMethod):
    """A method of stages and flows as its weights, point by point; conditions may be dependent."""

    layout: Layout

    @property
    def names(self) -> list[str]:
        return self.layout.names

    @property
    def of_time(self) -> bool:
        return self.layout.of_time

    def equations(self, conditions: Sequence[Condition]) -> EquationSystem:
        return EquationSystem(self.layout, tuple(conditions))


@dataclass(frozen=True)
class PackedBrackets(PackedMethod):
    """A Magnus method with brackets as its coefficients that aren't zero.

    Conditions are those of Lyndon words in derivatives. The coefficients of words in a product of
    exponentials of Lie elements are polynomials in those of Lyndon words that are not longer
    (Radford's theorem), so that no other conditions are needed.
    """

    method: MagnusMethod

    @property
    def names(self) -> list[str]:
        """Nodes c, the sides u and v of brackets, and weights w, all counted from 1."""
        labels = ["c_"]
        labels += [f"{side}_{j}," for j in range(1, len(self.method.brackets) + 1) for side in "uv"]
        labels += [f"w_{i}," for i in range(1, len(self.method.weights) + 1)]
        second = self.method.embedded_weights or ()
        labels += [f"w_embedded_{i}," for i in range(1, len(second) + 1)]
        return [
            f"{label}{k}"
            for label, row in zip(labels, self.method.rows, strict=True)
            for k, x in enumerate(row, 1)
            if x.value
        ]

    def equations(self, conditions: Sequence[Condition]) -> PolynomialEquations:
        largest = [0, 0]
        for row, word in conditions:
            largest[row] = max(largest[row], nodes(word))

        def residuals(z: Sequence[Any]) -> list[Any]:
            nodes, brackets, *results = self.method.with_numbers(z, z[0] * 0)
            products = [
                product_of_exponentials((nodes, rows, brackets), order)
                for rows, order in zip(results, largest, strict=False)
            ]
            values = []
            for row, word in conditions:
                # the last letter of a word in derivatives is followed first
                degrees = tuple(len(letter) + 1 for letter in reversed(word))
                divisor = prod(accumulate(reversed(degrees)))
                values.append(products[row].get(degrees, 0) - (z[0] * 0 + 1) / divisor)
            return values

        return PolynomialEquations(residuals)


@dataclass(frozen=True)
class PackedSplitting(PackedMethod):
    r"""A splitting method as the coefficients on which its other coefficients depend.

    These are the first half of a symmetric method; of a composition of leapfrog those of its inner
    row, as the outer row has the means of its neighbours.

    The logarithm of a step is a series in the Lie algebra of T and V, graded by the
    number of letters. Let :math:`T + V + L_q + \dots` be that of a method of order q - 1. Then the
    residual of a tree with q nodes is a linear function of :math:`L_q`, a combination of brackets
    of q letters, and all of them vanish if those of a basis do. In a symmetric step the even terms
    of the logarithm are zero, so that conditions of odd orders suffice, and half of the
    coefficients are unknowns.

    A composition of n steps :math:`\gamma_i h` of leapfrog has more relations: it is
    :math:`\prod_i \exp(\gamma_i Y_1 + \gamma_i^3 Y_3 + \gamma_i^5 Y_5 + \dots)` with unknowns γ.
    The coefficient of a word in the letters Y is a polynomial in those of Lyndon words that are not
    longer (Radford's theorem), so that these are the conditions [1]_.

    References
    ----------
    .. [1] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., Springer,
       2006, section III.3.3.
    """

    size: int  # number of coefficients, of the inner row alone in a composition
    indices: tuple[int, ...]  # places of the coefficients in a step
    symmetric: bool
    inner: int | None  # the row of γ if this is a composition: 0 for drifts, 1 for kicks

    @classmethod
    def of(cls, method: Splitting, orders: Sequence[int]) -> PackedSplitting:
        """Pack a splitting method."""
        values = [x.value for x in method.coefficients]
        symmetric, inner, indices = values == values[::-1], None, range(len(values))
        for row, inside in enumerate((range(2, len(values) - 1, 2), range(1, len(values), 2))):
            if inside and values == _composed([values[k] for k in inside], row):
                inner, indices = row, inside
                break
        size = len(indices)
        if symmetric:
            indices = indices[: (len(indices) + 1) // 2]
        packed = tuple(method.coefficients[k] for k in indices)
        return cls(method.name, packed, tuple(orders), size, tuple(indices), symmetric, inner)

    @property
    def names(self) -> list[str]:
        return [f"{'dk'[k % 2]}_{k // 2}" for k in self.indices]

    @property
    def conditions(self) -> list[Condition]:
        (order,) = self.orders
        grades = range(1, order + 1, 2 if self.symmetric else 1)
        if self.inner is None:
            words = [_DRIFTS, *((tree,) for q in grades for tree in independent_trees(q))]
        else:
            words = [word for word in _words_of_odd_letters(order) if nodes(word) in grades]
        return [Condition(0, word) for word in words]

    def equations(self, conditions: Sequence[Condition]) -> PolynomialEquations:
        largest = max(nodes(word) for _, word in conditions)
        composed = self.inner is not None and largest <= self.orders[0]  # otherwise trees beyond
        trees = [_DRIFTS, *((tree,) for tree in nystrom_trees(largest))]

        def residuals(z: Sequence[Any]) -> list[Any]:
            if composed:
                residual_of = _composition_residuals(self._mirrored(z), largest)
            else:
                steps = self.spread(z)
                values = nystrom_residuals(steps[::2], steps[1::2], largest)
                residual_of = dict(zip(trees, values, strict=True))
            return [residual_of[word] for _, word in conditions]

        return PolynomialEquations(residuals)

    def words(self, order: int) -> list[Word]:
        return [(tree,) for tree in nystrom_trees(order) if node_count(tree) == order]

    def spread(self, z: Sequence[Any]) -> list[Any]:
        row = self._mirrored(z)
        return row if self.inner is None else _composed(row, self.inner)

    def _mirrored(self, z: Sequence[Any]) -> list[Any]:
        return [*z, *z[: self.size - len(z)][::-1]]


def _composed(row: Sequence[Any], inner: int) -> list[Any]:
    """Return the coefficients in the order of a step, of a composition of leapfrog.

    The inner row is that of drifts (0) or kicks (1).
    """
    zero = [row[0] * 0] if row else []
    outer = [(x + y) / 2 for x, y in pairwise([*zero, *row, *zero])]
    steps = [x for pair in zip(outer, [*row, *zero], strict=True) for x in pair][:-1]
    return steps if inner else [*zero, *steps, *zero]


def _composition_residuals(gammas: Iterable[Any], order: int) -> dict[Word, Any]:
    """Return the coefficients of Lyndon words in Y, less those in exp(Y_1)."""
    total: Series = {(): 1}
    for gamma in gammas:
        letters: Series = {(j,): gamma**j for j in range(1, order + 1, 2)}
        total = times(exponential(letters, order), total, order)
    return {
        word: total[tuple(len(letter) + 1 for letter in word)] - (nodes(word) == 1)
        for word in _words_of_odd_letters(order)
    }


@cache
def _words_of_odd_letters(order: int) -> tuple[Word, ...]:
    """Return the Lyndon words in Y_1, Y_3, … of degrees 1 to `order`; Y_j is a tree of j nodes."""
    every = condition_words(order, independent=True, of_time=True)
    return tuple(word for word in every if all(len(letter) % 2 == 0 for letter in word))


@cache
def independent_trees(q: int) -> tuple[RootedTree, ...]:
    """Return trees with q nodes on whose residuals those of all trees with q nodes depend.

    Values of trees with q nodes are linear functions of the terms of q letters in the logarithm of
    a step whose other terms have more. These are spanned by brackets of T or V with brackets, for
    each of which a commutator of flows is such a step.
    """
    trees = [tree for tree in nystrom_trees(q) if node_count(tree) == q]
    steps = map(_commutator, product((0, 1), repeat=q))
    rows = [nystrom_values(*step, q)[-len(trees) :] for step in steps]
    reduced, rank = flint.fmpq_mat(rows).rref()
    entries = reduced.tolist()
    pivots = [next(k for k, x in enumerate(entries[i]) if x != 0) for i in range(rank)]
    return tuple(trees[k] for k in pivots)


def _commutator(letters: Sequence[int]) -> tuple[list[int], list[int]]:
    """Return drifts and kicks of the nested commutator of the flows of T (0) and V (1)."""
    steps = [(letters[0], 1)]
    for letter in letters[1:]:
        back = [(flow, -sign) for flow, sign in reversed(steps)]
        steps = [*steps, (letter, 1), *back, (letter, -1)]
    drifts = [sign * (flow == 0) for flow, sign in steps]
    return [*drifts, 0], [sign * (flow == 1) for flow, sign in steps]


def pack(method: Method, orders: Sequence[int]) -> PackedMethod:
    """Pack a method, with its second result if it is a pair."""
    if isinstance(method, Splitting):
        return PackedSplitting.of(method, orders)
    if isinstance(method, MagnusMethod) and method.brackets:
        return PackedBrackets(method.name, method.coefficients, tuple(orders), method)
    return PackedWeights(method.name, method.coefficients, tuple(orders), method.layout)


def fitting(certificate: Certificate, method: Method) -> PackedMethod:
    """Return the packed method; raise CertificationError if the certificate is for another one."""
    if isinstance(method, MuntheKaas):
        raise CertificationError(
            f"the certificate doesn't fit: method must not be a Munthe-Kaas method, got {method!r}"
        )
    pair = certificate.embedded_order is not None
    faults = []
    if certificate.name != method.name:
        faults.append(f"it is for {certificate.name!r}, not for {method.name!r}")
    if pair != (method.embedded is not None):
        faults.append("second weights must be proved, and those of pairs only")
    orders = certificate.orders
    if not all(type(order) is int and 1 <= order <= MAX_ORDER for order in orders):
        faults.append(f"orders must be between 1 and {MAX_ORDER}")
    if not 53 <= certificate.bits <= _MAX_PRECISION:
        faults.append(f"bits must be between 53 and {_MAX_PRECISION}, got {certificate.bits}")
    if faults:
        raise CertificationError(f"the certificate doesn't fit: {'; '.join(faults)}")
    packed = pack(method, orders)
    left_out = set(certificate.left_out)
    bounded = isinstance(packed, PackedWeights) or certificate.bound is not None
    allowed = packed.conditions if bounded else []
    if len(left_out) != len(certificate.left_out) or not left_out.issubset(allowed):
        raise CertificationError(
            "conditions that are left out must be distinct independent ones of these orders"
        )
    names = packed.names
    fixed = set(certificate.fixed)
    if len(fixed) != len(certificate.fixed) or not fixed.issubset(names):
        raise CertificationError("the fixed coefficients must be distinct ones of the method")
    if certificate.radius == 0 and (len(fixed) != len(names) or left_out):
        raise CertificationError(
            "a radius of 0 needs all coefficients fixed and no condition left out"
        )
    for name, coefficient in zip(names, packed.coefficients, strict=True):
        if coefficient.value == 0 and name not in fixed:
            raise CertificationError(f"{name} is exactly zero, so it must be fixed")
    return packed


def folder() -> Traversable:
    """Return the folder of the certificates."""
    return files("cg.construction.catalogue") / "certificates"


def certificate_names() -> list[str]:
    """Return the names of the methods that have certificates."""
    names = [path.name for path in folder().iterdir()]
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def certificate_of(method: Method) -> Certificate:
    """Return the certificate in the catalogue or beside the method's file, unchecked."""
    check_instance("method", method, Method)
    name = method.name
    if find_method(name) != method:
        if (beside := certificate_beside(method)) is not None:
            return beside
        raise CertificationError(
            f"{name or 'the method'} isn't in the catalogue"
            f"{', and no certificate lies beside its file' * (method.file is not None)}: "
            "pass certificate=cg.certify(method)"
        )
    path = folder() / f"{name}.toml"
    if not path.is_file():
        raise CertificationError(f"{name} has no certificate")
    return Certificate.loads(path.read_text(encoding="utf-8"))


def proved(method: Method) -> str:
    """Return how much of a method's order its certificate proves.

    ``"yes"``, ``"in part"`` or ``"no"``; ``"classical"`` for Munthe-Kaas methods.
    """
    if isinstance(method, MuntheKaas):
        return "classical"
    try:
        return certificate_of(method).proved
    except CertificationError:
        return "no"


def certificate_beside(method: Method) -> Certificate | None:
    """Return the certificate beside the file of a method, or None; `check` proves it."""
    path = None if method.file is None else certificate_path(method.file)
    if path is None or not path.is_file():
        return None
    certificate = Certificate.load(path)
    fitting(certificate, method)
    return certificate
