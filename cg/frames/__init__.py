"""Rigid frames: manifolds with vector fields whose flows are known."""

from cg.frames.base import Frame
from cg.frames.euclidean import Euclidean
from cg.frames.product import Product
from cg.frames.so3 import SO3, hat, vee

__all__ = ["SO3", "Euclidean", "Frame", "Product", "hat", "vee"]
