"""Orthogonality: conditions that follow from others if stages or flows are few."""

from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from exact import word_residuals
from flint import arb
from refusals import refuses

import cg
from cg.construction.catalogue import find_method
from cg.construction.conditions import exact as ws
from cg.construction.conditions.exact import Quantity, Weights
from cg.construction.proofs import CertificationError, certify, check
from cg.construction.proofs.dependent import pairings as pr
from cg.construction.proofs.dependent.orthogonality import (
    Reduction,
    find_relations,
    prove_dependent,
)
from cg.construction.search.candidate import pack_method
from cg.support.quads import to_ball, working_precision

METHODS = ["CF5a", "CF5b", "CF5c", "CF5d"]


def balls(method, radius=0.0):
    return [to_ball(c.value) + (arb(0, radius) if c.unit else 0) for c in method.coefficients]


def left_out_of(method):
    return list(certify(method).left_out)


def random_rationals(size, seed):
    generator = np.random.default_rng(seed)
    return [Fraction(int(k), 64) for k in generator.integers(-99, 99, size)]


@pytest.mark.parametrize("name", METHODS)
def test_as_many_conditions_are_left_out_as_depend_on_others(name):
    method = cg.methods[name]
    certificate, candidate = certify(method), pack_method(method)
    rank = np.linalg.matrix_rank(candidate.system.jacobian(candidate.x), tol=1e-9)
    left_out = certificate.left_out
    assert len(left_out) == 38 - rank > 0
    assert method.layout.size - len(certificate.fixed) == rank
    check(certificate, method)


@pytest.mark.parametrize("name", METHODS)
def test_conditions_left_out_hold_near_solutions(name):
    """Off the solution set, but with the required conditions satisfied, all others are too."""
    method = cg.methods[name]
    system, start = pack_method(method).system, pack_method(method).x
    left_out = set(left_out_of(method))
    required = [(0, word) not in left_out for word in ws.condition_words(5)]
    x = start + 1e-4 * np.random.default_rng(1).standard_normal(start.size)
    for _ in range(12):
        x -= np.linalg.pinv(system.jacobian(x)[required]) @ system.residual(x)[required]
    assert np.abs(x - start).max() > 1e-6
    assert np.abs(system.residual(x)[required]).max() < 1e-14
    assert np.abs(system.residual(x)).max() < 1e-11


@pytest.mark.parametrize("name", ["CF5c", "CF4(3)", "CFM6(4)"])
def test_products_of_vectors_are_weights_for_any_coefficients(name):
    layout = find_method(name).layout
    orders = [4, 3] if layout.pair else [5]
    with working_precision(200):
        y = list(map(to_ball, random_rationals(layout.size, 2)))
        for pairing in pr.pairings(layout, orders, y):
            generator = np.random.default_rng(3)
            pairs = [
                (i, j)
                for i, u in enumerate(pairing.contexts)
                for j, column in enumerate(pairing.columns)
                if u.degree + column.degree < orders[u.row]
            ]
            for i, j in generator.permutation(pairs)[:80]:
                words, row = pairing.words(i, j), layout.stages + pairing.contexts[i].row
                quantities = [Quantity(row, word) for word in words]
                values = Weights(layout, quantities).evaluate(y)
                expected = sum(v * m for v, m in zip(values, words.values(), strict=True))
                both = zip(pairing.left[i], pairing.right[j], strict=True)
                actual = sum((a * b for a, b in both), arb(0))
                assert abs(actual - expected) < arb("1e-40")


def test_residuals_of_all_words_by_those_of_conditions():
    layout = cg.methods["CF5c"].layout
    x = random_rationals(layout.size, 4)
    words = list(ws.condition_words(5, independent=False))
    residuals = dict(zip(words, word_residuals(layout, x, words), strict=True))
    reduction = Reduction(Fraction, lambda word: residuals[word] + ws.reciprocal_density(word))
    conditions = set(ws.condition_words(5))
    for word in words:
        combination = reduction(word)
        assert conditions.issuperset(combination)
        assert residuals[word] == sum(c * residuals[one] for one, c in combination.items())


def with_slots(word):
    """Yield the contexts that a word without letters is left of, where it was a letter."""
    for i, letter in enumerate(word):
        for other in [pr.SLOT] if letter == () else with_slots(letter):
            yield (*word[:i], other, *word[i + 1 :])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_contexts_are_words_with_a_slot_in_the_last_letter(order):
    expected = {
        context
        for count in range(1, order + 1)
        for word in ws.words_with(count + 1)
        for context in with_slots(word)
        if context[-1] == pr.SLOT or pr.has_slot(context[-1])
    }
    assert len(pr.basis(order)) == len(expected)
    assert set(pr.basis(order)) == expected


def test_moments_of_the_exact_solution():
    # those of θ^k / k! are k θ^(k+1) / (k+1)!
    for context in pr.basis(3):
        for k in range(4):
            moment = sum(
                m * ws.reciprocal_density(pr.fill(other, ((),) * k))
                for other, m in pr.moments(context).items()
            )
            assert moment == k * ws.reciprocal_density(pr.fill(context, ((),) * (k + 1)))
            assert {pr.outer_nodes(other) for other in pr.moments(context)} == {
                pr.outer_nodes(context) + 1
            }


def test_moments_are_exactly_zero_on_flows_from_the_start():
    layout = cg.methods["CF6d"].layout
    with working_precision(200):
        flows = pr.pairings(layout, [4], balls(cg.methods["CF6d"], 1e-9))[1]
    first = [m for m, parent in enumerate(layout.parents) if parent < 0]
    for column, vector in zip(flows.columns, flows.right, strict=True):
        zero = [m for m, x in enumerate(vector) if x.is_zero()]
        assert not column.moments or set(first) <= set(zero)


def test_dependent_and_independent_conditions():
    method = cg.methods["CF5c"]
    left_out = left_out_of(method)
    with working_precision(320):
        assert prove_dependent(method.layout, [5], balls(method, 1e-30), left_out)
        assert prove_dependent(method.layout, [5], balls(method, 1e-30), left_out[:3])
        assert not prove_dependent(method.layout, [5], balls(method, 0.1), left_out)
        one_more = next(one for one in ws.conditions_of([5]) if one not in left_out)
        assert not prove_dependent(method.layout, [5], balls(method), [*left_out, one_more])
        relations = find_relations(method.layout, [5], balls(method), 20)
        alone = ws.conditions_of([5])[int(np.argmin(np.linalg.norm(relations, axis=0)))]
        assert not prove_dependent(method.layout, [5], balls(method), [alone])
        elsewhere = [ball + arb(0.01) * (k % 3) for k, ball in enumerate(balls(method))]
        assert not prove_dependent(method.layout, [5], elsewhere, left_out)


def test_relations_are_orthogonal_to_all_derivatives():
    method = cg.methods["CF5b"]
    with working_precision(320):
        relations = find_relations(method.layout, [5], balls(method), 20)
    assert relations.shape == (8, 38)
    candidate = pack_method(method)
    assert np.abs(relations @ candidate.system.jacobian(candidate.x)).max() < 1e-10


TREE = ws.Condition(0, ws.parse("[[]]"))


def test_certificates_that_leave_out_something_else():
    method = cg.methods["CF5d"]
    certificate = certify(method)
    left_out = certificate.left_out
    count, independent = "as many movable coefficients as equations", "distinct independent ones"
    others = (*left_out, left_out[0]), (ws.Condition(0, ws.parse("[[][]]")),)
    for message, wrong in (
        *((count, conditions) for conditions in (left_out[:-1], (*left_out, TREE), ())),
        *((independent, conditions) for conditions in (*others, (TREE._replace(row=1),))),
        ("no zero is proved", (*left_out[:-1], TREE)),
    ):
        refuses(CertificationError, message, check, replace(certificate, left_out=wrong), method)


def test_a_certificate_that_leaves_out_an_independent_condition():
    """The others have a zero with one more coefficient fixed; only `follow` rejects it."""
    method = cg.methods["CF5d"]
    certificate = certify(method)
    movable = [name for name in method.layout.names if name not in certificate.fixed]
    forged = replace(
        certificate, left_out=(*certificate.left_out, TREE),
        fixed=(*certificate.fixed, movable[0]), radius=Decimal("1e-33"),
    )  # fmt: skip
    refuses(CertificationError, "that conditions follow from others is not", check, forged, method)
