"""Lifting: flat Runge–Kutta methods as commutator-free methods of the same order."""

from cg.construction.lifting.lift import Lifted, LiftError, lift

__all__ = ["LiftError", "Lifted", "lift"]
