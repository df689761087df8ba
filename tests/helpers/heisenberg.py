"""A frame whose flows take additions and products alone, so that C has the same bits.

It is the Heisenberg group, moved from the right; right-hand side, flow and dexp⁻¹ are written in
C as they are here.
"""

import numpy as np

from cg.frames.base import Frame

START = (0.3, -0.4, 0.7)
TIME = 0.25
STEP = 0.375


def field(t, y):
    x, z, w = y[..., 0], y[..., 1], y[..., 2]
    return np.stack([0.3 + z * w - 0.5 * t, x * x - 0.2 * w, t * x + z], axis=-1)


class Heisenberg(Frame):
    dim = 3
    point_shape = (3,)

    def field(self, v, y):
        turn = 0.5 * (y[..., 0] * v[..., 1] - y[..., 1] * v[..., 0])
        return np.stack([v[..., 0], v[..., 1], v[..., 2] + turn], axis=-1)

    def flow(self, v, y):
        return y + self.field(v, y)

    def membership_error(self, y):
        return np.zeros(np.shape(y)[:-1])

    def random_point(self, rng, size=()):
        return rng.standard_normal((*np.atleast_1d(size), 3))

    def _bracket(self, u, v):
        last = u[..., 1] * v[..., 0] - u[..., 0] * v[..., 1]
        return np.stack([0 * last, 0 * last, last], axis=-1)


def dexpinv(u, v):
    return np.array([v[0], v[1], v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1])])


C = """
static int field(double t, const double *y, double *f, void *data)
{
    (void)data;
    f[0] = 0.3 + y[1] * y[2] - 0.5 * t;
    f[1] = y[0] * y[0] - 0.2 * y[2];
    f[2] = t * y[0] + y[1];
    return 0;
}
static int flow(const double *v, double *y, void *data)
{
    double turn = 0.5 * (y[0] * v[1] - y[1] * v[0]);
    (void)data;
    y[0] = y[0] + v[0];
    y[1] = y[1] + v[1];
    y[2] = y[2] + (v[2] + turn);
    return 0;
}
static int dexpinv(const double *u, double *v, void *data)
{
    (void)data;
    v[2] = v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1]);
    return 0;
}
"""
