"""
A fan of attitudes
==================

Three hundred bodies with inertias and spins that differ by a few per cent: where their third axes
point after 0, 4, 8 and 12 seconds. One call of `cg.solve_ensemble` integrates all.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

rng = np.random.default_rng(5)
members = 300
frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
inertia = np.array([1.0, 2.0, 2.5]) * rng.normal(1.0, 0.02, (members, 3))


def f(t, y, inertia):
    """Return the angular velocities and the rates of the momenta of some members."""
    m = y[:, 4:]
    omega = m / inertia
    return np.concatenate([omega, np.cross(m, omega)], axis=1)


momenta = rng.normal([0.5, 0.2, 1.0], 0.02, (members, 3))
y0 = np.concatenate([np.tile([0.0, 0.0, 0.0, 1.0], (members, 1)), momenta], axis=1)
times = [0, 4, 8, 12]
solution = cg.solve_ensemble(
    f, (0, 12), y0, frame=frame, parameters=inertia, vectorized=True, t_eval=times,
    rtol=1e-7, atol=1e-7,
)  # fmt: skip

ax = plt.figure(figsize=(5.2, 5), layout="constrained").add_subplot(projection="3d")
mean = cg.solve_ivp(
    lambda t, y: f(t, y[None], np.array([[1.0, 2.0, 2.5]]))[0], (0, 12),
    frame.join([0, 0, 0, 1.0], [0.5, 0.2, 1.0]), frame=frame, max_step=0.05,
)  # fmt: skip
turn = frame.factors[0].as_rotation
cg.plot.trajectory_on_sphere(turn(mean.y[:, :4]).apply([0.0, 0.0, 1.0]), ax)
for time, points, colour in zip(
    times, solution.y, ["#000000", "#009E73", "#E69F00", "#D55E00"], strict=True
):
    axes = turn(points[:, :4]).apply([0.0, 0.0, 1.0])
    ax.scatter(*axes.T, s=4, color=colour, label=f"after {time} s")
ax.legend()
plt.show()
