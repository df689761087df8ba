"""Plots of trees, methods and results with matplotlib.

Each function draws on the axes ``ax`` of matplotlib, by default those of a new figure, and returns
them; spheres need three-dimensional axes. Colours are distinguishable for colour-blind readers;
lines also differ in dashes and markers.
"""

from importlib import import_module
from typing import Any

from cg.plot.attitude import attitude
from cg.plot.errors import convergence, work_precision
from cg.plot.events import phase_plane, timeline
from cg.plot.trajectories import bands, bloch, invariants, trajectory_of_axes, trajectory_on_sphere

# Imported at their first use
_OF_METHODS = ("points", "stability_region", "tableau", "tree")

__all__ = [
    "attitude",
    "bands",
    "bloch",
    "convergence",
    "invariants",
    "phase_plane",
    "points",
    "stability_region",
    "tableau",
    "timeline",
    "trajectory_of_axes",
    "trajectory_on_sphere",
    "tree",
    "work_precision",
]


def __getattr__(name: str) -> Any:
    """Import a plot of methods from `cg.plot.methods`."""
    if name not in _OF_METHODS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("cg.plot.methods"), name)
