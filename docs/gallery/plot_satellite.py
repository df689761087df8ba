"""
A satellite with reaction wheels
================================

Three wheels turn a satellite on a low orbit to its commanded attitude, at rest in orbit axes, and
then hold it against the gravity gradient, for two orbits. The state is a unit quaternion with six
numbers.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

inertia = np.array([[60.0, 0.0, 5.0], [0.0, 80.0, 0.0], [5.0, 0.0, 45.0]])  # kg m²
orbit_rate = 1.1e-3  # rad/s, about the third orbit axis
gains = 0.08, 4.0  # N m, N m s
frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(6))


def f(t, y):
    """Return the angular velocity relative to the orbit, and rates of the body and the wheels."""
    q, omega, wheels = y[:4], y[4:7], y[7:]
    to_orbit = frame.factors[0].as_rotation(q).as_matrix()
    up, normal = to_orbit[0], to_orbit[2]  # orbit axes in the body
    relative = omega - orbit_rate * normal
    gravity = 3 * orbit_rate**2 * np.cross(up, inertia @ up)
    motor = gains[0] * np.sign(q[3]) * q[:3] + gains[1] * relative - np.cross(omega, wheels)
    torque = gravity - motor - np.cross(omega, inertia @ omega + wheels)
    return np.concatenate([relative, np.linalg.solve(inertia, torque), motor])


start = np.array([0.6, -0.3, 0.5, 0.55])
y0 = frame.join(start / np.linalg.norm(start), np.zeros(6))
solution = cg.solve_ivp(f, (0, 12000), y0, frame=frame, rtol=1e-8, atol=1e-8, max_step=20.0)

angle = np.degrees(2 * np.arccos(np.minimum(np.abs(solution.y[:, 3]), 1.0)))
fig, (above, below) = plt.subplots(2, 1, figsize=(6.4, 5), layout="constrained", sharex=True)
above.plot(solution.t, angle, color="#0072B2")
above.set(ylabel="angle to the command (degrees)", yscale="log")
below.plot(solution.t, solution.y[:, 7:], label=["first wheel", "second wheel", "third wheel"])
below.set(xlabel="time (s)", ylabel="momentum (N m s)")
below.legend()
plt.show()
