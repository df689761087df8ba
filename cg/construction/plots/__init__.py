"""Plots of methods, of trees and of stability regions, which `cg.plot` offers too."""

from cg.construction.plots.methods import points, tableau
from cg.construction.plots.stability import order_star, stability_region
from cg.construction.plots.trees import tree

__all__ = ["order_star", "points", "stability_region", "tableau", "tree"]
