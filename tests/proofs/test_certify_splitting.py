"""Proofs of splitting methods and of Magnus methods with brackets."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from kinds import SPLITTING

import cg
from cg.construction.conditions.nystrom import nystrom_residuals, splitting_residuals
from cg.construction.conditions.words import parse
from cg.construction.proofs import CertificationError, certificate_of, certify, check
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
    assert largest(splitting_residuals(*exact(name), cg.methods[name].order)) < 1e-57


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
    with pytest.raises(CertificationError):
        certify(cg.Splitting(d, k, name="wrong"), 6)
    certificate = certificate_of(method)
    check(certificate, method)
    words = pack(method, [6]).conditions
    box = certificate.box
    freed = replace(box, fixed=box.fixed[1:], left_out=())
    for wrong in (
        replace(certificate, order=7),
        replace(certificate, box=freed),
        replace(certificate, box=replace(box, left_out=(words[-1],), fixed=(*box.fixed, "d_1"))),
        replace(certificate, beyond=replace(certificate.beyond, word=parse("[[][][][][][][]]"))),
    ):
        with pytest.raises(CertificationError):
            check(wrong, method)


def test_brackets_are_proved_in_part():
    certificate = certificate_of(cg.methods["Magnus8(4)"])
    assert certificate.proved == "in part"
    assert len(certificate.left_out) == 13
    assert (certificate.order, certificate.embedded_order) == (8, 4)
    with pytest.raises(CertificationError):
        check(replace(certificate, order=9), cg.methods["Magnus8(4)"])


@pytest.mark.slow
def test_digits_of_brackets():
    method = cg.methods["Magnus8(4)"]
    rows = cg.digits(method, 40)
    values = [[x.value for x in row] for row in method.rows]
    assert [len(row) for row in rows] == [len(row) for row in values]
    assert (
        np.abs(
            np.concatenate(
                [np.subtract(list(map(Fraction, x)), y) for x, y in zip(rows, values, strict=True)]
            )
        ).max()
        < 3e-36
    )
