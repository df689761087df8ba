"""Ask Singular for each tree of points whether its order conditions have a common zero.

``python -m research.impossibility.eliminate_trees ORDER POINTS`` takes all trees of POINTS
points, of which the last is the result and the others are stages. It prints whether 1 is in the
ideal of the conditions, over the rational numbers or modulo a prime. Unlike the proofs of
`research.impossibility`, these Gröbner bases can't be checked without Singular.

Unknowns are the weights of each point on all stages but the first, their sum with the first, the
letters with two or three nodes on the flows to the result, and Φ_i([τ]) at the stages. With names
of their own for these, conditions have low degrees.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from cg.construction.conditions import condition_trees
from cg.construction.trees import forest
from research.impossibility import PointsShape, point_shapes
from research.impossibility.ring import Ring, singular
from research.impossibility.weights import word_weights

MIN_FLOWS = {3: 2, 4: 2, 5: 3, 6: 4, 7: 5}  # to the result, by the order: research.impossibility


class Conditions:
    """Order conditions of a tree of points, with names for common subexpressions.

    `equations` are the definitions of the names, and the conditions.
    """

    def __init__(self, shape: PointsShape, order: int) -> None:
        trees = forest(order + 1)
        points = range(shape.stages)
        self.path = shape.tree.path(shape.tree.result)
        named = [t for t in range(2, len(trees) + 1) if trees.nodes[t - 1] <= 3]
        self.ring = Ring(
            [
                *(f"w{m}_{k}" for m in reversed(points) for k in range(m, 0, -1)),
                *(f"q{i}" for i in reversed(points) if i >= 2),
                *(f"z{t}_{m}" for m in reversed(self.path) for t in reversed(named)),
                *(f"e{m}" for m in reversed(points)),
            ]
        )
        zero, one = self.ring.number(0), self.ring.number(1)
        self.equations: list[Any] = []
        weights = []
        for m in points:
            others = [self.ring[f"w{m}_{k}"] for k in range(1, m + 1)]
            weights.append([self.ring[f"e{m}"] - sum(others, zero), *others])
        letters: dict[int, list[Any]] = {}
        for t in range(1, trees.with_nodes(order).stop):
            word = trees.children[t - 1]
            at = word_weights(shape.tree, points, word, letters, one)
            phi = [at[i - 1] for i in points]
            if word == (2,):
                phi[2:] = [self._name(f"q{i}", phi[i]) for i in points[2:]]
            letters[t] = []
            for m in points:
                value = sum((w * phi[k] for k, w in enumerate(weights[m])), zero)
                if t in named and m in self.path:
                    value = self._name(f"z{t}_{m}", value)
                letters[t].append(value)
        for t in condition_trees(order, independent=True):
            ends = word_weights(shape.tree, points, trees.children[t - 1], letters, one)
            self.equations.append(ends[shape.stages - 1] - one / trees.density[t - 1])

    def _name(self, name: str, value: Any) -> Any:
        self.equations.append(self.ring[name] - value)
        return self.ring[name]


def has_none(conditions: Conditions, characteristic: int, seconds: float) -> bool | None:
    """Return whether 1 is in the ideal; None if that takes too long."""
    program = (
        f"ring r = {characteristic}, ({','.join(conditions.ring.names)}), dp;\n"
        f"ideal I = {','.join(map(str, conditions.equations))};\n"
        "print(slimgb(I)); quit;\n"
    )
    try:
        return singular(program, seconds).strip() == "1"
    except subprocess.TimeoutExpired:
        return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 if no tree can have a method of the order."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("order", type=int, choices=sorted(MIN_FLOWS))
    parser.add_argument("points", type=int)
    parser.add_argument("--characteristic", type=int, default=0, help="a prime, or 0")
    parser.add_argument("--seconds", type=float, default=15.0, help="for each tree")
    parser.add_argument("--parents", help="only this tree, as in '-1 -1 0 2'")
    chosen = parser.parse_args(arguments)
    left = 0
    for shape in point_shapes(chosen.points):
        if chosen.parents and chosen.parents.split() != str(shape).split():
            continue
        if len(shape.tree.path(shape.tree.result)) < MIN_FLOWS[chosen.order]:
            continue
        begin = time.perf_counter()
        none = has_none(Conditions(shape, chosen.order), chosen.characteristic, chosen.seconds)
        left += none is not True
        took = round(time.perf_counter() - begin, 2)
        print(json.dumps({"parents": shape.parents, "none": none, "seconds": took}), flush=True)
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
