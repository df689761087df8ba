"""The methods of the catalogue in JAX, as solvers of diffrax.

`FrameTerm` is the right-hand side, `Solver` a method, `controller` the choice of steps of
`cg.solve_ivp`. diffrax has the loop, output, events and adjoints.
"""

from __future__ import annotations

try:
    import diffrax as _diffrax  # noqa: F401
except ImportError as error:
    raise ImportError(
        "cg.jax needs jax and diffrax: python -m pip install '.[jax]' in the source tree"
    ) from error

from cg.jax.control import controller
from cg.jax.frames import cotangent, flow, log
from cg.jax.products import join, split
from cg.jax.solver import Solver, divergence
from cg.jax.term import FrameTerm, LinearTerm, NoiseTerm

__all__ = [
    "FrameTerm",
    "LinearTerm",
    "NoiseTerm",
    "Solver",
    "controller",
    "cotangent",
    "divergence",
    "flow",
    "join",
    "log",
    "split",
]
