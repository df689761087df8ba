"""Relations between conditions of methods of two registers."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import cg
from cg.method.low_storage import from_two_registers
from cg.proofs import CertificationError, certify, check
from cg.proofs.dependent.flat_tableau import FlatTableau
from cg.proofs.dependent.reduction import Reduction
from cg.proofs.dependent.registers import TwoRegisters, exchanges
from cg.proofs.dependent.words import condition_words, nodes
from cg.proofs.explain import read_left_out
from cg.proofs.systems import exact_residuals

pytestmark = pytest.mark.sanitize

METHOD = cg.methods["CF5r"]


def random_method(stages, seed):
    generator = np.random.default_rng(seed)
    a, b = ([f"{int(x)}/64" for x in generator.integers(-90, 90, stages)] for _ in range(2))
    return from_two_registers(["0", *a[1:]], b)


@pytest.mark.parametrize("seed", [1, 2])
def test_relations_hold_for_any_coefficients_of_two_registers(seed):
    method = random_method(5, seed)
    layout = method.layout
    x = [coefficient.value for coefficient in method.coefficients]
    structure = TwoRegisters(layout, [5], x)
    assert structure.satisfied()
    words = list(condition_words(5, independent=False))
    residuals = dict(zip(words, exact_residuals(layout, x, words, layout.stages), strict=True))
    assert all(residuals[word] for word in words[:3])
    relations = list(structure.relations())
    assert len(relations) > 30
    for relation in relations:
        assert sum(c * residuals[word] for (_, word), c in relation.items()) == 0


def test_equations_tell_two_registers_from_others():
    x = [coefficient.value for coefficient in random_method(4, 3).coefficients]
    layout = random_method(4, 3).layout
    assert TwoRegisters(layout, [3], x).satisfied()
    assert len(TwoRegisters(layout, [3], x).equations()) == 3  # 10 weights of 7 numbers
    for k in range(1, 9):  # all but the first and the last, which are B alone
        wrong = [*x[:k], x[k] + Fraction(1, 7), *x[k + 1 :]]
        assert not TwoRegisters(layout, [3], wrong).satisfied()
    assert not TwoRegisters(cg.methods["CF4"].layout, [4], [Fraction(0)] * 99).satisfied()


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_flat_conditions_imply_all_others(order):
    """With the relations, the conditions of rooted trees determine all residuals of this order."""
    conditions = [w for w in condition_words(order) if nodes(w) == order]
    # those of fewer nodes being satisfied, products vanish
    reduction = Reduction(Fraction, lambda _: Fraction(0))
    flat = FlatTableau(random_method(2, 1).layout, [order], [Fraction(0)] * 3).relations()
    trees = [{word: m for (_, word), m in one.items()} for one in flat]
    rows = [
        [float(reduction.total(one.items()).get(w, 0)) for w in conditions]
        for one in (*trees, *exchanges(order))
        if all(nodes(word) == order for word in one)
    ]
    assert np.linalg.matrix_rank(rows) == len(conditions)


def test_the_solution_is_one_of_two_registers():
    certificate = certify(METHOD)
    left_out, structure, _ = read_left_out(certificate.identities)
    assert (structure, len(left_out)) == ("two registers", 38 - 17)
    assert METHOD.layout.size - len(certificate.fixed) == 17 + 45
    check(certificate, METHOD)
    other = replace(certificate, identities=("flat tableau", certificate.identities[1]))
    with pytest.raises(CertificationError, match="flat tableau"):
        check(other, METHOD)
    with pytest.raises(CertificationError):
        check(replace(certificate, identities=certificate.identities[1:]), METHOD)
