"""Integration of differential equations on manifolds."""

from cg.integrate.fixed import Trajectory, integrate

__all__ = ["Trajectory", "integrate"]
