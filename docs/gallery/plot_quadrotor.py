"""
A quadrotor on SE(3)
====================

A quadrotor that starts turned over by 120 degrees follows a helix under the geometric controller
of Lee, Leok and McClamroch (2010). The state is a pose with a twist; no attitude is singular.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

inertia, mass, gravity = np.array([0.082, 0.0845, 0.1377]), 4.34, 9.81
up = np.array([0.0, 0.0, 1.0])
frame = cg.frames.Product(cg.frames.SE3(), cg.frames.Euclidean(6))


def path(t):
    """Return the commanded position, velocity and acceleration."""
    c, s = np.cos(t), np.sin(t)
    return np.array([c, s, t / 4]), np.array([-s, c, 0.25]), np.array([-c, -s, 0.0])


def f(t, y):
    """Return the twist in body axes, and its rate."""
    pose, (omega, v) = y[:16].reshape(4, 4), y[16:].reshape(2, 3)
    attitude, position = pose[:3, :3], pose[:3, 3]
    wanted, speed, acceleration = path(t)
    force = mass * (
        4 * (wanted - position) + 3 * (speed - attitude @ v) + acceleration + gravity * up
    )
    third = force / np.linalg.norm(force)
    second = np.cross(third, [1.0, 0.0, 0.0])
    second /= np.linalg.norm(second)
    turn = attitude.T @ np.stack([np.cross(second, third), second, third], axis=1)
    error = 0.5 * cg.frames.vee(turn.T - turn)
    torque = -8.81 * error - 2.54 * omega
    rate = (torque - np.cross(omega, inertia * omega)) / inertia
    thrust = force @ attitude[:, 2]
    push = thrust / mass * up - gravity * attitude[2] - np.cross(omega, v)
    return np.concatenate([omega, v, rate, push])


start = cg.frames.SE3().flow([2.1, 0.0, 0.0, 0.0, 0.0, 0.0], np.eye(4))
solution = cg.solve_ivp(
    f, (0, 12), frame.join(start, np.zeros(6)), frame=frame, rtol=1e-8, atol=1e-8, max_step=0.02
)

poses = solution.y[:, :16].reshape(-1, 4, 4)
flown, wanted = poses[:, :3, 3], np.array([path(t)[0] for t in solution.t])
fig = plt.figure(figsize=(5.6, 5.2), layout="constrained")
ax = fig.add_subplot(projection="3d")
ax.plot(*wanted.T, "--", color="#999999", label="commanded")
ax.plot(*flown.T, color="#0072B2", label="flown")
for pose in poses[:: len(poses) // 25]:
    ax.quiver(*pose[:3, 3], *(0.4 * pose[:3, 2]), color="#D55E00", linewidth=1)
ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)", zlabel="$z$ (m)")
ax.legend()
plt.show()
