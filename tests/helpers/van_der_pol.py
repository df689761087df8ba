"""Van der Pol's equation, which is stiff, for RadauIIA5."""

import numpy as np
from scipy import sparse

import cg
from cg.frames import Euclidean

PLANE = Euclidean(2)
START = [2.0, 0.0]
MU = 100.0


def van_der_pol(t, y):
    return np.array([y[1], MU * (1.0 - y[0] ** 2) * y[1] - y[0]])


def jacobian(t, y):
    return np.array([[0.0, 1.0], [-2.0 * MU * y[0] * y[1] - 1.0, MU * (1.0 - y[0] ** 2)]])


def sparse_jacobian(t, y):
    return sparse.csr_array(jacobian(t, y))


def solve(f=van_der_pol, t1=200.0, y0=START, frame=PLANE, **options):
    options = {"method": "RadauIIA5", "rtol": 1e-6, "atol": 1e-6} | options
    return cg.solve_ivp(f, (0, t1), y0, frame=frame, **options)
