"""Pictures of trees, methods and results, drawn with matplotlib on axes that are given or new.

Each function takes ``ax``, where to draw, and returns it; without it there is a new figure.
Colours stay apart for colour-blind readers, and lines differ in dashes and markers too.
"""

from __future__ import annotations

from .errors import convergence, work_precision
from .methods import points, tableau
from .stability import stability_region
from .trajectories import trajectory_of_axes, trajectory_on_sphere
from .trees import tree

__all__ = [
    "convergence",
    "points",
    "stability_region",
    "tableau",
    "trajectory_of_axes",
    "trajectory_on_sphere",
    "tree",
    "work_precision",
]
