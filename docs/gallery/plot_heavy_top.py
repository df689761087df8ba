"""
The axis of a heavy top
=======================

The axis of a spinning top under gravity, on the sphere: precession with nutation, for two speeds of
its spin.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

ax = plt.figure(figsize=(5, 4.8), layout="constrained").add_subplot(projection="3d")
inertia, moment = np.array([1.0, 1.0, 0.4]), 2.0  # kg m²; mass times gravity times length (N m)
frame = cg.frames.Product(cg.frames.SO3(), cg.frames.Euclidean(3))


def f(t, y):
    """Return the angular velocity and the rate of the momentum, in body axes."""
    attitude, m = frame.split(y)
    omega = m / inertia
    return np.concatenate([omega, np.cross(m, omega) + moment * np.cross(attitude[2], [0, 0, 1])])


tilted = frame.factors[0].flow([1.1, 0.0, 0.0], np.eye(3))
for spin in (10.0, 16.0):  # rad/s
    y0 = frame.join(tilted, inertia * [0.0, 0.0, spin])
    solution = cg.solve_ivp(f, (0, 9), y0, frame=frame, rtol=1e-8, atol=1e-8, max_step=0.02)
    axis = frame.split(solution.y)[0][:, :, 2]
    cg.plot.trajectory_on_sphere(axis, ax, label=f"spin {spin:g} rad/s")
ax.legend()
plt.show()
