"""Proofs that methods don't exist: their polynomials, and that wrong proofs are refused."""

from dataclasses import replace
from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from flint import fmpq
from refusals import refuses

import cg
from cg.construction.conditions import condition_trees, residuals
from cg.construction.points import Point, PointTree
from cg.construction.trees import OrderedTree, catalan, forest
from research import impossibility as im
from research.impossibility.__main__ import main
from research.impossibility.ring import Ring
from research.impossibility.shapes import flat_density, orderings


def test_all_proofs_hold_and_say_what_they_prove():
    sentences = [sentence for name in im.proof_names() for sentence in im.check(name)]
    assert "no explicit Crouch-Grossman tableau of 4 stages has order 4" in sentences
    assert "no tree of 4 points (of 24) has order 4" in sentences
    for order, flows in ((3, 1), (5, 2), (6, 3), (7, 4)):
        what = f"commutator-free method with a path of {flows} flows to its result"
        assert f"no explicit {what} has order {order}" in sentences


@pytest.mark.parametrize("name", ["CF3", "CF4", "CF5a", "CF5c", "CF6b", "CG5d", "CG6g"])
def test_known_methods_have_more_flows_than_are_ruled_out(name):
    method = cg.methods[name]
    path = method.tree.path(method.tree.result)
    for order, flows in ((3, 1), (5, 2), (6, 3), (7, 4)):
        assert method.order < order or len(path) > flows


@pytest.mark.parametrize("change", ["factor", "missing", "name", "text"])
def test_wrong_proofs_are_refused(change):
    proof = im.read_proof("order4")
    claim = next(claim for claim in proof.claims if claim.shape == "-1 -1 0 1")
    factors = dict(claim.factors)
    name = next(iter(factors))
    if change == "factor":
        factors[name] += "+1/1000000007*b1"
    elif change == "missing":
        del factors[name]
    elif change == "name":
        factors["lemma 99"] = factors.pop(name)
    else:
        factors[name] += "+"
    refuses(im.ImpossibilityError, "-1 -1 0 1", proof.check_claim, replace(claim, factors=factors))


def test_a_proof_of_another_shape_is_refused():
    proof = im.read_proof("order4")
    claim = next(claim for claim in proof.claims if claim.shape == "tableau")
    refuses(
        im.ImpossibilityError, "isn't one", proof.check_claim, im.Claim("-1 0 1 2", claim.factors)
    )


def test_a_wrong_lemma_is_refused():
    proof = im.read_proof("order4")
    wrong = replace(proof.lemmas[0], polynomial=proof.lemmas[0].polynomial + "+1")
    with pytest.raises(im.ImpossibilityError, match="lemma 1 "):
        replace(proof, lemmas=(wrong, *proof.lemmas[1:])).check_lemmas()


def _values(shape, seed):
    random = np.random.default_rng(seed)
    return {
        name: Fraction(int(random.integers(-9, 10)), int(random.integers(1, 10)))
        for name in shape.ring.names
    }


def _at(polynomial, names, values):
    numbers = [fmpq(values[name].numerator, values[name].denominator) for name in names]
    actual = polynomial(*numbers)
    return Fraction(int(actual.p), int(actual.q))


def _rows(stages, values):
    rows = [[Fraction(0)] * stages]
    for i in range(2, stages + 1):
        inner = [values[f"a{i}_{j}"] for j in range(2, i)]
        first = values[f"c{i}"] - sum(inner)
        rows.append([first, *inner] + [Fraction(0)] * (stages - i + 1))
    return [*rows, [values[f"b{i}"] for i in range(1, stages + 1)]]


@pytest.mark.parametrize("seed", range(3))
def test_conditions_of_tableaux_agree_with_the_oracle(seed):
    shape = im.TableauShape(4)
    values = _values(shape, seed)
    rows = _rows(4, values)
    actual = [_at(p, shape.ring.names, values) for p in shape.conditions(4).values()]
    assert actual == list(residuals(rows[:-1], rows[-1], 4, arithmetic="exact"))


@pytest.mark.parametrize("parents", [(-1, 0, 1, 2), (-1, -1, 0, 1), (-1, 0, -1, 2)])
def test_conditions_of_points_agree_with_the_oracle(parents):
    shape = im.PointsShape(4, parents)
    values = _values(shape, 7)
    rows = _rows(4, values)
    points = []
    for m, parent in enumerate(parents):
        row = [x - y for x, y in zip(rows[m + 1], rows[parent + 1], strict=True)]
        points.append(Point(parent, dict(enumerate(row))))
    tree = PointTree(tuple(points), (-1, 0, 1, 2), 3)
    actual = [_at(p, shape.ring.names, values) for p in shape.conditions(4).values()]
    assert actual == list(residuals(tree, 4, arithmetic="exact"))


def test_the_flat_conditions_vanish_at_the_classical_method_alone():
    shape = im.TableauShape(4)
    values = dict.fromkeys(shape.ring.names, Fraction(0))
    values |= {"a3_2": Fraction(1, 2), "a4_3": Fraction(1), "c2": Fraction(1, 2)}
    values |= {"c3": Fraction(1, 2), "c4": Fraction(1), "b1": Fraction(1, 6)}
    values |= {"b2": Fraction(1, 3), "b3": Fraction(1, 3), "b4": Fraction(1, 6)}
    flat = shape.flat_conditions(4)
    assert len(flat) == 8
    assert {_at(p, shape.ring.names, values) for p in flat.values()} == {0}
    lemmas = [shape.ring.read(lemma.polynomial) for lemma in im.read_proof("order4").lemmas]
    assert {_at(p, shape.ring.names, values) for p in lemmas} == {0}
    values["b1"] += 1
    assert _at(flat["[]"], shape.ring.names, values) == 1


def test_the_words_of_one_flow_are_those_of_the_exponential():
    trees = forest(6)
    expected = {}
    for t in condition_trees(5):
        word = trees.children[t - 1]
        if set(word) <= {1, 2}:
            phi = Fraction(1, 2 ** word.count(2) * factorial(len(word)))
            expected[str(trees.tree(t))] = phi - Fraction(1, trees.density[t - 1])
    values = {name: _at(p, (), {}) for name, p in im.PathShape(1).conditions(5).items()}
    assert values == expected


def test_the_words_of_two_flows_vanish_at_a_known_method():
    points = cg.methods["CF4"].points
    c = [0, Fraction(1, 2), Fraction(1, 2), 1]
    path = cg.methods["CF4"].tree.path(4)
    assert len(path) == 2
    weights = points[path[0]].weights
    values = {"x0_1": sum(weights.values()), "x0_2": sum(w * c[k] for k, w in weights.items())}
    shape = im.PathShape(2)
    assert set(shape.ring.names) == set(values)
    actual = {name: _at(p, shape.ring.names, values) for name, p in shape.conditions(5).items()}
    assert {actual[name] for name in shape.conditions(4)} == {0}
    assert set(actual.values()) != {0}


def test_all_trees_are_there():
    shapes = [shape.parents for shape in im.point_shapes(4)]
    assert len(set(shapes)) == 24 == len(shapes)
    assert catalan(4) == 14
    proved = {claim.shape for claim in im.read_proof("order4").claims}
    assert proved == {"tableau", *(" ".join(map(str, parents)) for parents in shapes)}


def test_polynomials_are_read_as_written():
    ring = Ring(["x", "y"])
    polynomial = -(ring["x"] ** 3) * ring["y"] * fmpq(3, 7) + ring["y"] - 5
    assert ring.read(str(polynomial)) == polynomial
    assert ring.read("x - x + 1") == 1


def test_the_command(capsys):
    assert main(["order3"]) == 0
    assert "path of 1 flows to its result has order 3" in capsys.readouterr().out
    assert main(["order99"]) == 1
    assert "no proof 'order99'" in capsys.readouterr().out


def test_the_flat_condition_is_the_sum_of_the_orders():
    tree = OrderedTree.parse("[[[]][][]]")
    actual = orderings(tree)
    assert sum(actual.values()) == 6
    assert len(actual) == 3
    sides = sum(Fraction(n, OrderedTree((t,)).density) for t, n in actual.items())
    assert sides == Fraction(1, flat_density(tree))


def test_weights_of_one_sign():
    """The sum of ``docs/impossible.md`` vanishes where the conditions through order three do.

    On any tableau, also implicit ones, it is a combination of their residuals: with as many random
    tableaux as there are conditions and one more, it lies in the span of the residuals.
    """
    rng = np.random.default_rng(3)
    rows, sums = [], []
    for _ in range(14):
        a, b = rng.normal(size=(4, 4)), rng.normal(size=4)
        b /= b.sum()
        c, middle = a.sum(axis=1), np.cumsum(b) - b / 2
        rows.append(residuals(a, b, 3))
        sums.append((b * (c - middle) ** 2).sum() + (b**3).sum() / 12)
    factors, *_ = np.linalg.lstsq(np.array(rows)[:8], sums[:8], rcond=None)
    np.testing.assert_allclose(np.array(rows) @ factors, sums, rtol=0, atol=1e-12)
    for method in cg.methods.values():
        if isinstance(method, cg.Tableau) and method.order >= 3:
            assert method.b.min() < 0


def test_weights_of_one_sign_contradict_order_three():
    """Σ β (c_k - middle)² = -Σ b³/12 over the flows to the result, whatever the method."""
    seen = 0
    for method in map(cg.methods.__getitem__, cg.methods):
        if method.name == "CG6a" or method.order < 3:
            continue
        if not isinstance(method, cg.Tableau | cg.CommutatorFree):
            continue
        tree = method.tree
        nodes = [sum(tree.flat_row(at)) for at in tree.stage_points]
        time = left = right = 0
        for point in map(tree.points.__getitem__, tree.path(tree.result)):
            length = sum(point.weights.values())
            middle = time + length / 2
            left += sum(w * (nodes[k] - middle) ** 2 for k, w in point.weights.items())
            right -= length**3 / 12
            time += length
        assert abs(left - right) < 1e-33 * len(tree.points), method.name
        seen += 1
    assert seen > 50
