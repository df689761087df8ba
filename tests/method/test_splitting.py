"""Splitting and Magnus methods: conditions, orders, coefficients, refusals."""

import re
from fractions import Fraction

import numpy as np
import pytest
from exact import splitting_residuals
from refusals import refuses

import cg
from cg.construction.conditions import linear_equations as ny
from cg.construction.conditions.linear_equations import linear_residuals, words
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.points import MethodError

# order, kicks, drifts
KNOWN = {
    "Leapfrog": (2, 2, 1), "McLachlan2": (2, 2, 3), "BlanesMoan4": (4, 7, 6),
    "BlanesMoan6": (6, 12, 11), "BlanesCasas8": (8, 18, 17),
}  # fmt: skip


def independent(values, order, symmetric):
    """Return the rank of the derivatives of values at random drifts and kicks."""
    size = 81
    half = np.random.default_rng(order).normal(0, 0.3, (size + 1) // 2)
    x = np.concatenate([half, half[-2::-1]]) if symmetric else np.tile(half, 2)[:size]
    moved = np.eye(size)
    if symmetric:
        moved = (moved + moved[::-1])[: (size + 1) // 2]
    columns = list((x + 1e-30j * moved).T)
    jacobian = np.array(values(columns[::2], columns[1::2], order)).imag / 1e-30
    scaled = jacobian / np.linalg.norm(jacobian, axis=1, keepdims=True)
    return np.linalg.matrix_rank(scaled, tol=1e-9)


def test_numbers_of_conditions():
    sizes = [len(ny.nystrom_trees(order)) for order in range(1, 11)]
    assert np.diff([0, *sizes]).tolist() == [1, 1, 2, 3, 6, 10, 20, 36, 72, 137]

    def ranks(values, orders, symmetric=False):
        found = [independent(values, order, symmetric) for order in orders]
        return np.diff([0, *found]).tolist()

    assert ranks(ny.nystrom_values, range(1, 9)) == [2, 1, 2, 2, 4, 5, 10, 14]
    assert ranks(ny.nystrom_values, range(1, 9), True) == [2, 0, 2, 0, 4, 0, 10, 0]


def test_residuals_of_leapfrog():
    trees = dict(
        zip(["sum", *ny.nystrom_trees(3)], cg.methods["Leapfrog"].residuals(3), strict=True)
    )
    errors = {tree: residual for tree, residual in trees.items() if residual}
    assert errors == {(((),),): Fraction(1, 12), ((), ()): Fraction(1, 6)}


@pytest.mark.parametrize("name", KNOWN)
def test_orders_kicks_and_drifts(name):
    method = cg.methods[name]
    assert isinstance(method, cg.Splitting)
    assert (method.order, method.stages, method.exponentials) == KNOWN[name]
    assert method.symmetric
    assert method.max_residual() < 1e-34
    assert method.principal_error > 1e-6
    assert not method.satisfies(method.order + 1)


def test_an_order_that_needs_the_kinetic_energy_has_words_that_fail():
    method = cg.methods["BlanesMoan6"]
    residuals = splitting_residuals(method.drifts, method.kicks, 6)
    wrong = {w for w, r in residuals.items() if abs(r) > 1e-12}
    assert {len(word) for word in wrong} == {5, 6}
    assert (0, 1, 1, 1, 1) in wrong  # condition of [V, [V, [V, [V, T]]]], which is zero
    assert cg.Splitting(method.kicks, method.drifts[1:-1]).order == 4  # T and V exchanged


@pytest.mark.parametrize(("name", "order"), [("DICG4", 4), ("DICG4c", 4), ("DICG6", 6)])
def test_composed_leapfrogs_have_their_order_for_all_flows(name, order):
    gammas = cg.methods[name].b  # lengths of midpoint steps
    kicks = (np.append(gammas, 0) + np.append(0, gammas)) / 2
    method = cg.Splitting([0, *gammas, 0], kicks)
    assert method.order == order
    assert max(map(abs, splitting_residuals(method.drifts, method.kicks, order).values())) < 1e-13


def test_mclachlans_drift_minimises_the_error():
    xi = cg.methods["McLachlan2"].drift_coefficients[0].value

    def error(x):  # [T, [T, V]] and [V, [T, V]] are the only ones with these words
        by_word = splitting_residuals([x, 1 - 2 * x, x], [Fraction(1, 2)] * 2, 3)
        return by_word[0, 0, 1] ** 2 + by_word[0, 1, 1] ** 2

    h = Fraction(1, 10**12)
    assert abs(error(xi + h) - error(xi - h)) < 1e-35 < error(xi + h) - error(xi)


def test_packed_coefficients_give_back_an_equal_method():
    method = cg.methods["BlanesMoan6"]
    assert method.with_coefficients(method.coefficients) == method


def test_a_changed_coefficient_is_another_method_of_lower_order():
    method = cg.methods["BlanesMoan4"]
    kicks = [k.value for k in method.kick_coefficients]
    changed = cg.Splitting(method.drift_coefficients, [kicks[0] + Fraction(1, 10**30), *kicks[1:]])
    assert (changed.order, changed.symmetric, changed == method) == (0, False, False)
    assert cg.Splitting([1, 0], [1]).order == 1


def test_rounded_coefficients_have_the_order_within_their_uncertainty():
    exact = cg.methods["BlanesMoan6"]
    method = cg.Splitting(exact.drifts, exact.kicks)
    assert method.order == 6
    assert 1e-18 < method.max_residual() < method.tolerance(6).max() < 1e-13
    residuals = ny.nystrom_residuals(method.drifts, method.kicks, 6)
    np.testing.assert_allclose(residuals, np.array(method.residuals(6), float), atol=1e-15)


@pytest.mark.parametrize(("drifts", "kicks", "message"), [
    ([1], [], "kicks must have at least one entry, got none"),
    ([0, 1], ["1/2", "1/2"], "drifts must have 3 entries, got 2"),
    ([0, "one", 0], [1, 0], "drifts[1]: expected a finite real number, got 'one'"),
    ([0, 1], [float("nan")], "kicks[0]: expected a finite real number, got nan"),
    (3, [1], "drifts must be a sequence of numbers, got 3"),
])  # fmt: skip
def test_bad_coefficients_are_refused(drifts, kicks, message):
    refuses(MethodError, re.escape(message), cg.Splitting, drifts, kicks)


ORDERS = {
    "CFM4": (4, None, None, 2, 2, 3), "CFM6(4)": (6, 4, 2, 4, 7, 5), "CFM6(4)b": (6, 4, 2, 6, 9, 5),
    "CFM8(4)": (8, 4, 2, 8, 11, 5), "Magnus8(4)": (8, 4, 2, 1, 1, 5),
}  # fmt: skip
"""Orders of the three results, flows without and with the estimate, evaluations."""


def test_residuals_of_the_midpoint_rule():
    actual = linear_residuals(([Fraction(1, 2)], [[Fraction(1)]], []), 3)
    residuals = dict(zip(words(3), actual, strict=True))
    assert all(abs(residuals[word]) < 1e-60 for word in [(1,), (1, 1), (2,), (1, 1, 1)])
    # its coefficients are 1/4 for A_3 and for both words of A_1 and A_2
    for word, coefficient in {(3,): "1/3", (1, 2): "1/6", (2, 1): "1/3"}.items():
        assert float(residuals[word]) == pytest.approx(0.25 - float(Fraction(coefficient)))


@pytest.mark.parametrize("name", ORDERS)
def test_orders_flows_and_evaluations(name):
    method = cg.methods[name]
    orders = method.order, method.embedded_order, method.third_order
    assert (*orders, method.exponentials, method.pair_exponentials, method.stages) == ORDERS[name]
    assert method.max_residual() < 1e-34
    assert method.principal_error > 1e-6
    assert not method.satisfies(method.order + 1)


@pytest.mark.parametrize("name", ["CFM4", "CFM6(4)b", "CFM8(4)"])
def test_symmetric_methods_read_backwards_are_themselves(name):
    method = cg.methods[name]
    rows = [[a.value for a in row] for row in method.weights]
    for row, other in zip(rows, reversed(rows), strict=True):
        assert row == other[::-1]


def test_a_changed_weight_is_another_method_of_lower_order():
    method = cg.methods["CFM6(4)"]
    weights = [[a.value for a in row] for row in method.weights]
    weights[0][0] += Fraction(1, 10**30)
    changed = MagnusMethod(method.nodes, weights)
    assert changed != method
    assert changed.order == 0


@pytest.mark.parametrize(("arguments", "message"), [
    (([], [[1]]), r"nodes must have at least one entry"),
    ((["1/2"], []), r"weights must have at least one row"),
    ((["1/2"], [[1, 2]]), r"weights\[0\] must have 1 entries, got 2"),
    ((["half"], [[1]]), r"nodes\[0\]: expected a finite real number, got 'half'"),
    ((["1/2"], [["nan"]]), r"weights\[0\]\[0\]: expected a finite real number"),
    ((["1/2"], 3), r"weights must be a sequence of rows, got 3"),
    (("1/2", [[1]]), r"nodes must be a sequence of numbers, got '1/2'"),
    ((["1/2"], [[1]], [[]]), r"embedded\[0\] must have 1 entries"),
    ((["1/2"], [[1]], [[1]], [1, 2]), r"third must have 1 entries"),
    ((["1/2"], [[1]], None, [1]), r"third must be None unless there is a second result"),
    ((["1/2"], [[1]], [[1]], [1], 0), r"third_factor must be positive, got 0"),
    ((["1/2"], [[1]], None, None, 1, [[[1]]]), r"brackets\[0\] must have two rows, got 1"),
    ((["1/2"], [[1]], None, None, 1, [[[1], [1]]]), r"weights\[0\] must have 2 entries"),
    ((["1/2"], [[1, 0]], None, None, 1, [[[1], [1, 2]]]), r"brackets\[0\]\[1\] must have 1"),
])  # fmt: skip
def test_bad_weights_are_refused(arguments, message):
    options = dict(zip(("third", "third_factor", "brackets"), arguments[3:], strict=False))
    refuses(MethodError, message, MagnusMethod, *arguments[:3], **options)


def test_order_eight_is_the_method_that_hofstaetter_published_at_gauss_nodes():
    """His CF8: four of eight symmetric flows, compared along Legendre polynomials."""
    published = np.array([
        [0.184808462624313039, -0.0207206621202004201, 0.00502711867953985525,
         -0.00102882825365674947],
        [-0.0234494788701189042, 0.42125900994862326, -0.0474878986332597661,
         0.00904478813619618483],
        [0.0446203609236170079, -0.212369356865717369, 0.569989517802253966,
         0.00602984678266997385],
        [-0.0493752515735367770, 0.232989476865882554, -0.622614628245849008,
         0.00327752279924315371],
    ])  # fmt: skip
    method = cg.methods["CFM8(4)"]
    path = method.tree.path(method.result)
    ours = [[float(method.points[m].weights.get(k, 0)) for k in range(5)] for m in path[:4]]
    nodes, _ = np.polynomial.legendre.leggauss(4)
    for degree in range(4):
        polynomial = np.polynomial.legendre.Legendre.basis(degree)
        there = published @ polynomial(nodes)
        assert np.abs(ours @ polynomial(2 * method.c - 1) - there).max() < 1e-15
