"""
Drift from the manifold
=======================

The attitude of a free rigid body by the classical Runge–Kutta method of order four, with its nine
numbers taken for a vector, and by ``CF4``, of the same order and with the same steps.
"""

import matplotlib.pyplot as plt
import numpy as np

import crouch_grossman as cg

body = cg.problems.FreeRigidBody()
h, steps = 0.25, 400


def classical(f, y):
    """One step of Kutta's method in the space of nine numbers."""
    k1 = f(y)
    k2 = f(y + h / 2 * k1)
    k3 = f(y + h / 2 * k2)
    k4 = f(y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def derivative(y):
    return body.frame.field(body.f(0.0, y), y)


flat = [np.asarray(body.y0)]
for _ in range(steps):
    flat.append(classical(derivative, flat[-1]))
solution = cg.integrate(body.f, (0, h * steps), body.y0, frame=body.frame, method="CF4", h=h)


def off(y):
    return np.maximum(body.frame.membership_error(y), 1e-17)


fig, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
ax.semilogy(solution.t, off(np.array(flat)), color="#D55E00", label="classical, order four")
ax.semilogy(solution.t, off(solution.y), "--", color="#0072B2", label="CF4, order four")
ax.set(xlabel="time", ylabel="distance from the manifold", ylim=(1e-17, 1))
ax.grid(color="#d9d9d9")
ax.legend()
plt.show()
