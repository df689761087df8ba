"""Proofs of splitting and of Magnus methods."""

from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from exact import splitting_residuals, word_residuals
from kinds import MAGNUS, SPLITTING
from refusals import refuses

import cg
from cg.construction.catalogue import loads
from cg.construction.conditions.exact import Condition, condition_words, parse
from cg.construction.conditions.linear_equations import linear_residuals, nystrom_residuals, words
from cg.construction.proofs import CertificationError, certificate_of, certify, check
from cg.construction.proofs.certificate import ViolatedCondition
from cg.construction.proofs.packed import independent_trees, pack


def exact(name, digits=60):
    drifts, kicks = cg.digits(name, digits)
    return list(map(Fraction, drifts)), list(map(Fraction, kicks))


def rows(method):
    """Return the coefficients as they are stored."""
    return [x.text for x in method.drift_coefficients], [x.text for x in method.kick_coefficients]


def largest(residuals):
    return max(abs(float(x)) for x in residuals)


def test_numbers_of_independent_trees():
    # dimensions of the algebra by letters; the drifts have the second of one letter
    assert [len(independent_trees(q)) for q in range(1, 8)] == [1, 1, 2, 2, 4, 5, 10]


@pytest.mark.parametrize("name", SPLITTING)
def test_exact_coefficients_satisfy_all_conditions(name):
    method = cg.methods[name]
    d, k = exact(name)
    assert largest(nystrom_residuals(d, k, method.order)) < 1e-57
    assert largest(nystrom_residuals(d, k, method.order + 1)) > 1e-6
    radius = Fraction(certificate_of(method).radius)
    for stored, found in ((method.drift_coefficients, d), (method.kick_coefficients, k)):
        assert all(abs(x.value - y) <= radius for x, y in zip(stored, found, strict=True))


@pytest.mark.parametrize("name", ["RATTLE4", "RATTLE6"])
def test_compositions_have_their_order_for_all_pairs_of_flows(name):
    assert largest(splitting_residuals(*exact(name), cg.methods[name].order).values()) < 1e-57


def test_a_composition_with_drifts_outside_and_one_without_symmetry():
    drifts, kicks = rows(cg.methods["RATTLE6"])
    exchanged = certify(cg.Splitting(kicks, drifts[1:-1], name="exchanged"))
    assert (exchanged.order, len(exchanged.fixed)) == (6, 1)
    # Ruth's method of order three
    ruth = certify(cg.Splitting(["1", "-2/3", "2/3", "0"], ["-1/24", "3/4", "7/24"]))
    assert (ruth.order, ruth.radius) == (3, 0)


def test_wrong_coefficients_and_forged_certificates_are_refused():
    method = cg.methods["BlanesMoan6"]
    d, k = rows(method)
    d[2] = d[2][:12] + "1" + d[2][13:]
    with pytest.raises(CertificationError, match=r"the order is 0, not 6: the condition of \[\]"):
        certify(cg.Splitting(d, k, name="wrong"), 6)
    certificate = certificate_of(method)
    check(certificate, method)
    words = pack(method, [6]).conditions
    fixed = certificate.fixed
    beyond = replace(certificate.beyond, word=parse("[[][][][][][][]]"))
    for message, changes in (
        ("as many movable", {"order": 7}),
        ("d_0 is exactly zero, so it must be fixed", {"fixed": fixed[1:], "left_out": ()}),
        ("distinct independent", {"left_out": (words[-1],), "fixed": (*fixed, "d_1")}),
        ("no independent condition of order 7", {"beyond": beyond}),
    ):
        refuses(CertificationError, message, check, replace(certificate, **changes), method)


def test_brackets_are_proved_in_part():
    certificate = certificate_of(cg.methods["Magnus8(4)"])
    assert certificate.proved == "in part"
    assert len(certificate.left_out) == 13
    assert (certificate.order, certificate.embedded_order) == (8, 4)
    wrong = replace(certificate, order=9)
    refuses(CertificationError, "as many movable", check, wrong, cg.methods["Magnus8(4)"])


@pytest.mark.slow
def test_digits_of_brackets():
    method = cg.methods["Magnus8(4)"]
    rows = cg.digits(method, 40)
    values = [[x.value for x in row] for row in method.rows]
    for row, stored in zip(rows, values, strict=True):
        assert max(abs(Fraction(x) - y) for x, y in zip(row, stored, strict=True)) < 3e-36


def words_of_time(order):
    return condition_words(order, independent=False, of_time=True)


@pytest.mark.parametrize("name", ["CFM6(4)", "CFM6(4)b", "CFM8(4)"])
def test_digits_are_those_of_exact_coefficients_and_of_lobattos_nodes(name):
    method = cg.methods[name]
    texts = cg.construction.proofs.refined_digits(method, certificate_of(method), 60)
    numbers = list(map(Fraction, texts))
    for stored, x in zip(method.coefficients, numbers, strict=True):
        assert stored.unit or abs(x - stored.value) < Fraction(1, 10**59)
    # Lobatto's nodes, four or five
    square = Fraction(1, 20) if name == "CFM6(4)" else Fraction(3, 28)
    offsets = [x - Fraction(1, 2) for x in numbers[:3]]
    assert any(abs(x**2 - square) < Fraction(1, 10**59) for x in offsets)


def test_numbers_of_conditions():
    # compositions; Lyndon words with one letter of each degree
    assert [len(words_of_time(order)) for order in range(1, 9)] == [2**q - 1 for q in range(1, 9)]
    counts = [len(condition_words(order, of_time=True)) for order in range(1, 9)]
    assert np.diff([0, *counts]).tolist() == [1, 1, 2, 3, 6, 9, 18, 30]


@pytest.mark.parametrize("name", ["CFM4", "CFM6(4)"])
def test_residuals_are_those_of_words_in_derivatives(name):
    method = cg.methods[name]
    given = method.abscissae, [[a.value for a in row] for row in method.weights], []
    expected = dict(zip(words(7), linear_residuals(given, 7), strict=True))
    every = words_of_time(7)
    values = [coefficient.value for coefficient in method.coefficients]
    found = word_residuals(method.layout, values, every)
    for word, residual in zip(every, found, strict=True):
        # the last letter of a word in A_j is followed first, and A_j has a factor (j - 1)!
        degrees = tuple(len(letter) + 1 for letter in reversed(word))
        factor = np.prod([float(Fraction(1)) * np.prod(range(1, j)) for j in degrees])
        assert float(residual) * factor == pytest.approx(float(expected[degrees]), abs=1e-15)


@pytest.mark.parametrize("name", [name for name in MAGNUS if name.startswith(("CFM6", "CFM8"))])
def test_all_conditions_hold_to_more_places_than_are_stored(name):
    """Also those that a certificate leaves out, and those that aren't independent."""
    method = cg.methods[name]
    refined = loads(cg.export(method, "toml", digits=60))
    for one in (refined, refined.embedded):
        weights = [[a.value for a in row] for row in one.weights]
        residuals = linear_residuals((one.abscissae, weights, []), one.order)
        assert max(map(abs, residuals)) < 1e-58
    assert refined.c.tolist() == method.c.tolist()


def test_nodes_may_be_anywhere():
    certificate = certify(cg.MagnusMethod(["1/2"], [[1]], name="midpoint"))
    assert (certificate.order, certificate.radius, certificate.fixed) == (2, 0, ("c_1", "w_1,1"))
    gauss = ["0.2113248654051871177454256097490213", "0.7886751345948128822545743902509787"]
    lower, upper = (f"{sign}0.{digits}" for sign, digits in (
        ("-", "0386751345948128822545743902509787"), ("", "5386751345948128822545743902509787")
    ))  # fmt: skip
    method = cg.MagnusMethod(gauss, [[upper, lower], [lower, upper]], name="two Gauss nodes")
    assert certify(method).order == 4


def test_wrong_coefficients_of_magnus_methods_are_refused():
    method = cg.methods["CFM8(4)"]
    texts = [coefficient.text for coefficient in method.coefficients]
    texts[9] = texts[9][:-4] + "0000"
    with pytest.raises(CertificationError, match="satisfy no order conditions"):
        certify(method.with_coefficients(texts))
    with pytest.raises(CertificationError, match="more than the last places"):
        certify(method.with_coefficients(texts), 8)


def test_certificates_that_say_something_else():
    method = cg.methods["CFM6(4)"]
    honest = certificate_of(method)
    left_out = honest.left_out
    kept = next(word for word in condition_words(6, of_time=True) if (0, word) not in left_out)
    beyond = ViolatedCondition(parse("[[[[[[[[]]]]]]]]"), Decimal("1e-8"))
    for message, changes in (
        ("as many movable", {"left_out": (*left_out, Condition(0, kept))}),
        ("distinct independent", {"left_out": (*left_out, Condition(0, (((),),) * 6))}),
        ("no independent condition of order 7", {"beyond": beyond}),
        ("as many movable", {"order": 7}),
        ("it is for 'CFM6\\(4\\)b'", {"name": "CFM6(4)b"}),
    ):
        refuses(CertificationError, message, check, replace(honest, **changes), method)
