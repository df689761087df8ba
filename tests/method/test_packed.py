"""Methods made of packed coefficients."""

from fractions import Fraction

import pytest
from refusals import refuses

import cg
from cg.method.packed import make_method
from cg.structure.layout import Layout

METHODS = [
    *map(cg.methods.get, ("CG3(2)", "DICG3", "CF4(3)", "CG4a")),
    cg.methods["DOP853"],
    cg.methods["RKMK8(5,3)"],
]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_with_coefficients_gives_the_same_method_back(method):
    third = getattr(method, "third_weights", None)
    fields = {} if third is None else {"third": third}
    again = method.with_coefficients(method.coefficients, **fields)
    assert type(again) is type(method)
    assert again == method
    assert (again.name, again.source) == (method.name, method.source)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_with_coefficients_refuses_a_wrong_length(method):
    for wrong in (method.coefficients[1:], [*method.coefficients, 0], [], "1/2"):
        refuses(ValueError, "x must", method.with_coefficients, wrong)


def test_with_coefficients_takes_fields_of_the_class():
    method = cg.methods["CG2"].with_coefficients(
        ["0.5", "1e-9", 1], name="near", nominal_order=2, nominal_residual="1e-8"
    )
    assert (method.name, method.order, method.approximate) == ("near", 2, True)


def test_make_method_chooses_the_class_by_the_layout():
    points = cg.methods["CF3"]
    assert make_method(points.layout, points.coefficients) == points
    assert isinstance(make_method(Layout.tableau(1), [1]), cg.Tableau)


def test_make_method_rounds_to_digits():
    method = make_method(Layout.tableau(1), [Fraction(2, 3)], digits=5)
    assert method.weights[0].text == "0.66667"
    assert make_method(Layout.tableau(1), [Fraction(2, 3)]).weights[0].text == "2/3"
