"""The implicit methods of the catalogue, and what docs/implicit.md says of such methods."""

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from gallery import load

import cg
from cg import conditions
from cg.analysis.convergence import observed_order
from cg.catalogue import methods
from cg.conditions import Rows, count, residuals, residuals_exact
from cg.construction.search.random_search import search
from cg.frames import SO3, Euclidean, Product
from cg.method.tableau import Tableau
from cg.problems import StateDependentRotation
from cg.structure.points import tree_of_rows
from cg.trees.ordered import forest

# order, stages, exponentials
KNOWN = {
    "ImplicitMidpoint": (2, 1, 2),
    "DICG3": (3, 3, 9),
    "DICG3(2)": (3, 4, 14),
    "DICG4": (4, 3, 9),
    "DICG4b": (4, 5, 20),
    "DICG6": (6, 7, 35),
}
SELF_ADJOINT = ["ImplicitMidpoint", "DICG4", "DICG4b", "DICG6"]
HALF = Fraction(1, 2)
# residuals of order three by the two equations that docs/implicit.md numbers (1) and (2)
EQUATIONS = {(1, 1, 1): (0, 0), (1, 2): (1, 0), (2, 1): (-1, 0), (3,): (1, HALF), (4,): (0, 1)}
STEPS = {2: (64, 128, 256), 3: (24, 32, 48), 4: (24, 32, 48), 6: (12, 16, 20)}


@dataclass(frozen=True)
class Cubic:
    """x + y T + z T^2 with T^3 = 2."""

    parts: tuple[Fraction, Fraction, Fraction]

    @classmethod
    def of(cls, *parts):
        x, y, z = (*map(Fraction, parts), *[Fraction()] * (3 - len(parts)))
        return cls((x, y, z))

    def __add__(self, other):
        other = other if isinstance(other, Cubic) else Cubic.of(other)
        return Cubic.of(*(p + q for p, q in zip(self.parts, other.parts, strict=True)))

    def __mul__(self, other):
        other = other if isinstance(other, Cubic) else Cubic.of(other)
        (a, b, c), (x, y, z) = self.parts, other.parts
        first, second = a * x + 2 * (b * z + c * y), a * y + b * x + 2 * c * z
        return Cubic.of(first, second, a * z + b * y + c * x)

    def __truediv__(self, integer):
        return self * Fraction(1, integer)

    def __eq__(self, other):
        return self.parts == (other if isinstance(other, Cubic) else Cubic.of(other)).parts

    def __hash__(self):
        return hash(self.parts)

    __radd__, __rmul__ = __add__, __mul__


def on_path(b, diagonal):
    return [[*b[:r], entry, *[0] * (len(b) - r - 1)] for r, entry in enumerate(diagonal)]


def flat_adjoint(a, b):
    """What the adjoint's tableau would be if all flows commuted."""
    return [[b[-1 - j] - row[-1 - j] for j in range(len(b))] for row in reversed(a)], b[::-1]


def adjoint(a, b):
    """The adjoint: every stage twice, in reverse order for b and in the given one for -a."""
    rows = [[*reversed(b), *(-entry for entry in row)] for row in a]
    return [*reversed(rows), *rows], [*reversed(b), *[0] * len(b)]


def step(frame, f, method, t, y, h):
    """One step of (2.3), its stages found by fixed-point iteration."""

    def compose(row, fields):
        point = y
        for entry, field in zip(row, fields, strict=True):
            point = frame.flow(h * entry * field, point)
        return point

    times = t + h * method.c
    fields = [f(time, y) for time in times]
    for _ in range(200):
        new = [f(s, compose(row, fields)) for s, row in zip(times, method.a, strict=True)]
        change = max(np.abs(n - o).max() for n, o in zip(new, fields, strict=True))
        fields = new
        if change < 1e-15 * (1 + max(np.abs(n).max() for n in new)):
            break
    else:
        assert change < 1e-12
    return compose(method.b, fields)


@pytest.fixture(scope="module", params=["body", "space"])
def problem(request):
    equation = StateDependentRotation(request.param)
    return equation, equation.reference([1], bits=128).y[0, :9].reshape(3, 3)


def slope(problem, method, steps):
    equation, exact = problem
    errors = []
    for n in steps:
        times = np.linspace(0, 1, n + 1)
        y = equation.y0
        for t, after in pairwise(times):
            y = step(equation.frame, equation.f, method, t, y, after - t)
        errors.append(float(equation.frame.distance(y, exact)))
    return observed_order(1 / np.array(steps), errors, floor=1e-13)


class TestCatalogue:
    def test_catalogue_has_all(self):
        assert {name for name, method in methods.items() if not method.explicit} >= set(KNOWN)

    @pytest.mark.parametrize("name", KNOWN)
    def test_order_and_size(self, name):
        method = methods[name]
        assert (method.order, method.stages, method.exponentials) == KNOWN[name]
        assert method.rows is Rows.DIAGONAL
        assert 0.006 < method.principal_error < 0.22

    @pytest.mark.parametrize("name", ["DICG3", "DICG4b"])
    def test_coefficients_are_moderate(self, name):
        method = methods[name]
        assert max(np.abs(method.a).max(), np.abs(method.b).max()) < 0.67
        assert (method.c >= 0).all()
        assert (method.c <= 1).all()

    @pytest.mark.parametrize("name", KNOWN)
    def test_measured_order(self, problem, name):
        order = KNOWN[name][0]
        measured = slope(problem, methods[name], STEPS[order])
        assert measured.order == pytest.approx(order, abs=0.15)

    @pytest.mark.parametrize("name", ["DICG3", "DICG4", "DICG4b"])
    def test_reversed_rows_lose_the_order(self, problem, name):
        method = methods[name]
        reverse = Tableau([row[::-1] for row in method.a[::-1].tolist()], method.b[::-1].tolist())
        assert slope(problem, reverse, (32, 64)).order < 2.5

    @pytest.mark.parametrize("name", ["ImplicitMidpoint", "DICG4b"])
    def test_rational_methods_have_zero_residuals(self, name):
        method = methods[name]
        assert set(residuals_exact(*method.exact, method.order)) == {Fraction(0)}

    def test_order_four_with_three_stages_is_proved_in_the_field_of_a_cube_root(self):
        outer = Cubic.of(Fraction(2, 3), Fraction(1, 3), Fraction(1, 6))
        assert outer * (Cubic.of(2) + Cubic.of(0, -1)) == 1
        inner = outer * -2 + 1
        b = [outer, inner, outer]
        a = [
            [outer / 2, Cubic.of(0), Cubic.of(0)],
            [outer, inner / 2, Cubic.of(0)],
            [outer, inner, outer / 2],
        ]
        trees, expected = forest(5), conditions.condition_trees(4)
        weights = conditions.exact_weights(
            tree_of_rows(a, b), 4, expected, lambda v: v if isinstance(v, Cubic) else Cubic.of(v)
        )
        for tree, weight in zip(expected, weights, strict=True):
            assert weight == Fraction(1, trees.density[tree - 1])
        root = 2 ** (1 / 3)
        number = sum(float(part) * root**k for k, part in enumerate(outer.parts))
        assert methods["DICG4"].b[0] == pytest.approx(number, rel=1e-15)

    def test_dicg3_is_l_stable_where_flows_commute(self):
        a, b = methods["DICG3"].a, methods["DICG3"].b
        assert np.ptp(np.diag(a)) == 0
        limit = 1 - b @ np.linalg.solve(a, np.ones(3))
        assert abs(limit) < 1e-14
        for y in np.logspace(-3, 4, 200):
            stages = np.linalg.solve(np.eye(3) - 1j * y * a, np.ones(3))
            assert abs(1 + 1j * y * (b @ stages)) < 1 + 1e-14


class TestSelfAdjoint:
    @pytest.mark.parametrize("name", SELF_ADJOINT)
    def test_a_step_back_undoes_a_step(self, problem, name):
        equation, _ = problem
        there = step(equation.frame, equation.f, methods[name], 0.2, equation.y0, 0.05)
        back = step(equation.frame, equation.f, methods[name], 0.25, there, -0.05)
        assert equation.frame.distance(there, equation.y0) > 0.01
        assert equation.frame.distance(back, equation.y0) < 1e-14

    def test_other_methods_are_not_self_adjoint(self, problem):
        equation, _ = problem
        there = step(equation.frame, equation.f, methods["DICG3"], 0.2, equation.y0, 0.05)
        back = step(equation.frame, equation.f, methods["DICG3"], 0.25, there, -0.05)
        assert equation.frame.distance(back, equation.y0) > 1e-9

    @pytest.mark.parametrize("name", SELF_ADJOINT)
    def test_stages_are_on_the_path(self, name):
        a, b = methods[name].exact
        assert list(map(list, a)) == on_path(b, [a[r][r] for r in range(len(b))])
        offsets = [a[r][r] - entry / 2 for r, entry in enumerate(b)]
        near = Fraction(1, 10**35)
        assert all(abs(p - q) < near for p, q in zip(b, reversed(b), strict=True))
        assert all(abs(p + q) < near for p, q in zip(offsets, reversed(offsets), strict=True))

    def test_order_four_leaves_two_equations(self):
        """Residuals of any self-adjoint tableau on the path, by the two equations of the docs."""
        rng = np.random.default_rng(8)
        for stages in (3, 4, 5):
            half = [Fraction(int(k), 12) for k in rng.integers(-12, 12, stages // 2)]
            total = sum(half, Fraction())
            middle = [1 - 2 * total] if stages % 2 else []
            if not middle:
                half[-1] += Fraction(1, 2) - total
            b = [*half, *middle, *reversed(half)]
            off = [Fraction(int(k), 12) for k in rng.integers(-12, 12, stages // 2)]
            off = [*off, *[Fraction()] * len(middle), *(-entry for entry in reversed(off))]
            a = on_path(b, [entry / 2 + d for entry, d in zip(b, off, strict=True)])
            c = [sum(row) for row in a]
            middles = [c_r - d for c_r, d in zip(c, off, strict=True)]
            cubes = sum(entry**3 for entry in b) / 12
            first = sum(x * m * d for x, m, d in zip(b, middles, off, strict=True)) - cubes
            second = sum(x * d * d for x, d in zip(b, off, strict=True)) + cubes
            by_tree = dict(
                zip(conditions.condition_trees(3), residuals_exact(a, b, 3), strict=True)
            )
            assert all(by_tree[tree] == 0 for tree in conditions.condition_trees(2))
            for tree in conditions.condition_trees(3)[count(2) :]:
                coefficients = EQUATIONS[forest(4).children[tree - 1]]
                assert by_tree[tree] == coefficients[0] * first + coefficients[1] * second

    def test_the_adjoint_on_the_path_is_on_it(self):
        b = [0.3, -0.2, 0.9]
        a, weights = flat_adjoint(on_path(b, [0.1, 0.4, -0.3]), b)
        np.testing.assert_allclose(a, on_path(weights, np.diag(a)), atol=1e-15)

    def test_elsewhere_it_has_twice_the_stages(self, problem):
        for name, method in methods.items():
            if isinstance(method, Tableau) and not method.approximate and method.order <= 5:
                doubled = adjoint(*method.exact)
                assert max(map(abs, residuals_exact(*doubled, method.order))) < 1e-32, name
        a, b = methods["CG5a"].a.tolist(), methods["CG5a"].b.tolist()
        assert np.abs(residuals(*flat_adjoint(a, b), 4)).max() > 1e-3
        equation, _ = problem
        method = methods["CG3"]
        there = step(equation.frame, equation.f, method, 0.2, equation.y0, 0.05)
        undo = Tableau(*adjoint(*method.exact))
        back = step(equation.frame, equation.f, undo, 0.25, there, -0.05)
        assert equation.frame.distance(back, equation.y0) < 1e-14


def stability(a, b, z):
    """The factor of y' = z y in a step of size 1 in flat space."""
    stages = len(b)
    return 1 + z * np.array(b) @ np.linalg.solve(np.eye(stages) - z * np.array(a), np.ones(stages))


PULLED = Product(SO3(), Euclidean(3))


def pulled(damping):
    """An attitude driven by velocities that are pulled to cos t, and its solution at time 1."""

    def f(t, y):
        return np.concatenate([[0.3, 0.1 * np.sin(t), y[9]], -damping * (y[9:] - np.cos(t))])

    start = np.array([2.0, 1.0, 0.0])

    def velocities(t):
        square = damping**2 + 1.0
        slow = (damping**2 * np.cos(t) + damping * np.sin(t)) / square
        return slow + (start - damping**2 / square) * np.exp(-damping * t)

    def turning(t, y):
        return np.array([0.3, 0.1 * np.sin(t), velocities(t)[0]])

    exact = cg.solve_ivp(
        turning, (0, 1), np.eye(3), frame=SO3(), method="CG5(4)", first_step=1e-3 / damping,
        rtol=1e-11, atol=1e-11,
    )  # fmt: skip
    return f, PULLED.join(np.eye(3), start), PULLED.join(exact.y[-1], velocities(1.0))


class TestDampedPair:
    def test_the_conditions_hold_in_rational_arithmetic(self):
        pair = methods["DICG3(2)"]
        assert (pair.order, pair.embedded_order) == (3, 2)
        assert set(residuals_exact(*pair.exact, 3)) == {Fraction()}
        assert set(residuals_exact(pair.exact[0], pair.exact_embedded, 2)) == {Fraction()}
        assert pair.embedded.principal_error > 0.02
        assert np.abs(pair.b - pair.b_embedded).min() > 0.03

    def test_it_is_stiffly_accurate_with_one_diagonal_entry(self):
        a, b = methods["DICG3(2)"].exact
        assert a[-1] == b
        assert {a[i][i] for i in range(4)} == {Fraction(1, 4)}

    def test_both_weights_are_l_stable(self):
        pair = methods["DICG3(2)"]
        a, b = pair.exact
        ones = [Fraction(1)] * 4  # a x = 1 by forward substitution
        x = []
        for i in range(4):
            x.append((ones[i] - sum((a[i][j] * x[j] for j in range(i)), Fraction())) / a[i][i])
        for weights in (b, pair.exact_embedded):
            assert 1 - sum(w * entry for w, entry in zip(weights, x, strict=True)) == 0
        for weights in (pair.b, pair.b_embedded):
            axis = [abs(stability(pair.a, weights, 1j * y)) for y in np.logspace(-3, 5, 2000)]
            assert max(axis) <= 1.0 + 1e-14
            assert abs(stability(pair.a, weights, -1e6)) < 1e-4
        for name in SELF_ADJOINT:
            method = methods[name]
            assert abs(stability(method.a, method.b, -1e9)) == pytest.approx(1.0, abs=1e-6)

    def test_the_second_weights_have_order_two_on_so3(self, problem):
        pair = methods["DICG3(2)"]
        second = Tableau(pair.entries, pair.embedded_weights)
        assert slope(problem, second, STEPS[2]).order == pytest.approx(2.0, abs=0.15)

    @pytest.mark.parametrize("damping", [1e2, 1e4, 1e6])
    @pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
    def test_it_damps_within_the_tolerance(self, damping, tolerance):
        f, y0, exact = pulled(damping)
        solution = cg.solve_ivp(
            f, (0, 1), y0, frame=PULLED, method="DICG3(2)", rtol=tolerance, atol=tolerance
        )
        assert PULLED.distance(solution.y[-1], exact) < tolerance
        # An explicit method takes more than damping / 5 of them.
        assert len(solution.t) < 200

    def test_large_steps_damp_too_but_not_those_of_self_adjoint_methods(self):
        f, y0, exact = pulled(1e4)
        errors = {
            name: float(
                PULLED.distance(
                    cg.integrate(f, (0, 1), y0, frame=PULLED, method=name, h=0.05).y[-1], exact
                )
            )
            for name in ("DICG3(2)", "DICG3", *SELF_ADJOINT)
        }
        assert errors["DICG3(2)"] < 5e-6
        assert errors["DICG3"] < 1e-3
        assert min(errors[name] for name in SELF_ADJOINT) > 0.2

    def test_a_spacecraft_with_strong_damping(self):
        """Velocities of attitude and body that are tied to each other."""
        craft = load("spacecraft")
        craft.DAMPING = 1e4
        options = {"frame": craft.frame, "method": "DICG3(2)"}
        fine = cg.solve_ivp(craft.f, (0, 2), craft.y0, rtol=1e-7, atol=1e-7, **options)
        coarse = cg.solve_ivp(craft.f, (0, 2), craft.y0, rtol=1e-4, atol=1e-4, **options)
        assert craft.frame.distance(coarse.y[-1], fine.y[-1]) < 1e-4
        assert len(coarse.t) < 200


class TestFewStages:
    @pytest.mark.parametrize("first", [Fraction(-7, 3), Fraction(1, 2), Fraction(3, 4), 5])
    def test_two_stages_never_have_order_three(self, first):
        """With the other conditions on (b, c) met, b c^2 misses 1/3 by 1/(36 b1 b2) - 1/12."""
        b = [Fraction(first), 1 - Fraction(first)]
        c = [(b[0] / 2 - Fraction(1, 6)) / b[0], (b[1] / 2 + Fraction(1, 6)) / b[1]]
        a = [[c[0], 0], [0, c[1]]]
        trees = forest(4)
        by_word = {
            trees.children[tree - 1]: residual
            for tree, residual in zip(
                conditions.condition_trees(3), residuals_exact(a, b, 3), strict=True
            )
        }
        miss = 1 / (36 * b[0] * b[1]) - Fraction(1, 12)
        assert by_word[(1,)] == by_word[(2,)] == by_word[(1, 2)] == 0
        (square,) = [
            value
            for word, value in by_word.items()
            if len(word) == 1 and trees.children[word[0] - 1] == (1, 1)
        ]
        assert square == miss / 2  # Φ([τ, τ]) is c^2 / 2
        assert miss >= Fraction(1, 36) or miss < -Fraction(1, 12)

    @pytest.mark.parametrize("rows", ["diagonal", "full"])
    def test_a_search_with_two_stages_finds_none(self, rows):
        result = search(3, 2, 40, seed=1, rows=rows)
        assert result.methods == ()
        assert result.best.double.f == pytest.approx(6.438886501e-05, rel=1e-6)

    def test_gauss_has_order_two(self):
        root = np.sqrt(3) / 6
        a = [[0.25, 0.25 - root], [0.25 + root, 0.25]]
        b = [0.5, 0.5]
        values = residuals(a, b, 3)
        assert np.abs(values[: count(2)]).max() < 1e-15
        # of the conditions that also hold where flows commute none is missed
        assert np.abs(values).max() == pytest.approx((2 - np.sqrt(3)) / 24, rel=1e-12)
