"""
A spin chain
============

Eight spins of one half in a Heisenberg chain with a field that changes with time: a vector with 256
complex entries, whose norm is conserved. One spin is turned over at the start, and the
excitation spreads.
"""

from functools import reduce

import matplotlib.pyplot as plt
import numpy as np
from scipy import sparse

import crouch_grossman as cg

n = 8
pauli = [np.array(m) / 2 for m in ([[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]])]


def on(site, matrix):
    """Return the operator of a spin in the space of the chain."""
    factors = [sparse.eye_array(2)] * n
    factors[site] = sparse.csr_array(matrix)
    return reduce(sparse.kron, factors).tocsr()


chain = sum(on(k, s) @ on(k + 1, s) for k in range(n - 1) for s in pauli)
gradient = sum((k - (n - 1) / 2) * on(k, pauli[2]) for k in range(n))
frame = cg.frames.LinearAction([-1j * chain, -1j * gradient], unitary=True)

start = np.zeros(2**n, complex)
start[1 << (n - 1 - 2)] = 1.0  # the third spin is turned over
solution = cg.integrate(
    lambda t, y: [2.0, 0.4 * np.sin(0.5 * t)], (0, 12), start, frame=frame, method="CF4", h=0.1
)

up = np.stack([0.5 - ((abs(solution.y) ** 2) @ on(k, pauli[2]).diagonal().real) for k in range(n)])
fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
image = ax.pcolormesh(solution.t, np.arange(1, n + 1), up, cmap="Blues")
ax.set(xlabel="time", ylabel="spin")
fig.colorbar(image, label="probability that it is turned over")
plt.show()
