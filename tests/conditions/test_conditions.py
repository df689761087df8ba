import random
import re
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses
from slow_cases import slow
from strategies import tableaux

import cg
from cg import conditions
from cg.construction.conditions import condition_trees, core_calls
from cg.construction.layouts import Layout, Rows, rows_of
from cg.construction.points import START, Point, PointTree
from cg.construction.trees import OrderedTree, forest, fortran_tables, main
from cg.support.quads import decode, encode

pytestmark = pytest.mark.sanitize


def residuals_quad(layout, x, order, independent=False):
    """Return the residuals at packed weights, which are rounded to binary128 first."""
    trees = np.array(condition_trees(order, independent), dtype=np.intc)
    return decode(core_calls.residuals(order, layout, encode(x), trees))


exactly = partial(conditions.residuals, arithmetic="exact")


class TestCounts:
    def test_all_conditions(self):
        counts = [conditions.count(q) for q in range(1, 9)]
        assert counts == [1, 3, 8, 22, 64, 196, 625, 2055]

    def test_independent_conditions(self):
        counts = [conditions.count(q, independent=True) for q in range(1, 9)]
        assert counts == [1, 2, 5, 13, 38, 113, 358, 1158]

    @pytest.mark.parametrize(
        ("order", "rows", "nonzero"), [(4, 22, 13), (5, 64, 38), (6, 196, 113)]
    )
    def test_the_papers_table_has_zeros_for_discarded_trees(self, order, rows, nonzero):
        table = conditions.table_rows(order)
        assert len(table) == rows
        assert tuple(filter(None, table)) == conditions.condition_trees(order, independent=True)
        assert len(tuple(filter(None, table))) == nonzero

    def test_right_sides(self):
        third = Fraction(1, 3)
        assert conditions.right_sides(2) == (1, Fraction(1, 2), Fraction(1, 2))
        text = ["[[[[]]]]", "[[[][]]]", "[[[]][]]", "[[][[]]]", "[[][][]]"]
        expected = [Fraction(1, OrderedTree.parse(t).density) for t in text]
        assert sorted(conditions.right_sides(3)[3:]) == sorted(expected)
        assert third in conditions.right_sides(3)


class TestCompiledTables:
    def test_generated_source(self, tmp_path):
        output = tmp_path / "tables.f90"
        main(["--order", "3", "--output", str(output)])
        text = output.read_text()
        assert text == fortran_tables(forest(4))
        assert "highest_order = 3" in text
        assert "tree_total = 9" in text
        assert max(map(len, text.splitlines())) <= 132


class TestExactOracle:
    def test_orders_beyond_the_compiled_tables(self):
        order = conditions.MAX_ORDER + 1
        residuals = exactly([[0]], [1], order)
        assert len(residuals) == conditions.count(order)
        assert residuals[0] == 0


class TestPacking:
    @given(tableaux(), st.data())
    def test_round_trip(self, tableau, data):
        a, b = (np.array(part, dtype=np.float64) for part in tableau)
        rows = data.draw(st.sampled_from([None, Rows.FULL, rows_of(a)]))
        packed = conditions.pack(a, b, rows)
        pattern = rows_of(a) if rows is None else rows
        assert packed.shape == (conditions.unknowns(b.size, pattern),)
        actual = conditions.unpack(packed, b.size, pattern)
        np.testing.assert_array_equal(actual[0], a)
        np.testing.assert_array_equal(actual[1], b)

    def test_refuses_nonzero_entries_outside_the_pattern(self):
        with pytest.raises(ValueError, match="outside the pattern explicit"):
            conditions.pack([[1]], [1], Rows.EXPLICIT)
        with pytest.raises(ValueError, match="outside the pattern explicit"):
            conditions.jacobian([[1]], [1], 2, rows=Rows.EXPLICIT)


COMPILED = [conditions.residuals, conditions.weights, conditions.jacobian]


class TestBadInput:
    @pytest.mark.parametrize("function", COMPILED)
    @pytest.mark.parametrize(("a", "b", "message"), [
        ([[0]], [], "b must have shape (s,) with s at least 1, got (0,)"),
        ([[0]], 1.0, "b must have shape (s,) with s at least 1, got ()"),
        ([[0]], [1, 2], "a must have shape (2, 2) to match b, got (1, 1)"),
        ([0, 0], [1, 2], "a must have shape (2, 2) to match b, got (2,)"),
        ([[0], [1, 0]], [1, 2], "a must be an array of real numbers"),
        ([["x"]], [1], "a must be an array of real numbers"),
        ([[0]], [1j], "b must be an array of real numbers"),
        ([[np.nan]], [1], "a must be finite"),
        ([[0]], [np.inf], "b must be finite"),
    ])  # fmt: skip
    def test_tableau(self, function, a, b, message):
        refuses(ValueError, re.escape(message), function, a, b, 2)

    @pytest.mark.parametrize("stages", [0, -1])
    def test_stages(self, stages):
        refuses(ValueError, f"stages must be at least 1, got {stages}", conditions.unknowns, stages)
        with pytest.raises(ValueError, match=f"stages must be at least 1, got {stages}"):
            conditions.unpack([], stages)


@pytest.mark.parametrize("name", ["CG4", "CG3(2)", "DICG3", "CF4"])
def test_equations_at_random_coefficients_have_the_exact_residuals(name):
    sympy = pytest.importorskip("sympy")
    layout = cg.methods[name].layout
    rng = np.random.default_rng(layout.size)
    x = [Fraction(int(n), 7) for n in rng.integers(-9, 9, layout.size)]
    numbers = [sympy.Rational(v.numerator, v.denominator) for v in x]
    values = dict(zip(layout.names, numbers, strict=True))
    for independent in (True, False):
        equations = conditions.equations(cg.methods[name], 3, independent)
        found = [(e.lhs - e.rhs).subs(values) for e in equations]
        exact = exactly(layout, x, order=3, independent=independent)
        assert list(map(str, found)) == list(map(str, exact))


HIGHEST = 7
# Each weight has at most eight factors, each of them rounded once; what is added up is positive
# in `sizes`, and no sum has more than some ten terms.
ROUNDINGS = 64


def drawn(rng):
    """Return a random fraction with one to three digits above and below the line."""
    return Fraction(rng.randint(-99, 99), rng.choice((1, 2, 3, 7, 16, 60, 97, 128, 999)))


def random_tableau(rng):
    stages = rng.randint(1, 5)
    rows = rng.choice(list(Rows))
    layout = Layout.tableau(stages, rows)
    return layout, [drawn(rng) for _ in range(layout.size)]


def random_points(rng):
    points, stages = [], [START]
    for m in range(rng.randint(1, 9)):
        used = sorted(rng.sample(range(len(stages)), min(len(stages), rng.randint(1, 3))))
        # the layout leaves out zeros
        weights = {stage: drawn(rng) or Fraction(1, 3) for stage in used}
        points.append(Point(rng.randint(START, m - 1), weights))
        if rng.random() < 0.5:
            stages.append(rng.randint(START, m))
    tree = PointTree(tuple(points), tuple(stages), rng.randint(0, len(points) - 1))
    return Layout.of_tree(tree), [w for point in points for w in point.weights.values()]


def compare(seed):
    """Return the largest errors of residuals in both precisions, in units of rounding."""
    rng = random.Random(seed)
    layout, x = random_points(rng) if seed % 2 else random_tableau(rng)
    order, independent = rng.randint(1, HIGHEST), rng.random() < 0.3
    expected = conditions.residuals(layout, x, order, independent, arithmetic="exact")
    doubles = np.array([float(value) for value in x])
    sizes = 1 + conditions.weights(layout, np.abs(doubles), order, independent)
    residuals = conditions.residuals(layout, doubles, order, independent)
    quads = residuals_quad(layout, x, order, independent)
    assert len(residuals) == len(quads) == len(expected) == conditions.count(order, independent)
    worst = [0.0, 0.0]
    for double, quad, true, size in zip(residuals, quads, expected, sizes, strict=True):
        errors = abs(Fraction(double) - true) * 2**53, abs(quad - true) * 2**113
        worst = [
            max(old, float(error / Fraction(size)))
            for old, error in zip(worst, errors, strict=True)
        ]
    assert max(worst) <= ROUNDINGS, (seed, worst)
    return worst


PARTS = [range(50 * part, 50 * (part + 1)) for part in range(4)]
MANY = [range(1000 * part, 1000 * (part + 1)) for part in range(10)]


@pytest.mark.parametrize("seeds", [*PARTS, *slow(*MANY)], ids=str)
def test_the_core_agrees_with_the_oracle(seeds):
    for seed in seeds:
        compare(seed)
