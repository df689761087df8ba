"""A rotation whose velocity depends on time and point."""

import numpy as np

OPTIONS = {"rtol": 1e-6, "atol": 1e-7}


def turning(t, y):
    return [0.1 + y[0, 0], np.cos(t), np.sin(t) * y[1, 2]]
