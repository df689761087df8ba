"""
Ordered trees
=============

All ordered trees of the order conditions up to order three. The root, at the bottom, stands for
the step; below each tree are its name and its density, whose inverse is the right-hand side of its
condition.
"""

import matplotlib.pyplot as plt

import crouch_grossman as cg

shown = ["[[]]", "[[][]]", "[[[]]]", "[[][][]]", "[[][[]]]", "[[[]][]]", "[[[][]]]", "[[[[]]]]"]
fig, axes = plt.subplots(2, 4, figsize=(8, 4), layout="constrained")
for ax, tree in zip(axes.flat, shown, strict=True):
    cg.plot.tree(tree, ax)
plt.show()
