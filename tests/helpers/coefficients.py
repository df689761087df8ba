"""Coefficients of classical tableaux of the literature, and of trees of points."""

import numpy as np

import cg

KUTTA = cg.Tableau([[], ["1/2"], [-1, 2]], ["1/6", "2/3", "1/6"], name="Kutta")
CLASSICAL = cg.Tableau(
    [[], ["1/2"], [0, "1/2"], [0, 0, 1]], ["1/6", "1/3", "1/3", "1/6"], name="classical"
)
FEHLBERG_A = [
    [], ["1/4"], ["3/32", "9/32"], ["1932/2197", "-7200/2197", "7296/2197"],
    ["439/216", "-8", "3680/513", "-845/4104"],
    ["-8/27", "2", "-3544/2565", "1859/4104", "-11/40"],
]  # fmt: skip
FEHLBERG_B = (
    ["25/216", "0", "1408/2565", "2197/4104", "-1/5", "0"],
    ["16/135", "0", "6656/12825", "28561/56430", "-9/50", "2/55"],
)
FEHLBERG = cg.Tableau(FEHLBERG_A, FEHLBERG_B[1], b_embedded=FEHLBERG_B[0])


CF3 = [(-1, {0: "1/3"}), (-1, {1: "2/3"}), (0, {0: "-1/12", 2: "3/4"})]


def values(tree):
    """Return the weights of all points, packed."""
    return [weight for point in tree.points for weight in point.weights.values()]


def floats(tree):
    """Return the weights of all points as doubles."""
    return np.array(values(tree), dtype=np.float64)
