"""Plots of methods, of trees and of stability regions, which `cg.plot` offers too."""

from cg.construction.plots.methods import points, tableau, tree
from cg.construction.plots.stability import order_star, stability_region

__all__ = ["order_star", "points", "stability_region", "tableau", "tree"]
