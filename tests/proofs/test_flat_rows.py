"""Proofs of methods that are a flat tableau's, split into flows."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq, fmpq_mat

import cg
from cg.proofs import CertificationError, certify, check
from cg.proofs.dependent.flat_rows import FlatRows
from cg.proofs.dependent.words import reciprocal_density
from cg.proofs.weights import Quantity, Weights

pytestmark = pytest.mark.no_core

METHOD = cg.methods["DP5(4)"]
ORDERS = [5, 4]


def flat_rows(x):
    return FlatRows(METHOD.layout, ORDERS, x)


@pytest.fixture(scope="module")
def values():
    return [coefficient.value for coefficient in METHOD.coefficients]


def moved_along(values, seed):
    """Return other weights with the same sums along all ways."""
    sums = [inside(term.weights[0]) for one in flat_rows(values).equations() for term in one.terms]
    reduced, rank = fmpq_mat(sums).rref()
    entries = reduced.tolist()[:rank]
    pivots = [next(k for k, x in enumerate(row) if x != 0) for row in entries]
    generator = np.random.default_rng(seed)
    step = [Fraction(int(k), 97) for k in generator.integers(-40, 40, len(values))]
    for row, pivot in zip(entries, pivots, strict=True):
        free = [k for k in range(len(values)) if k not in pivots]
        step[pivot] = -sum(Fraction(int(row[k].p), int(row[k].q)) * step[k] for k in free)
    return [value + change for value, change in zip(values, step, strict=True)]


def inside(quantity):
    """Tell of each weight, by 0 or 1, whether it is in a sum along a way."""
    layout = METHOD.layout
    found = [0] * layout.size
    for point in layout.path(layout.ends[quantity.row]):
        for k, stage in enumerate(layout.weights[point], layout.starts[point]):
            found[k] += (stage,) == quantity.word
    return found


def test_the_tableau_is_dormand_and_princes(values):
    rows = flat_rows(values)
    assert rows.satisfied()
    constants = {
        (term.weights[0].row, term.weights[0].word): -one.constant
        for one in rows.equations()
        for term in one.terms
    }
    assert constants[5, (1,)] == Fraction(-355, 33)
    assert constants[6, (2,)] == Fraction(500, 1113)
    assert constants[8, (6,)] == Fraction(1, 40)
    wrong = [*values[:-1], values[-1] + Fraction(1, 10**30)]
    assert not flat_rows(wrong).satisfied()


def test_relations_hold_wherever_the_sums_do(values):
    """Off all order conditions, with other weights of the same sums."""
    x = moved_along(values, 1)
    assert x != values
    relations = list(flat_rows(values).relations())
    words = sorted({one for relation in relations for one in relation}, key=str)
    quantities = [Quantity(METHOD.layout.stages + row, word) for row, word in words]
    found = Weights(METHOD.layout, quantities).evaluate(
        [fmpq(v.numerator, v.denominator) for v in x]
    )
    residual = {
        (row, word): Fraction(int(v.p), int(v.q)) - reciprocal_density(word)
        for (row, word), v in zip(words, found, strict=True)
    }
    assert any(residual.values())
    for relation in relations:
        assert sum(c * residual[one] for one, c in relation.items()) == 0


def test_the_certificate_holds_the_tableau():
    certificate = certify(METHOD)
    assert certificate.identities[0] == "flat tableau"
    check(certificate, METHOD)
    with pytest.raises(CertificationError):
        check(replace(certificate, identities=certificate.identities[1:]), METHOD)
    with pytest.raises(CertificationError):
        check(replace(certificate, identities=certificate.identities[:1]), METHOD)


def test_rows_that_are_no_tableau_of_the_order():
    method = cg.methods["CF5d"]
    certificate = certify(method)
    forged = replace(certificate, identities=("flat tableau", *certificate.identities))
    with pytest.raises(CertificationError):
        check(forged, method)
