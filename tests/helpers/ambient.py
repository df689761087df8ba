"""Solutions of equations on manifolds by SciPy, in the space around."""

import numpy as np
from scipy.integrate import solve_ivp


def solve_in_ambient_space(frame, f, y0, times, rtol=1e-13, atol=1e-15):
    """Return the points of the solution of y' = field(f(t, y), y), from time 0, at times."""

    def derivative(t, z):
        y = z.view(frame.dtype).reshape(frame.point_shape)
        return np.ascontiguousarray(frame.field(f(t, y), y)).reshape(-1).view(float)

    start = np.ascontiguousarray(y0).reshape(-1).view(float)
    span = (0, times[-1])
    run = solve_ivp(derivative, span, start, method="DOP853", t_eval=times, rtol=rtol, atol=atol)
    points = np.ascontiguousarray(run.y.T).view(frame.dtype)
    return points.reshape(-1, *frame.point_shape)
