"""Elementary weights in NumPy: what the compiled residual is compared with."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray

from cg.conditions import condition_trees, unpack
from cg.trees.ordered import forest


class NumpyResidual:
    """Residuals of the independent order conditions, all rows of a tableau at once.

    Parameters
    ----------
    order, stages : int
    """

    def __init__(self, order: int, stages: int) -> None:
        trees = forest(order + 1)
        inner = trees.children[1 : trees.with_nodes(order).stop - 1]
        self.stages = stages
        self.inner = [np.array(word) - 1 for word in inner]
        conditions = condition_trees(order, independent=True)
        self.words = [np.array(trees.children[t - 1]) - 1 for t in conditions]
        self.right_sides = np.array([1.0 / trees.density[t - 1] for t in conditions])

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``Φ(t) - 1/γ(t)``, shape ``(m,)``, at packed coefficients."""
        rows, weights = unpack(x, self.stages)
        table = np.array([*rows, weights])  # the row of b counts as one more stage
        phi = np.ones((self.stages + 1, len(self.inner) + 1))
        for tree, word in enumerate(self.inner, start=1):
            phi[:, tree] = self._weight(table, phi, word)
        weights_of_words = np.array([self._weight(table[-1:], phi, word)[0] for word in self.words])
        return np.asarray(weights_of_words - self.right_sides)

    def _weight(
        self, table: NDArray[np.float64], phi: NDArray[np.float64], word: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Sum over all ways to give the letters of a word to stages that don't decrease."""
        letters = len(word)
        taken = np.zeros((letters + 1, len(table)))
        taken[0] = 1.0
        for stage in range(self.stages):
            for end in range(letters, 0, -1):
                product = np.ones(len(table))
                for begin in range(end - 1, -1, -1):
                    product = product * table[:, stage] * phi[stage, word[begin]]
                    taken[end] += taken[begin] * product / factorial(end - begin)
        return np.asarray(taken[letters])
