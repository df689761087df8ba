"""Coefficients of trees of points."""

import numpy as np

CF3 = [(-1, {0: "1/3"}), (-1, {1: "2/3"}), (0, {0: "-1/12", 2: "3/4"})]


def values(tree):
    """Return the weights of all points, packed."""
    return [weight for point in tree.points for weight in point.weights.values()]


def floats(tree):
    """Return the weights of all points as doubles."""
    return np.array(values(tree), dtype=np.float64)
