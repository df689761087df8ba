"""Magnus methods: conditions, orders, coefficients, files, bad input."""

from fractions import Fraction

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.conditions.linear_equations import linear_residuals, words
from cg.construction.layouts.points import MethodError
from cg.construction.methods.magnus import MagnusMethod

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
    assert method.largest_residual() < 1e-34
    assert method.principal_error > 1e-6
    assert not method.satisfies(method.order + 1)


@pytest.mark.parametrize("name", ["CFM4", "CFM6(4)b", "CFM8(4)"])
def test_symmetric_methods_read_backwards_are_themselves(name):
    method = cg.methods[name]
    rows = [[a.value for a in row] for row in method.weights]
    for row, other in zip(rows, reversed(rows), strict=True):
        assert row == other[::-1]


def test_a_changed_coefficient_is_another_method_of_lower_order():
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
def test_bad_coefficients_are_refused(arguments, message):
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
