"""Right-hand sides on any frame with their derivatives."""

import numpy as np

import cg

TIGHT = {"rtol": 1e-12, "atol": 1e-12}
SPAN = (0.1, 0.8)


class Wave:
    """Coefficients sin(B y + c cos t + C p) / 3 on any frame, with their derivatives."""

    def __init__(self, frame, k=2, seed=0):
        rng = np.random.default_rng(seed)
        self.frame = frame
        self.y0 = frame.random_point(rng)
        n, width = frame.dim, flat(self.y0).size
        self.b = rng.standard_normal((n, width)) / np.sqrt(width)
        self.c = rng.standard_normal(n)
        self.d = rng.standard_normal((n, k))
        self.parameters = rng.standard_normal(k)

    def phase(self, t, y, p):
        return self.b @ flat(y) + self.c * np.cos(t) + self.d @ p

    def f(self, t, y, p):
        return np.sin(self.phase(t, y, p)) / 3

    def jac(self, t, y, p):
        tangents = np.array([flat(e) for e in self.frame.field(np.eye(self.frame.dim), y)])
        return np.cos(self.phase(t, y, p))[:, None] * (self.b @ tangents.T) / 3

    def df_dp(self, t, y, p):
        return np.cos(self.phase(t, y, p))[:, None] * self.d / 3

    def derivatives(self, **options):
        defaults = {"frame": self.frame, "parameters": self.parameters} | TIGHT
        defaults |= {"jac": self.jac, "df_dp": self.df_dp}
        return cg.solve_variational(self.f, SPAN, self.y0, **(defaults | options))


def flat(y):
    return np.ascontiguousarray(y).reshape(-1).view(np.float64)
