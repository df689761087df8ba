"""A second proof of certificates, which shares no code with `cg.construction.proofs`.

From the text of a method and of its certificate, with the trees of `cg.construction`: weights by
their definition and derivatives carried along, in balls; then Krawczyk's test in the certificate's
box. Conditions of Lyndon words imply all others. Of conditions that a certificate leaves out it
shows that they are below 1e-25 in the box, not that they follow.
``PYTHONPATH=. python tests/independent_verifier.py FOLDER`` proves all that are there: methods in
it, certificates in ``certificates`` below.
"""

import sys
import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
from flint import arb, arb_mat, ctx, fmpq

from cg.construction.points import Point, PointTree
from cg.construction.trees import OrderedTree, forest
from cg.support.quads import to_flint
from research.impossibility.weights import exact_weights

MAX_RESIDUAL = 1e-25  # residual of a condition that is left out


class NotProvedError(Exception):
    """The statement of a certificate is not proved."""


class Dual:
    """A ball with its derivatives by the free unknowns."""

    def __init__(self, value, slope):
        self.value, self.slope = value, slope

    def __add__(self, other):
        return Dual(self.value + other.value, self.slope + other.slope)

    def __mul__(self, other):
        if not isinstance(other, Dual):
            return Dual(self.value * other, self.slope * other)
        slope = self.slope * other.value + other.slope * self.value
        return Dual(self.value * other.value, slope)

    def __truediv__(self, number):
        return Dual(self.value / number, self.slope / number)


def read_points(entry):
    """Return points as (parent, [(stage, name, number)]), where stages are, and both results."""
    if "points" in entry:
        points = [
            (p["parent"], [(int(k), f"w_{m},{int(k) + 1}", w) for k, w in p["weights"].items()])
            for m, p in enumerate(entry["points"], 1)
        ]
        results = [entry["result"], entry.get("embedded_result")]
        return points, entry["stage_points"], [r for r in results if r is not None]
    points, ends = [], []
    rows = [(f"a_{i},", row) for i, row in enumerate(entry["a"], 1)] + [("b_", entry["b"])]
    if "b_embedded" in entry:
        rows.append(("b_embedded_", entry["b_embedded"]))
    for label, row in rows:
        at = -1
        for stage, number in enumerate(row):
            points.append((at, [(stage, f"{label}{stage + 1}", number)]))
            at = len(points) - 1
        ends.append(at)
    stages = len(entry["b"])
    return points, ends[:stages], ends[stages:]


def exact(number):
    """Return the number in a text."""
    text = str(number)
    return Fraction(float.fromhex(text)) if "0x" in text else Fraction(text)


class Problem:
    """The conditions of a method in the free unknowns of a certificate."""

    def __init__(self, entry, certificate):
        self.points, self.at, self.results = read_points(entry)
        fixed = set(certificate["fixed"])
        self.start = {n: exact(x) for _, terms in self.points for _, n, x in terms}
        self.free = [name for name in self.start if name not in fixed]
        self.orders = [certificate["order"]]
        if "embedded" in certificate:
            self.orders.append(certificate["embedded"]["order"])
        self.trees = forest(max(self.orders) + 2)

    def duals(self, radius):
        """Return all coefficients, the free ones in their box."""
        size = len(self.free)
        duals = {}
        for name, value in self.start.items():
            slope = arb_mat(1, size)
            ball = arb(fmpq(value.numerator, value.denominator))
            if name in self.free:
                slope[0, self.free.index(name)] = 1
                ball = ball + arb(0, radius)
            duals[name] = Dual(ball, slope)
        return duals

    def weights(self, x, conditions, number):
        """Return the weights of trees at results, for pairs (result, tree)."""
        points = tuple(Point(at, {k: x[n] for k, n, _ in terms}) for at, terms in self.points)
        order = max(self.trees.nodes[tree - 1] for _, tree in conditions) - 1
        actual = {}
        for result, end in enumerate(self.results):
            pairs = [pair for pair in conditions if pair[0] == result]
            tree = PointTree(points, tuple(self.at), end)
            weights = exact_weights(tree, order, [tree for _, tree in pairs], number)
            actual |= zip(pairs, weights, strict=True)
        return [actual[pair] for pair in conditions]

    def conditions(self, table):
        """Return results and trees of the conditions that are equations, and of those left out."""
        left_out = [
            (row, self.trees.index(OrderedTree.parse(tree)))
            for row, key in enumerate(("trees", "embedded_trees"))
            for tree in table.get(key, [])
        ]
        independent = [
            (result, tree)
            for result, order in enumerate(self.orders)
            for tree in range(2, self.trees.with_nodes(order + 1).stop)
            if self.trees.is_independent(tree)
        ]
        if len(set(left_out)) != len(left_out) or not set(left_out) <= set(independent):
            raise NotProvedError("conditions that are left out must be distinct independent ones")
        return [one for one in independent if one not in left_out], left_out

    def residuals(self, radius, conditions):
        """Return residuals in the box, with their derivatives."""
        one, duals = Dual(arb(1), arb_mat(1, len(self.free))), self.duals(radius)
        weights = self.weights(duals, conditions, lambda x: x if isinstance(x, Dual) else one)
        targets = [arb(1) / self.trees.density[tree - 1] for _, tree in conditions]
        return [Dual(w.value - t, w.slope) for w, t in zip(weights, targets, strict=True)]


def verify(entry, certificate):
    """Prove a certificate; NotProvedError if that fails."""
    problem = Problem(entry, certificate)
    if certificate["name"] != entry["name"]:
        raise NotProvedError("it has another name")
    ctx.prec = certificate["bits"]
    expected, left_out = problem.conditions(certificate.get("left_out", {}))
    radius = exact(certificate["radius"])
    ball = arb(fmpq(radius.numerator, radius.denominator))
    if radius == 0:
        weights = problem.weights(problem.start, expected, to_flint)
        for (_, tree), w in zip(expected, weights, strict=True):
            if problem.free or left_out or w * problem.trees.density[tree - 1] != 1:
                raise NotProvedError("a condition is violated, or coefficients aren't fixed")
    else:
        size = len(expected)
        if size != len(problem.free):
            raise NotProvedError("there must be as many unknowns as conditions")
        at, around = problem.residuals(0, expected), problem.residuals(ball.upper(), expected)
        slopes = [[float(r.slope[0, k].mid()) for k in range(size)] for r in at]
        inverse = arb_mat(np.linalg.inv(np.array(slopes)).tolist())
        steps = inverse * arb_mat([[r.value] for r in at])
        enclosed = arb_mat([[r.slope[0, k] for k in range(size)] for r in around])
        product = inverse * enclosed
        for i in range(size):
            total = sum((abs(product[i, j] - int(i == j)) for j in range(size)), arb(0))
            if not abs(steps[i, 0]) + ball * total < ball:
                raise NotProvedError(f"the image isn't inside the box at {problem.free[i]}")
        if left_out and not all(
            abs(r.value) < MAX_RESIDUAL for r in problem.residuals(ball.upper(), left_out)
        ):
            raise NotProvedError("a condition that is left out isn't small")
    claims = [certificate["beyond"], certificate.get("embedded")]
    for result, order in enumerate(problem.orders):
        tree = problem.trees.index(OrderedTree.parse(claims[result]["tree"]))
        bound = exact(claims[result]["bound"])
        residual = problem.residuals(ball.upper(), [(result, tree)])[0].value
        if problem.trees.nodes[tree - 1] != order + 2 or bound <= 0:
            raise NotProvedError("the violated condition must be one of the next order")
        if not abs(residual) >= arb(fmpq(bound.numerator, bound.denominator)):
            raise NotProvedError("the condition isn't violated by as much")


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).glob("certificates/*.toml")):
        text = tomllib.loads(path.read_text("utf-8"))
        verify(tomllib.loads((path.parent.parent / path.name).read_text("utf-8")), text)
        print("proved", text["name"], flush=True)
