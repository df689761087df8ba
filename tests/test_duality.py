"""Proofs where few stages make conditions follow from others."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb, fmpq

import cg
from cg.certification import CertificationError, certify, check
from cg.certification.duality import (
    Duality,
    Surrounding,
    find_dualities,
    kept_conditions,
    regular,
)
from cg.certification.holes import basis, outer_nodes, polynomial, read_hole, write_hole
from cg.certification.prove import precision
from cg.certification.words import condition_words, text

METHOD = cg.methods["CF5a"]


def balls(method):
    return [arb(fmpq(c.value.numerator, c.value.denominator)) for c in method.coefficients]


@pytest.fixture(scope="module")
def dualities():
    with precision(320):
        return find_dualities(METHOD.layout, [5], balls(METHOD))


def test_as_many_conditions_are_kept_as_are_independent(dualities):
    kept = list(kept_conditions([5], dualities))
    jacobian = cg.construction.pack_method(METHOD).system.jacobian(
        np.array([float(c.value) for c in METHOD.coefficients])
    )
    assert len(kept) == len(set(kept)) == np.linalg.matrix_rank(jacobian, tol=1e-9) < 38


def test_without_dualities_all_conditions_are_kept():
    words = [word for _, word in kept_conditions([5], [])]
    assert len(words) == 38
    assert sorted(map(text, words)) == sorted(map(text, condition_words(5)))
    pairs = list(kept_conditions([4, 3], []))
    assert [sum(row == r for row, _ in pairs) for r in (0, 1)] == [13, 5]


def test_what_is_kept_implies_the_rest_at_solutions_nearby(dualities):
    """Off the solution set, but with the kept conditions satisfied, all others are too."""
    kept = {text(word) for _, word in kept_conditions([5], dualities)}
    system = cg.construction.pack_method(METHOD).system
    which = [text(word) in kept for word in condition_words(5)]
    assert 0 < sum(which) < 38
    start = np.array([float(c.value) for c in METHOD.coefficients])
    x = start + 1e-3 * np.random.default_rng(1).standard_normal(start.size)
    for _ in range(10):
        x -= np.linalg.pinv(system.jacobian(x)[which]) @ system.residual(x)[which]
    assert np.abs(x - start).max() > 1e-5
    assert np.abs(system.residual(x)[which]).max() < 1e-14
    assert np.abs(system.residual(x)).max() < 1e-12


def test_certificates_are_checked_with_what_they_name():
    certificate = certify(METHOD)
    assert certificate.identities
    assert all(name.startswith("span ") for name in certificate.identities)
    check(certificate, METHOD)
    with pytest.raises(CertificationError):
        check(replace(certificate, identities=certificate.identities[:1]), METHOD)
    with pytest.raises(CertificationError):
        check(replace(certificate, identities=()), METHOD)


def test_vectors_that_depend_on_each_other_prove_nothing(dualities):
    duality = next(one for one in dualities if len(one.letters) > 1)
    with precision(320):
        assert regular(duality, METHOD.layout, balls(METHOD))
        twice = replace(duality, letters=(duality.letters[0],) * len(duality.letters))
        assert not regular(twice, METHOD.layout, balls(METHOD))
        fewer = replace(duality, letters=duality.letters[1:])
        assert not regular(fewer, METHOD.layout, balls(METHOD))
        wide = [ball + arb(0, 1) for ball in balls(METHOD)]
        assert not regular(duality, METHOD.layout, wide)


def test_headings_are_read_again(dualities):
    for duality in dualities:
        assert Duality.read(duality.heading) == duality
    for hole in basis(3):
        assert read_hole(write_hole(hole)) == hole
        around = Surrounding(1, hole, ((), ((),)))
        assert Surrounding.read(str(around)) == around


@pytest.mark.parametrize("written", ["", "[", "[]", "[**]", "[[]]*", "other*[*]", "[*]*[*]"])
def test_what_is_no_surrounding_is_refused(written):
    with pytest.raises(ValueError, match=r"written|tree|text"):
        Surrounding.read(written)


def test_the_exact_solution_integrates_by_the_polynomials():
    """1/γ of a word is the integral of the polynomial times the letter in the hole."""
    from cg.certification.relations import fill
    from cg.certification.words import nodes, reciprocal_density

    for hole in basis(3):
        p = polynomial(hole)
        assert len(p) == outer_nodes(hole) + 1
        for letter in condition_words(3, independent=False):
            n = nodes(letter)
            integral = sum(c / (n + i + 1) for i, c in enumerate(p))
            assert reciprocal_density(fill(hole, letter)) == reciprocal_density(letter) * integral
