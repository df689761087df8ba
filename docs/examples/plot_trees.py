"""
Ordered trees
=============

All ordered trees of the order conditions up to order three. The root stands for the step; below
each tree is the right-hand side of its condition, the inverse of its density.
"""

import matplotlib.pyplot as plt

from cg.trees import forest

trees = forest(4)


def children(index):
    return trees.children[index - 1]


def draw(ax, index, x=0.0, y=0.0, width=1.0):
    """Draw a tree from its root upwards, branches from left to right."""
    below = children(index)
    for k, child in enumerate(below):
        place = x + width * ((k + 0.5) / len(below) - 0.5)
        ax.plot([x, place], [y, y + 1], color="#8c8c8c", lw=1.5, zorder=1)
        draw(ax, child, place, y + 1, width / len(below))
    ax.plot([x], [y], "o", color="#D55E00" if y == 0 else "#0072B2", ms=9, zorder=2)


shown = range(2, len(trees) + 1)
fig, axes = plt.subplots(1, len(shown), figsize=(8.6, 2.1), layout="constrained")
for ax, index in zip(axes, shown, strict=True):
    draw(ax, index)
    ax.set(xlim=(-0.7, 0.7), ylim=(-0.4, 3.4))
    ax.axis("off")
    ax.set_title(f"1/{trees.density[index - 1]}", y=-0.16, fontsize=11)
plt.show()
