"""Proofs of methods that are a flat tableau's, split into flows."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq, fmpq_mat

import cg
from cg.proofs import CertificationError, certificate_of, certify, check
from cg.proofs.dependent.flat_tableau import FlatTableau
from cg.proofs.dependent.quadratic import Quadratic, dependencies
from cg.proofs.dependent.words import condition_words, reciprocal_density, text
from cg.proofs.weights import Quantity, Weights
from cg.support.balls import working_precision

pytestmark = pytest.mark.no_core

METHOD = cg.methods["DP5(4)"]
ORDERS = [5, 4]


def flat_tableau(x):
    return FlatTableau(METHOD.layout, ORDERS, x)


@pytest.fixture(scope="module")
def values():
    return [coefficient.value for coefficient in METHOD.coefficients]


def moved_along(values, seed):
    """Return other weights with the same sums along all ways."""
    sums = [
        inside(term.weights[0]) for one in flat_tableau(values).equations() for term in one.terms
    ]
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
    actual = [0] * layout.size
    for point in layout.path(layout.ends[quantity.row]):
        for k, stage in enumerate(layout.weights[point], layout.starts[point]):
            actual[k] += (stage,) == quantity.word
    return actual


def test_the_tableau_is_dormand_and_princes(values):
    rows = flat_tableau(values)
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
    assert not flat_tableau(wrong).satisfied()


def test_relations_hold_wherever_the_sums_do(values):
    """Off all order conditions, with other weights of the same sums."""
    x = moved_along(values, 1)
    assert x != values
    relations = list(flat_tableau(values).relations())
    words = sorted({one for relation in relations for one in relation}, key=str)
    quantities = [Quantity(METHOD.layout.stages + row, word) for row, word in words]
    actual = Weights(METHOD.layout, quantities).evaluate(
        [fmpq(v.numerator, v.denominator) for v in x]
    )
    residual = {
        (row, word): Fraction(int(v.p), int(v.q)) - reciprocal_density(word)
        for (row, word), v in zip(words, actual, strict=True)
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


def test_products_give_relations_that_vectors_do_not(values):
    """With the products of contexts and letters left out, fewer relations are known."""

    def rank(kinds):
        rows = flat_tableau(values)
        actual = [zero for kind in kinds for k in range(5) for zero in getattr(rows, kind)(k)]
        words = sorted({one for zero in actual for one in zero}, key=str)
        table = [[zero[one].a if one in zero else 0 for one in words] for zero in actual]
        return fmpq_mat(table).rank()

    vectors = ["_of_letters", "_of_contexts"]
    assert rank([*vectors, "_of_products"]) > rank(vectors)


def quadratic(a, b, d=21):
    return Quadratic(fmpq(a), fmpq(b), d)


def test_numbers_with_a_root():
    x, y = quadratic(1, 2), Quadratic(fmpq(3, 7), fmpq(-1, 5), 21)
    assert float((x * y).number) == pytest.approx(float(x.number) * float(y.number))
    assert float((x - y).number) == pytest.approx(float(x.number) - float(y.number))
    one = x * x.inverse()
    assert (one.number, bool(one - quadratic(1, 0))) == (Fraction(1), False)
    assert x.times(Fraction(1, 2)).b == 1
    # a rational number is one with any root
    assert (Quadratic(2) * x).d == (x * Quadratic(2)).d == 21
    with working_precision(200):
        digits = Fraction(y.number.str(36, radius=False))
    near = Quadratic.near(digits, 21)
    assert (near.a, near.b) == (y.a, y.b)
    assert Quadratic.near(Fraction(2, 3), 0).number == Fraction(2, 3)


def test_dependencies_of_vectors_with_a_root():
    root = quadratic(0, 1)
    first, second = [quadratic(1, 0), root], [quadratic(2, 1), quadratic(5, 0)]
    third = [x * root - y for x, y in zip(first, second, strict=True)]
    (zero,) = dependencies([first, second, third])
    assert max(zero) == 2
    vectors = [first, second, third]
    for place in range(2):
        total = sum((share * vectors[k][place] for k, share in zero.items()), Quadratic(0))
        assert not total
    assert dependencies([first, second]) == []


def test_the_tableau_of_cooper_and_verner_has_a_root():
    method = cg.methods["CooperVerner8"]
    x = [coefficient.value for coefficient in method.coefficients]
    rows = FlatTableau(method.layout, [8], x, 21)
    assert rows.satisfied()
    assert not FlatTableau(method.layout, [8], x, 6).satisfied()
    assert not FlatTableau(method.layout, [8], x).satisfied()
    constants = {one.terms[0].weights[0]: -one.constant for one in rows.equations()}
    for quantity, constant in constants.items():
        row = method.tree.flat_row(method.layout.ends[quantity.row])
        assert float(constant) == pytest.approx(float(row[quantity.word[0]]), abs=1e-15)


@pytest.mark.slow
def test_order_eight_is_proved_whole():
    method = cg.methods["CooperVerner8"]
    certificate = certificate_of(method)
    assert certificate.identities[0] == "flat tableau in Q(√21)"
    check(certificate, method)
    names = certificate.identities[1]
    for identities in ((names,), ("flat tableau", names)):
        with pytest.raises(CertificationError):
            check(replace(certificate, identities=identities), method)


def test_one_more_condition_left_out_is_refused():
    """With one more coefficient held, so that there is a zero of what is left."""
    certificate = certificate_of(METHOD)
    structure, names = certificate.identities
    trees = [text(word) for word in condition_words(5)]
    remaining = [tree for tree in trees if tree not in names.split()]
    held = set(certificate.fixed)
    refused = 0
    for name in [name for name in METHOD.layout.names if name not in held][:6]:
        forged = replace(
            certificate,
            identities=(structure, f"{names} {remaining[-1]}"),
            fixed=(*certificate.fixed, name),
        )
        with pytest.raises(CertificationError) as error:
            check(forged, METHOD)
        refused += "that conditions follow from others is not proved" in str(error.value)
    assert refused


@pytest.mark.slow
def test_digits_of_order_eight_have_the_tableau(monkeypatch):
    """Of the catalogue's certificate only the zero is proved again, which takes seconds."""
    monkeypatch.setattr("cg.proofs.zero.follow", None)
    method = cg.methods["CooperVerner8"]
    weights = method.digits(60)
    row = [Fraction(0)] * method.stages
    for point in method.layout.path(method.result):
        for stage, weight in weights[point].items():
            row[stage] += Fraction(weight)
    exact = {Fraction(1, 20), Fraction(49, 180), Fraction(16, 45), Fraction(0)}
    assert all(min(abs(weight - one) for one in exact) < Fraction(1, 10**57) for weight in row)
