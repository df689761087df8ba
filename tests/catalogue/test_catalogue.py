import re
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kinds import FROZEN, MUNTHE_KAAS
from slow_cases import slow
from strategies import rationals, tableaux

from cg import conditions
from cg.construction.catalogue import Catalogue, dumps, load, loads, methods, save
from cg.construction.catalogue.summary import MethodSummary, compute_summary, summary_of
from cg.construction.conditions import Rows
from cg.construction.methods.tableau import Tableau, TableauError
from cg.construction.points import MethodError

pytestmark = pytest.mark.no_core

# order, stages, exponentials
KNOWN = {
    "LieEuler": (1, 1, 1), "CG2": (2, 2, 2), "CG3": (3, 3, 6), "CG2(3)": (3, 3, 6),
    "CG4": (4, 5, 14), "CG4a": (4, 5, 15), "CG5a": (5, 9, 43), "CG6a": (6, 16, 136),
    "CG6f": (6, 13, 89), "CG6g": (6, 12, 76), "CF3": (3, 3, 3), "CF3b": (3, 3, 3), "CF4": (4, 4, 5),
    "CF4b": (4, 5, 5), "CF5r": (5, 11, 11), "ImplicitMidpoint": (2, 1, 2), "DICG3": (3, 3, 9),
    "DICG3(2)": (3, 4, 14), "DICG4": (4, 3, 9), "DICG4b": (4, 5, 20), "DICG4c": (4, 5, 20),
    "DICG6": (6, 7, 35),
}  # fmt: skip
EXACT = [name for name in FROZEN if not methods[name].approximate]

ENTRY = 'name = "x"\nsource = "here"\na = [[], ["1/2"]]\nb = [0, 1.0]\n'


def test_methods_of_the_literature_are_included():
    assert set(methods) >= set(KNOWN)
    for name, (order, stages, exponentials) in KNOWN.items():
        method = methods[name]
        actual = (method.name, method.order, method.stages, method.exponentials)
        assert actual == (name, order, stages, exponentials)
        assert method.explicit or method.rows is Rows.DIAGONAL


@pytest.mark.parametrize("name", methods)
def test_source_is_given(name):
    assert len(methods[name].source) > 20


QUICK = [name for name in EXACT if methods[name].order <= 7 and methods[name].exponentials < 200]


# of order eight or many stages in exact arithmetic this takes ten seconds
@pytest.mark.parametrize("name", [*QUICK, *slow(*(name for name in EXACT if name not in QUICK))])
def test_residuals_vanish_through_the_order_and_not_beyond(name):
    method = methods[name]
    order = method.exact_order
    assert order == method.order
    residuals = conditions.residuals(method, order + 1, arithmetic="exact")
    through = conditions.count(order)
    assert max(map(abs, residuals[:through])) < Fraction(1, 10**32)
    assert max(map(abs, residuals[through:])) > Fraction(1, 10**6)  # of CG7b 7e-6 is left
    assert method.principal_error > 1e-5  # far above rounding, and the best method has 1e-4


@pytest.mark.parametrize("name", EXACT)
def test_coefficients_are_written_with_all_digits(name):
    method = methods[name]
    for entry in method.coefficients:
        digits = entry.text.lstrip("-0.").replace(".", "")
        # exactly known, or with all digits but zeros at the end
        assert entry.unit == 0 or 33 <= len(digits) <= 36


@pytest.mark.parametrize("name", {**FROZEN, **MUNTHE_KAAS})
def test_every_stage_and_every_point_is_used(name):
    """Each is used by a result, by the estimate of a pair, or by another stage that is used."""
    method = methods[name]
    stages, points = set(), set()
    if method.explicit:
        stages |= {k for k, w in enumerate(method.exact_embedded or ()) if w}
        ends = {method.result, method.embedded_result} - {None}
        for _ in range(method.stages):
            points = {m for end in ends for m in method.tree.path(end)}
            stages |= {k for m in points for k in method.points[m].weights}
            ends |= {method.stage_points[k] for k in stages}
        assert points == set(range(len(method.points)))
    else:
        a, *rows = *method.exact, method.exact_embedded or ()
        for _ in range(method.stages):
            stages |= {k for row in rows for k, w in enumerate(row) if w}
            rows = [a[k] for k in stages]
    assert stages == set(range(method.stages))


SUMMARISED = ["CG2(3)", "CG4a", "CG5a", "CF4b", "CF5(4)", "DP5(4)", "DICG4", "RKMK5(4)", "CFM4"]


@pytest.mark.parametrize(
    "name", [*SUMMARISED, *slow(*(name for name in methods if name not in SUMMARISED))]
)
def test_stored_summaries_equal_computed(name):
    stored = MethodSummary(**methods.summaries[name])
    assert stored == summary_of(methods[name]) == compute_summary(methods.read_again(name))


class TestMapping:
    def test_names_are_those_of_the_files(self, tmp_path):
        save(methods["CG3"], tmp_path / "Mine.toml")
        (tmp_path / "README").write_text("no method")
        mine = Catalogue(tmp_path)
        assert list(mine) == ["Mine"]
        with pytest.raises(MethodError, match=r"Mine\.toml: name must be 'Mine', got 'CG3'"):
            mine["Mine"]

    def test_orders_are_those_of_the_file(self, tmp_path):
        (tmp_path / "CG5a.toml").write_text(dumps(methods["CG3"]).replace('"CG3"', '"CG5a"'))
        assert Catalogue(tmp_path)["CG5a"].order == 3  # not that of the package's CG5a


names = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
numbers = st.one_of(rationals, st.floats(-1e10, 1e10), st.decimals(-10, 10, places=12).map(str))


class TestFiles:
    @given(tableaux(numbers), names, names, st.booleans())
    def test_round_trip(self, tableau, name, source, pair):
        second = tableau[1] if not pair else [*tableau[1][:-1], "4711/10"]
        method = Tableau(*tableau, name=name, source=source, b_embedded=second if pair else None)
        loaded = loads(dumps(method))
        assert loaded == method
        assert (loaded.name, loaded.source) == (name, source)
        assert loaded.entries == method.entries
        assert loaded.weights == method.weights
        assert loaded.embedded_weights == method.embedded_weights

    @pytest.mark.parametrize(("old", "new", "message"), [
        ("b = [0, 1.0]", "", "the entry lacks b"),
        ("b = ", "order = 2\nb = ", "the entry has unknown keys: order"),
        ("b = ", "b == ", "not a TOML file"),
        ("1.0]", "nan]", "b_2: expected a finite real number, got 'nan'"),
        ("1.0]", "true]\n", "b_2: expected a finite real number, got True"),
        ('"1/2"', '"1/2", 0, 0', "a must have 2 rows"),
        ('"x"', "5", "name must be a str, got 5"),
        ("1.0]", "1.0]\nnominal = 3", "nominal must be a table, got 3"),
        ("1.0]", "1.0]\n[nominal]\norder = 2", "nominal lacks residual"),
        ("1.0]", '1.0]\n[nominal]\norder = 3\nresidual = "0.1"', "nominal_order 3 reach"),
    ])  # fmt: skip
    def test_bad_files(self, old, new, message, tmp_path):
        path = tmp_path / "bad.toml"
        path.write_text(ENTRY.replace(old, new))
        with pytest.raises(TableauError, match=re.escape(message)) as caught:
            load(path)
        assert str(path) in str(caught.value)
