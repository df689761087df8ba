"""Order conditions of Runge–Kutta methods on manifolds, see `cg.construction.conditions`."""

from cg.construction.conditions import *  # noqa: F403
from cg.construction.conditions import __all__  # noqa: F401
