"""Orders of all methods on SU(2) and on a user's frames, of the implicit ones on all frames.

Up to order four it is `integrate` whose errors are measured.  Beyond, double precision would hide
them in rounding, since no step of a frame that isn't compiled has more; so they are measured with
steps in extended precision, and `integrate` must agree with these to rounding.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from extended_steps import ExtendedProblem, left_flow, right_flow, similarity_flow
from reversed_flows import reverse_flows
from slow_cases import cases

from cg.analysis.convergence import observed_order
from cg.catalogue import methods
from cg.frames import SE3, SO3, SU, FieldFrame, Frame, MatrixFrame, Sphere, UnitQuaternion
from cg.integration import integrate
from cg.method.tableau import Tableau
from cg.problems.affine import AffineField

pytestmark = pytest.mark.no_core

EXACT = {name: tableau for name, tableau in methods.items() if not tableau.approximate}
WEIGHTS = {
    **{name: (tableau, tableau.order) for name, tableau in EXACT.items()},
    **{
        f"{name}, embedded": (tableau.embedded, tableau.embedded_order)
        for name, tableau in EXACT.items()
        if tableau.embedded is not None
    },
}
IMPLICIT = [name for name, (tableau, _) in WEIGHTS.items() if not tableau.explicit]
EXPLICIT = [name for name in WEIGHTS if name not in IMPLICIT]
# The highest order that is measured in double precision.
DOUBLE = 4
STEPS = {
    1: (128, 192, 256),
    2: (64, 96, 128),
    3: (32, 48, 64),
    4: (24, 32, 48),
    5: (32, 48, 64),
    6: (12, 16, 24),
    7: (12, 16),
    8: (32, 48),
}
# Of these the leading terms take over at smaller steps only.
FINER = ("DVERK6(5)", "Verner7(6)")


def complex_point(y):
    return y[0] + 1j * y[1]


def move(v, y):
    rate = v[1] + 1j * v[2]
    drift = np.expm1(rate) / rate if rate else 1.0
    moved = np.exp(rate) * complex_point(y) + v[0] * drift
    return np.array([moved.real, moved.imag])


# Translations along an axis, dilations and rotations of the plane.
SIMILARITIES = FieldFrame(
    [
        lambda y: np.array([1.0, 0.0]),
        lambda y: y,
        lambda y: np.array([-y[1], y[0]]),
    ],
    move,
    point_shape=2,
)
MATRICES = MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[0.5, 0.0], [1.0, -0.5]]])


def real_form(x):
    return np.concatenate([x.real, x.imag], axis=-2)


PAULI = SU(2).field(np.eye(3), np.eye(2))
# The two columns of a matrix of SU(2), their real parts above the imaginary ones.
REAL_SU2 = MatrixFrame(
    np.concatenate([real_form(PAULI), real_form(1j * PAULI)], axis=-1), columns=2
)


@dataclass(frozen=True, eq=False)
class Case:
    """A problem whose solution is known; ``to_real`` leads from its frame to real points."""

    frame: Frame
    extended: ExtendedProblem
    exact: Any
    to_real: Any = np.asarray

    def f(self, t, y):
        return self.extended.problem.f(t, self.to_real(y))

    def end(self, tableau, n):
        """Return the end by `integrate`, in the entries of the problem with real points."""
        y0 = np.eye(2) if self.frame == SU(2) else self.extended.problem.y0
        run = integrate(self.f, (0, 1), y0, frame=self.frame, method=tableau, h=1 / n)
        return self.to_real(run.y[-1]).ravel()

    def error(self, tableau, n, *, extended):
        end = self.extended.end(tableau, n) if extended else self.end(tableau, n)
        return max(abs(float(x - y)) for x, y in zip(end, self.exact, strict=True))

    def slope(self, tableau, order):
        """Return the slope where a method of that order should show it."""
        steps, extended = STEPS[order], order > DOUBLE
        if tableau.name.startswith(FINER):
            steps = tuple(2 * n for n in steps)
        errors = [self.error(tableau, n, extended=extended) for n in steps]
        if not extended and tableau.explicit and min(errors) < 1e-12:  # hidden by rounding
            extended = True
            errors = [self.error(tableau, n, extended=True) for n in steps]
        return observed_order(1 / np.array(steps), errors, floor=1e-25 if extended else 1e-12)


def make_case(frame, flow, initial, *, real_frame=None, **changes):
    problem = AffineField(real_frame or frame, initial, seed=1)
    reference = problem.reference([1], bits=128)
    assert reference.errors[0] < 1e-30
    return Case(frame, ExtendedProblem(problem, flow), reference.values[0][:-1], **changes)


TURNS = SO3().field(np.eye(3), np.eye(3))
MOTIONS = SE3().field(np.eye(6), np.eye(4))
# rows of the result are what becomes of the units
QUATERNIONS = np.swapaxes(UnitQuaternion().field(np.eye(3)[:, None], np.eye(4)), -1, -2)
CASES = {
    "SU2": lambda: make_case(
        SU(2),
        left_flow(REAL_SU2.matrices),
        real_form(np.eye(2)),
        real_frame=REAL_SU2,
        to_real=real_form,
    ),
    "matrices": lambda: make_case(MATRICES, left_flow(MATRICES.matrices), [1.0, 0.5]),
    "functions": lambda: make_case(SIMILARITIES, similarity_flow, [0.5, -0.25]),
    "SO3": lambda: make_case(SO3(), right_flow(TURNS), np.eye(3)),
    "SE3": lambda: make_case(SE3(), right_flow(MOTIONS), np.eye(4)),
    "quaternion": lambda: make_case(UnitQuaternion(), left_flow(QUATERNIONS), [0.0, 0.0, 0.0, 1.0]),
    "S2": lambda: make_case(Sphere(2), left_flow(TURNS), [0.0, 0.0, 1.0]),
}
ALL = list(CASES)
NOT_COMPILED = ALL[:3]  # where test_order_slopes.py measures no explicit method
KINDS = {"CG4a", "CG2(3), embedded", "CF5(4)", "DOP853", "CG7b"}
# all methods on SU(2), some on the frames of a user
MEASURED = [
    *cases(NOT_COMPILED, EXPLICIT, quick=lambda case, name: case == "SU2" or name in KINDS),
    *cases(ALL, IMPLICIT, quick=lambda case, name: case in ("SU2", "SE3") or "4" in name),
]
BEYOND_DOUBLE = [each for each in MEASURED if WEIGHTS[getattr(each, "values", each)[1]][1] > DOUBLE]


@cache
def case_of(name):
    return CASES[name]()


@pytest.mark.parametrize(("case", "name"), MEASURED)
def test_slope_is_the_order(case, name):
    tableau, order = WEIGHTS[name]
    slope = case_of(case).slope(tableau, order)
    assert len(slope.h) == len(STEPS[order])
    assert slope.order == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize(("case", "name"), BEYOND_DOUBLE)
def test_integrate_takes_the_steps_whose_order_is_measured(case, name):
    problem, tableau = case_of(case), WEIGHTS[name][0]
    end, extended = problem.end(tableau, 3), problem.extended.end(tableau, 3)
    difference = max(abs(float(x - Fraction(y))) for x, y in zip(extended, end, strict=True))
    # one rounding of every flow
    assert difference < 3 * tableau.exponentials * np.finfo(float).eps
    assert difference < 1e-2 * problem.error(tableau, 3, extended=True)


@pytest.mark.parametrize(
    ("case", "name"),
    [*product(NOT_COMPILED, ["CG3", "CG4", "CG4a"]), *product(ALL, ["DICG3", "DICG4", "DICG4b"])],
)
def test_flows_in_reverse_order_are_seen(case, name, monkeypatch):
    reverse_flows(monkeypatch)
    tableau, order = WEIGHTS[name]
    assert case_of(case).slope(tableau, order).order < 2.5


def wrong(name):
    """Return the tableau with each of its coefficients wrong in turn."""
    tableau = EXACT[name]
    for i, j in zip(*np.nonzero(tableau.a), strict=True):
        a = tableau.a.copy()
        a[i, j] += 0.01
        yield (i, j), Tableau(a.tolist(), tableau.b.tolist())


@pytest.mark.parametrize(
    ("case", "name"),
    [
        *product(NOT_COMPILED, ["CG4a"]),
        ("SU2", "DICG4"),
        *(pytest.param(case, "DICG4", marks=pytest.mark.slow) for case in ALL[1:]),
    ],
)
def test_each_coefficient_counts(case, name):
    for entry, tableau in wrong(name):
        slope = case_of(case).slope(tableau, EXACT[name].order)
        assert slope.order < 3.5, entry


@pytest.mark.parametrize(
    ("case", "name"),
    [
        *product(NOT_COMPILED, ["CG6d"]),
        *(pytest.param(case, "DICG6", marks=pytest.mark.slow) for case in ALL),
    ],
)
def test_wrong_coefficients_of_higher_orders_are_seen(case, name):
    tableaux = list(wrong(name))
    for entry, tableau in tableaux[:: len(tableaux) // 3]:
        assert case_of(case).slope(tableau, 6).order < 5.0, entry
