"""Right-hand sides on any frame with their derivatives, which differences estimate too."""

import numpy as np
from quotients import derivative

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

    def solve(self, y0=None, p=None, span=SPAN, **options):
        defaults = {"frame": self.frame, "parameters": self.parameters if p is None else p} | TIGHT
        y0 = self.y0 if y0 is None else y0
        return cg.solve_ivp(self.f, span, y0, **(defaults | options))

    def derivatives(self, span=SPAN, exact=True, **options):
        defaults = {"frame": self.frame, "parameters": self.parameters} | TIGHT
        if exact:
            defaults |= {"jac": self.jac, "df_dp": self.df_dp}
        return cg.solve_variational(self.f, span, self.y0, **(defaults | options))

    def by_fields(self, v, bound, **options):
        """Return the derivative of the end along a field at the start."""
        start = lambda s: self.frame.flow(s * v, self.y0)
        return derivative(lambda s: self.solve(start(s), **options).y[-1], bound)

    def by_parameters(self, v, bound, **options):
        end = lambda s: self.solve(p=self.parameters + s * v, **options).y[-1]
        return derivative(end, bound)


def flat(y):
    return np.ascontiguousarray(y).reshape(-1).view(np.float64)
