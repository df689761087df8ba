"""
Point vortices on a sphere
==========================

Four vortices, one of them of the opposite sign. A point of `Power(Sphere(2), 4)` has all of them.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

strength = np.array([1.0, 1.0, -0.5, 0.8])
frame = cg.frames.Power(cg.frames.Sphere(2), 4)


def f(t, x):
    """Return the angular velocity with which each vortex moves."""
    apart = 1.0 - x @ x.T
    np.fill_diagonal(apart, np.inf)
    return ((strength / apart) @ x / (4 * np.pi)).ravel()


x0 = frame.random_point(np.random.default_rng(3))
solution = cg.solve_ivp(f, (0, 40), x0, frame=frame, rtol=1e-8, atol=1e-8, max_step=0.2)

ax = plt.figure(figsize=(5, 4.8), layout="constrained").add_subplot(projection="3d")
for k in range(4):
    cg.plot.trajectory_on_sphere(solution.y[:, k], ax, label=f"strength {strength[k]:g}")
ax.legend()
plt.show()
