"""Move the last node of CF5(4) to the end of the step.

The estimate of a pair without a node there doesn't see a jump of the field after its last node.
From the pair of research/make_commutator_free_methods.py, with a second result of
research/make_second_results.py, the sum of the weights on the way to the last stage moves to 1
along the solution set. Random steps within the set and Gauss–Newton steps down the principal error
follow. A weight of the estimate is held, or it would vanish.

    python research/make_end_node.py FOLDER [NAME ...]
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from recipes import run
from scipy import linalg

import cg
from cg.construction.candidate import Candidate, pack_method, to_method
from cg.construction.conditions import core_calls as compiled_conditions
from cg.construction.layouts.points import START
from cg.construction.solvers.system import next_trees

Vector = NDArray[np.float64]

NAME = "CF5(4)"
STAGE, WEIGHT = 4, 0.09  # of the estimate, that is held
STARTS, SIZE, MOVES = 150, 0.6, 15
BOUND, SECOND = 1.5, 0.02  # of weights; share of the error of the second result
CLOSE = 1e-12
NOTE = ", last node moved to the end of the step; the second result by flows of its own"


@dataclass(frozen=True)
class Constrained:
    """The order conditions of a pair, with the last node and a weight of its estimate."""

    start: Candidate

    @cached_property
    def rows(self) -> Vector:
        """The sums of packed weights that are held, shape (2, size)."""
        layout = self.start.system.layout

        def sums(point: int, stages: range) -> Vector:
            row = np.zeros(layout.size)
            while point != START:
                for k, place in enumerate(layout.weights[point], layout.starts[point]):
                    row[k] = place in stages
                point = layout.parents[point]
            return row

        node = sums(layout.stage_points[-1], range(layout.stages))
        first, second = (sums(end, range(STAGE, STAGE + 1)) for end in layout.results)
        return np.array([node, second - first])

    def retract(self, x: Vector, values: Vector) -> tuple[Vector, Vector, float]:
        """Return the nearest solution, the directions that stay close to it, and its residual."""
        system = self.start.system
        for _ in range(30):
            residual = np.append(system.residual(x), self.rows @ x - values)
            jacobian = np.vstack([system.jacobian(x), self.rows])
            left, singular, right = linalg.svd(jacobian)
            rank = int(np.sum(singular > 1e-9 * singular[0]))
            if np.abs(residual).max() < 5e-15:
                break
            x = x - right[:rank].T @ ((left[:, :rank].T @ residual) / singular[:rank])
        return x, right[rank:].T, float(np.abs(residual).max())

    def errors(self, x: Vector) -> tuple[Vector, Vector]:
        """Return the principal errors and excesses of weights, and their derivatives."""
        order, layout = self.start.system.order, self.start.system.layout
        second = replace(layout, results=layout.results[1:])
        problems = (1.0, order + 1, layout), (SECOND, order, second)
        excess = np.sign(x) * np.maximum(np.abs(x) - BOUND, 0.0)
        values, slopes = [0.1 * excess], [np.diag(0.1 * (excess != 0))]
        for share, next_order, one in problems:
            arguments = next_order, one, x, next_trees(next_order - 1)
            values.append(share * compiled_conditions.residuals(*arguments))
            slopes.append(share * compiled_conditions.jacobian(*arguments))
        return np.concatenate(values), np.vstack(slopes)

    def minimised(self, x: Vector, values: Vector) -> Vector:
        """Return the end of damped Gauss–Newton steps within the solution set."""
        damping = 1e-2
        x, directions, _ = self.retract(x, values)
        while damping < 1e3:
            residual, jacobian = self.errors(x)
            jacobian = jacobian @ directions
            normal = jacobian.T @ jacobian
            scale = damping * np.trace(normal) / len(normal)
            step = -linalg.solve(normal + scale * np.eye(len(normal)), jacobian.T @ residual)
            step *= min(1.0, 0.3 / linalg.norm(step))
            trial, beside, off = self.retract(x + directions @ step, values)
            f, trial_f = np.sum(residual**2), np.sum(self.errors(trial)[0] ** 2)
            if off < CLOSE and trial_f < f:
                x, directions, damping = trial, beside, max(damping / 5, 1e-8)
                if trial_f > (1 - 1e-4) * f:
                    break
            else:
                damping *= 4
        return x


def make(name: str) -> cg.CommutatorFree:
    """Return the pair with the least principal error."""
    method = cg.methods[name]
    problem = Constrained(pack_method(method))
    # a rounding before the end, so that no evaluation is beyond it
    x, end = problem.start.x, np.array([1.0 - 1e-13, WEIGHT])
    begin = problem.rows @ x
    for part in np.linspace(0, 1, MOVES + 1)[1:]:
        x, directions, _ = problem.retract(x, begin + part * (end - begin))
    ends = []
    for seed in range(STARTS):
        random, moved, movable = np.random.default_rng(seed), x, directions
        for _ in range(3):
            step = random.standard_normal(movable.shape[1]) * SIZE / np.sqrt(movable.shape[1])
            moved, movable, off = problem.retract(moved + movable @ step, end)
        if off < CLOSE:
            ends.append(Candidate(problem.start.system, problem.minimised(moved, end)))
    best = min(ends, key=lambda candidate: candidate.principal_error)
    pair = to_method(best, name=name, source=method.source.split(";")[0].removesuffix(NOTE) + NOTE)
    assert isinstance(pair, cg.CommutatorFree)
    return pair


if __name__ == "__main__":
    run(make, [NAME], __doc__)
