"""A body that samples drive."""

import numpy as np

from cg.frames import SO3, Euclidean, Product

FRAME, LINE = Product(SO3(), Euclidean(3)), Euclidean(1)
START = np.concatenate([np.eye(3).ravel(), [0.3, -0.2, 0.5]])
GUSTS = np.linspace(-0.5, 2.5, 11), np.random.default_rng(4).standard_normal(11)
GAIN = [1.5]
TIGHT = {"rtol": 1e-11, "atol": 1e-11}  # far below the bounds of tests: runs are references


def driven(t, y, u, p):
    moment, gust = u
    slope = p[0] * moment - y[9:]
    slope[0] += gust
    return np.concatenate([y[9:], slope])
