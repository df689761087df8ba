from fractions import Fraction

import numpy as np
import pytest
from coefficients import CLASSICAL, FEHLBERG, KUTTA
from quotients import derivative
from refusals import refuses
from scipy.integrate._ivp import dop853_coefficients

import cg
from cg.construction.catalogue import methods
from cg.construction.layouts import Layout
from cg.construction.lifting.split_rows import FlatRows, SplitRows, random_layout
from cg.construction.methods.classical_conditions import flat_order, stage_orders


def pair(name):
    method = methods[name]
    a, weights = method.exact
    return cg.Tableau(a, weights, b_embedded=method.exact_embedded, name=name)


class TestFlat:
    @pytest.mark.parametrize(
        ("method", "order", "second"), [(KUTTA, 3, None), (CLASSICAL, 4, None), (FEHLBERG, 5, 4)]
    )
    def test_orders_of_the_literature(self, method, order, second):
        assert flat_order(method) == order
        if second is not None:
            assert flat_order(method, embedded=True) == second

    def test_rational_coefficients_have_no_tolerance(self):
        off = Fraction(1, 10**30)
        a = [[], ["1/2"], [-1, 2]]
        b = [Fraction(1, 6) + off, Fraction(2, 3) - off, "1/6"]
        assert flat_order(cg.Tableau(a, b)) == 1

    def test_doubles_have_tolerance_of_rounding(self):
        a, b = FEHLBERG.a.tolist(), FEHLBERG.b.tolist()
        assert flat_order(cg.Tableau(a, b)) == 5
        b[0] += 1e-14
        assert flat_order(cg.Tableau(a, b)) == 0

    def test_lift_refuses_a_tableau_without_order(self):
        refuses(ValueError, "tableau must", cg.lift, cg.Tableau([[], ["1/2"]], ["1/2", "1/3"]))

    def test_stage_orders(self):
        assert stage_orders(KUTTA) == (0, 1, 1)
        assert stage_orders(pair("DP5(4)")) == (
            0, 1, 2, 2, 2, 2, 5,
        )  # fmt: skip
        assert stage_orders(FEHLBERG) == (0, 1, 2, 2, 2, 2)


class TestSplitRows:
    def splitting(self, seed=0, flows=12):
        flat = FlatRows(*FEHLBERG.exact, FEHLBERG.exact_embedded)
        layout = random_layout(flat, flows, np.random.default_rng(seed))
        return flat, SplitRows(5, layout, flat=flat, embedded_order=4)

    @pytest.mark.parametrize("seed", range(6))
    def test_sums_are_exact_for_all_unknowns(self, seed):
        flat, splitting = self.splitting(seed)
        x = np.random.default_rng(seed).uniform(-1, 1, splitting.size)
        tree = splitting.layout.tree(list(map(Fraction, splitting.texts([*map(Fraction, x)]))))
        assert tuple(map(tree.flat_row, tree.stage_points)) == flat.stages
        assert tree.flat_row(tree.result) == flat.result
        assert tree.flat_row(tree.embedded_result) == flat.embedded

    def test_jacobian(self):
        _, splitting = self.splitting(3)
        x = np.random.default_rng(0).uniform(-0.5, 0.5, splitting.size)
        v = np.random.default_rng(1).uniform(-1, 1, splitting.size)
        slope = derivative(lambda s: splitting.residual(x + s * v), bound=1e-9)
        np.testing.assert_allclose(splitting.jacobian(x) @ v, slope, rtol=0, atol=1e-9)


class TestLift:
    @pytest.mark.parametrize("tableau", [KUTTA, CLASSICAL, FEHLBERG], ids=lambda t: t.stages)
    def test_order_and_flat_tableau(self, tableau):
        lifted = cg.lift(tableau, tries=30)
        method = lifted.method
        assert method.order == flat_order(tableau)
        assert method.exact == tableau.exact
        assert method.exact_embedded == tableau.exact_embedded
        assert method.embedded_order == (4 if tableau is FEHLBERG else None)
        assert lifted.max_residual < 1e-33
        assert lifted.flows == method.exponentials
        assert method.name == tableau.name

    def test_chains(self):
        lifted = cg.lift(CLASSICAL, chains=[1, 1, 2, 2], reduce=False)
        assert Layout.of_tree(lifted.method.tree).parents == (-1, -1, -1, 2, -1, 4)
        assert lifted.method.order == 4

    def test_lower_order(self):
        lifted = cg.lift(FEHLBERG, 4)
        assert lifted.method.exact == FEHLBERG.exact
        assert lifted.method.order >= 4
        assert lifted.flows <= cg.lift(FEHLBERG).flows

    def test_first_same_as_last(self):
        flat = pair("BS3(2)")
        method = cg.lift(flat).method
        assert method.stage_points[-1] == method.result
        assert method.exact == flat.exact
        assert (method.order, method.embedded_order) == (3, 2)

    def test_lift_error(self):
        with pytest.raises(cg.LiftError, match="none of 3 starts led to a method of order 4") as e:
            cg.lift(CLASSICAL, chains=[1, 1, 1, 1], tries=3)
        assert e.value.best > 1e-6
        c2, c3 = 0.2**0.5, 0.5**0.5
        b2, b3 = (2 - 3 * c3) / (6 * c2 * (c2 - c3)), (2 - 3 * c2) / (6 * c3 * (c3 - c2))
        a32 = 1 / (6 * b3 * c2)
        rounded = cg.Tableau([[], [c2], [c3 - a32, a32]], [1 - b2 - b3, b2, b3])
        refuses(cg.LiftError, "must be exact or have", cg.lift, rounded)

    def test_no_tree_leads_to_a_second_stage_at_the_start(self):
        twice = cg.Tableau([[], [0], [0, "1/2"]], [0, 0, 1])
        refuses(ValueError, "flows must be a number", cg.lift, twice, flows=3)

    def test_doubles_are_taken_as_the_fractions_that_they_are_rounded_from(self):
        flat = pair("DP5(4)")
        lifted = cg.lift(cg.Tableau(flat.a, flat.b, b_embedded=flat.b_embedded))
        assert lifted.method.exact == flat.exact
        assert lifted.method.exact_embedded == flat.exact_embedded


def test_dop853_is_scipys_to_the_last_bit():
    flat = pair("DOP853")
    np.testing.assert_array_equal(flat.a, dop853_coefficients.A[:12, :12])
    np.testing.assert_array_equal(flat.b, dop853_coefficients.B)


def test_recipes_find_methods_like_those_of_the_catalogue(load_script, capsys):
    program = load_script("research/run_recipe")
    recipes = program.recipes()
    assert recipes["CG4"].startswith("The closed form")
    method = program.run("CF4d", recipes["CF4d"])
    assert program.agrees("CF4d", method)
    assert not program.agrees("CF4c", method)
    assert "(4, 4, 5) of (4, 5, 5)" in capsys.readouterr().out
    assert flat_order(program.flat(methods["DVERK6(5)"]), embedded=True) == 5
    calls = {call for each in recipes.values() if isinstance(each, dict) for call in each}
    assert calls == {"search", "construct", "lift"}
