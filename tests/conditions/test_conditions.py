import re
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses
from strategies import tableaux

import cg
from cg import conditions
from cg.construction.conditions import Rows
from cg.construction.layouts.layout import rows_of
from cg.construction.trees.ordered import OrderedTree, forest
from cg.construction.trees.tables import fortran_tables, main

exactly = partial(conditions.residuals, arithmetic="exact")


class TestCounts:
    def test_all_conditions(self):
        counts = [conditions.count(q) for q in range(1, 9)]
        assert counts == [1, 3, 8, 22, 64, 196, 625, 2055]

    def test_independent_conditions(self):
        counts = [conditions.count(q, independent=True) for q in range(1, 9)]
        assert counts == [1, 2, 5, 13, 38, 113, 358, 1158]

    def test_unknowns_of_the_paper(self):
        assert [conditions.unknowns(s) for s in (5, 9, 16)] == [15, 45, 136]
        assert conditions.unknowns(3, Rows.DIAGONAL) == 9
        assert conditions.unknowns(3, Rows.FULL) == 12

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
    for independent, form in ((True, "sums"), (False, "sums"), (True, "expanded")):
        equations = conditions.equations(cg.methods[name], 3, independent, form)
        found = [(e.lhs - e.rhs).subs(values) for e in equations]
        exact = exactly(layout, x, order=3, independent=independent)
        assert list(map(str, found)) == list(map(str, exact))
    with pytest.raises(ValueError, match="form must be"):
        conditions.equations(3, 3, form="flat")
