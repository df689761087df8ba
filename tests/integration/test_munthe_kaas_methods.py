"""Munthe-Kaas methods of the catalogue: orders, coefficients, files, rejected input."""

import numpy as np
import pytest
from frame_examples import generic
from test_munthe_kaas import METHODS

import cg
from cg.catalogue import dumps, loads
from cg.frames import SO3
from cg.method.low_storage import from_two_registers
from cg.structure.points import MethodError

EULER = cg.Tableau([[]], [1])
HEUN = cg.Tableau([[], [1]], ["1/2", "1/2"], b_embedded=[1, 0], name="Heun")


class TestMethods:
    def test_orders_stages_and_flows(self):
        assert {
            key: (m.order, m.embedded_order, m.third_order, m.stages, m.exponentials)
            for key, m in METHODS.items()
        } == {
            "RKMK3(2)": (3, 2, None, 4, 3), "RKMK4": (4, None, None, 4, 4),
            "RKMK5(4)": (5, 4, None, 7, 6), "RKMK8(5,3)": (8, 5, 3, 12, 12),
            "RadauIIA5": (5, 3, None, 4, 3),
        }  # fmt: skip
        assert all(m.pair_exponentials == m.exponentials for m in METHODS.values())

    def test_one_of_a_user(self):
        method = cg.MuntheKaas(HEUN)
        assert (method.name, method.order, method.embedded_order, method.stages) == (
            "Heun", 2, 1, 2,
        )  # fmt: skip
        assert method.exact == HEUN.exact
        assert method.exact_embedded == (1, 0)
        assert method.principal_error == pytest.approx(np.sqrt(2.0) / 6.0)
        assert method.largest_residual() == 0
        assert method.largest_residual(3) == pytest.approx(1 / 6)
        assert repr(method) == "<MuntheKaas Heun: order 2(1), 2 evaluations, 2 flows>"
        assert method == cg.MuntheKaas(HEUN, name="other")
        assert method != cg.MuntheKaas(EULER)
        assert method != HEUN
        assert method.embedded == cg.MuntheKaas(cg.Tableau([[], [1]], [1, 0]))

    @pytest.mark.parametrize(("make", "message"), [
        (lambda: cg.MuntheKaas(cg.methods["CF4"]), "tableau must be a Tableau, got"),
        (lambda: cg.MuntheKaas("RK4"), "tableau must be a Tableau, got 'RK4'"),
        (lambda: cg.MuntheKaas(cg.methods["ImplicitMidpoint"]), "tableau must be explicit"),
        (lambda: cg.MuntheKaas(EULER, third=[1]), "third must be None unless"),
        (lambda: cg.MuntheKaas(HEUN, third=[1]), "third must have 2 entries, got 1"),
        (lambda: cg.MuntheKaas(HEUN, third=[1, 0]), "third must differ"),
        (lambda: cg.MuntheKaas(HEUN, third="ab"), "third must be a sequence"),
        (lambda: cg.MuntheKaas(HEUN, third=["x", 0]), "third_1: expected a finite real"),
        (lambda: cg.MuntheKaas(cg.Tableau([[]], [0])), "result must depend on a stage"),
        (lambda: cg.MuntheKaas(HEUN, name=3), "name must be a str"),
        (lambda: loads(dumps(METHODS["RKMK4"]).replace("e-K", "e-k")), "kind must be"),
    ])  # fmt: skip
    def test_rejected_arguments(self, make, message):
        with pytest.raises(MethodError, match=message):
            make()

    def test_it_is_no_method_of_two_registers(self):
        chain = from_two_registers([0], ["1"])
        euler = cg.MuntheKaas(cg.Tableau([[]], chain.exact[1]))
        f, y0 = generic(SO3())
        runs = [cg.integrate(f, (0, 1), y0, frame=SO3(), method=m, h=0.5) for m in (chain, euler)]
        np.testing.assert_allclose(runs[0].y, runs[1].y, rtol=0, atol=1e-15)

    def test_warnings_of_pairs(self):
        close = cg.Tableau(
            [[], [1]], ["1/2", "1/2"], b_embedded=["50000001/100000000", "49999999/100000000"]
        )
        f, y0 = generic(SO3())
        with pytest.warns(UserWarning, match="both its results|nearly coincide"):
            cg.solve_ivp(f, (0, 1), y0, frame=SO3(), method=cg.MuntheKaas(close))
        nothing = cg.MuntheKaas(cg.Tableau([[], [1]], ["1/2", "1/4"]))
        with pytest.warns(UserWarning, match="has order 0"):
            cg.integrate(f, (0, 1), y0, frame=SO3(), method=nothing, h=0.5)
