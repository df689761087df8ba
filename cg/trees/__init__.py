"""Ordered trees and the Fortran tables that are made of them."""

from .ordered import OrderedTree, forest

__all__ = ["OrderedTree", "forest"]
