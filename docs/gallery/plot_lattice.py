"""
A lattice gauge field
=====================

The gradient flow of Wilson's action smooths a field of matrices in SU(3), one on each link of a
periodic lattice with 16 sites: 64 matrices, a point of a manifold of dimension 512.
"""

import matplotlib.pyplot as plt
from gradient_flow import GradientFlow

import crouch_grossman as cg

fig, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
for roughness, style in zip((0.25, 0.5, 1.0), ("-", "--", "-."), strict=True):
    problem = GradientFlow(roughness=roughness)
    solution = cg.integrate(
        problem.f, (0, 1), problem.y0, frame=problem.frame, method="CF3", h=0.02
    )
    action = [problem.action(y) for y in solution.y]
    ax.semilogy(solution.t, action, style, label=f"roughness {roughness:g}")
ax.set(xlabel="flow time", ylabel="action per plaquette")
ax.legend()
plt.show()
