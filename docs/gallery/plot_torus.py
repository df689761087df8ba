"""
A double pendulum on a torus
============================

Two rods in a plane, with angles that are points of the group SO(2), so that a turn more is the same
point. Two starts that differ by a ten-thousandth of a radian separate within some seconds.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

frame = cg.frames.Product(cg.frames.SO(2), cg.frames.SO(2), cg.frames.Euclidean(2))


def angles(y):
    """Return both angles to the downward vertical."""
    return [np.arctan2(y[..., k + 2], y[..., k]) for k in (0, 4)]


def f(t, y):
    """Return the angular velocities and their rates, for rods of 1 m and masses of 1 kg."""
    (first, second), (u, v), g = angles(y), y[8:], 9.81
    c, s = np.cos(first - second), np.sin(first - second)
    right = [-(v**2) * s - 2 * g * np.sin(first), u**2 * s - g * np.sin(second)]
    return [u, v, *np.linalg.solve([[2.0, c], [c, 1.0]], right)]


fig, ax = plt.subplots(figsize=(5, 5), layout="constrained")
for start, colour in ((2.0, "#0072B2"), (2.0001, "#D55E00")):
    turns = [frame.factors[0].flow([angle], np.eye(2)) for angle in (start, 2.5)]
    solution = cg.solve_ivp(
        f, (0, 15), frame.join(*turns, np.zeros(2)), frame=frame, rtol=1e-9, atol=1e-9,
        max_step=0.01,
    )  # fmt: skip
    ax.plot(*angles(solution.y), ".", markersize=1.5, color=colour, label=f"first angle {start}")
ax.set(xlabel="first angle (rad)", ylabel="second angle (rad)", aspect="equal")
ax.legend(markerscale=6)
plt.show()
