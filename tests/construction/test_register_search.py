"""Searches for two-register methods: their weights, derivatives, pairs and arguments."""

import numpy as np
import pytest
from quotients import jacobian
from refusals import refuses

import cg
from cg.construction.methods.estimate import estimate_ratio
from cg.construction.methods.low_storage import two_registers
from cg.construction.solvers.held import register_chain
from cg.construction.solvers.system import ConditionSystem


@pytest.mark.parametrize("pair", [False, True])
@pytest.mark.parametrize(("order", "stages"), [(1, 2), (3, 5), (4, 6)])
def test_jacobian_is_the_derivative(order, stages, pair):
    order = max(order, 2) if pair else order
    system = ConditionSystem(order, register_chain(stages, order, pair), registers=True)
    x = np.random.default_rng(order).uniform(0.2, 1.0, system.size)
    expected = jacobian(lambda s: system.residual(x + s), system.size, bound=1e-8)
    assert np.abs(system.jacobian(x) - expected).max() < 1e-8


@pytest.mark.parametrize(("order", "stages"), [(1, 1), (2, 2), (3, 3), (4, 5), (5, 11)])
def test_searches_find_methods_of_two_registers(order, stages):
    methods = cg.search(order, stages, 20, 1, workers=1, registers=True).methods
    assert methods
    for method in methods:
        assert (method.order, method.stages, method.exponentials) == (order, stages, stages)
        assert two_registers(method) is not None


@pytest.mark.parametrize(("order", "stages"), [(2, 3), (3, 4), (3, 5), (4, 7), (4, 8)])
def test_second_results_need_the_register_and_the_field_at_the_result(order, stages):
    methods = cg.search(order, stages, 12, 1, workers=1, registers=True, embedded=True).methods
    assert methods
    for method in methods:
        assert (method.order, method.embedded_order) == (order, order - 1)
        last, along, *field = method.points[method.result :]
        assert along.parent == (-1 if order < 4 else 1)
        ratios = [float(along.weights[k] / last.weights[k]) for k in last.weights]
        np.testing.assert_allclose(ratios, ratios[0], rtol=1e-13)
        if order < 4:
            assert method.stage_points[-1] == method.result == stages - 2
            assert set(field[0].weights) <= {stages - 1}
    assert order < 3 or min(map(estimate_ratio, methods)) < 2


def test_methods_of_the_catalogue_are_pairs_whose_estimates_see():
    for name in ("CF3(2)r", "CF4(3)r"):
        assert estimate_ratio(cg.methods[name]) < 1.2


@pytest.mark.parametrize(("changed", "name"), [
    ({"registers": 1}, "registers"), ({"tree": cg.methods["CF4"]}, "registers"),
    ({"flows": 6}, "registers"), ({"hold": {"w[1,1]": 1}}, "registers"),
    ({"first_same_as_last": True}, "registers"), ({"algorithm": "lmdif"}, "registers"),
    ({"stages": 4}, "two registers"), ({"stages": 1, "embedded": True}, "stages"),
    ({"rows": "full"}, "rows"), ({"nonnegative": "w"}, "nonnegative"),
])  # fmt: skip
def test_bad_arguments_are_named(changed, name):
    arguments = {"order": 4, "stages": 6, "registers": True} | changed
    refuses((TypeError, ValueError), rf"\b{name}\b", cg.search, **arguments)
