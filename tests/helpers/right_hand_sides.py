"""Right-hand sides in the plane and on rotations, and events of the first."""

import numpy as np

import cg
from cg.frames import Euclidean

CIRCLE = {"frame": Euclidean(2), "rtol": 1e-8, "atol": 1e-8}


def circle(t, y, *_):
    return [-y[1], y[0]]


def height(t, y):
    return y[1]


def solve(events, t_span=(0.1, 10.0), **options):
    y0 = [np.cos(t_span[0]), np.sin(t_span[0])]
    return cg.solve_ivp(circle, t_span, y0, events=events, **(CIRCLE | options))


OPTIONS = {"rtol": 1e-6, "atol": 1e-7}


def turning(t, y):
    return [0.1 + y[0, 0], np.cos(t), np.sin(t) * y[1, 2]]
