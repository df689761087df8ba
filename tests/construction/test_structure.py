"""Simplifying assumptions: their equations and the number of remaining conditions."""

import numpy as np
import pytest
from quotients import jacobian
from refusals import refuses

import cg
from cg.construction.layouts import Rows
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.support import quads

pytestmark = pytest.mark.sanitize


def random_x(system, seed=0):
    x = np.random.default_rng(seed).uniform(-1, 1, system.size)
    x[np.setdiff1d(np.arange(system.size), system.movable)] = 0
    return x


@pytest.mark.parametrize("structure", [Structure.STAGE_ORDER_TWO, Structure.MIDDLE])
class TestEquations:
    @pytest.mark.parametrize(("order", "embedded"), [(4, False), (6, False), (5, True)])
    def test_jacobian_is_the_derivative(self, structure, order, embedded):
        system = ConditionSystem.tableau(order, 6, embedded=embedded, structure=structure)
        x = random_x(system)
        expected = jacobian(lambda s: system.residual(x + s), system.size, bound=1e-10)
        np.testing.assert_allclose(system.jacobian(x), expected, rtol=0, atol=1e-10)

    def test_residuals_agree_in_real_16(self, structure):
        system = ConditionSystem.tableau(5, 6, structure=structure)
        x = random_x(system)
        actual = system.residual_quad(quads.from_float(x), independent=True)
        np.testing.assert_allclose(actual, system.residual(x), atol=1e-14)

    def test_assumptions_come_after_conditions(self, structure):
        system = ConditionSystem.tableau(5, 6, structure=structure)
        general = ConditionSystem.tableau(5, 6)
        x = random_x(system)
        values, conditions = system.residual(x), general.residual(x)
        np.testing.assert_array_equal(values[: conditions.size], conditions)
        a, b = cg.conditions.unpack(x, 6)
        a, b = np.array(a), np.array(b)
        c = a.sum(axis=1)
        expected = [a[k] @ c - c[k] ** 2 / 2 for k in range(2, 6)]
        if structure is Structure.MIDDLE:
            expected += [c[k] - b[:k].sum() - b[k] / 2 for k in range(2, 6)]
        np.testing.assert_allclose(values[conditions.size :], expected, atol=1e-14)


def test_zeros_of_structures_are_not_movable():
    general, one, two = (ConditionSystem.tableau(6, 7, structure=kind) for kind in Structure)
    weights = general.size - 7
    assert general.movable.size == general.size
    assert np.setdiff1d(general.movable, one.movable).tolist() == [weights + 1]
    assert np.setdiff1d(general.movable, two.movable).tolist() == [weights, weights + 1]


@pytest.mark.parametrize(("arguments", "message"), [
    ({"structure": 7}, "structure must be one of GENERAL, .*got 7"),
    ({"structure": 2, "rows": Rows.FULL}, "structure = MIDDLE is for explicit"),
    ({"structure": 1, "order": 3}, "orders 4 to 8 with .* got order 3"),
    ({"structure": 1, "stages": 2}, "3 stages or more, .* 2 stages"),
    ({"structure": 2, "order": 9, "stages": 100}, "orders 4 to 8 with .* got order 9"),
])  # fmt: skip
def test_bad_input(arguments, message):
    refuses(ValueError, message, ConditionSystem.tableau, **{"order": 5, "stages": 6} | arguments)
