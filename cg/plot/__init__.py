"""Plots of trees, methods and results with matplotlib.

Each function draws on the axes ``ax``, by default those of a new figure, and returns them. Colours
are distinguishable for colour-blind readers; lines also differ in dashes and markers.
"""

from cg.plot.attitude import attitude
from cg.plot.errors import convergence, work_precision
from cg.plot.methods import points, tableau
from cg.plot.observables import bands, invariants
from cg.plot.stability import stability_region
from cg.plot.trajectories import bloch, trajectory_of_axes, trajectory_on_sphere
from cg.plot.trees import tree

__all__ = [
    "attitude",
    "bands",
    "bloch",
    "convergence",
    "invariants",
    "points",
    "stability_region",
    "tableau",
    "trajectory_of_axes",
    "trajectory_on_sphere",
    "tree",
    "work_precision",
]
