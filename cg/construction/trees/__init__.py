"""Ordered trees and the Fortran tables that are made of them."""

from cg.construction.trees.ordered import OrderedTree, forest

__all__ = ["OrderedTree", "forest"]
