"""
Stability regions
=================

If flows commute, a step multiplies a solution of ``y' = λ y`` by R(hλ). The coloured regions are
\\|R\\| ≤ 1.
"""

import matplotlib.pyplot as plt

import crouch_grossman as cg

cg.plot.stability_region(["CG2", "CG3", "CF4", "DP5(4)"])
plt.show()
