"""Grids of equal steps, as integrations take them."""

from dataclasses import dataclass

from cg import _core_r64 as core
from cg.frames import Euclidean
from cg.integration import integrate
from cg.integration.arguments import equal_steps


@dataclass(frozen=True)
class Grid:
    """How many steps there are, and the signed size of the last one."""

    steps: int
    last: float


def make_grid(span, h):
    """Return the grid of steps of a size after the checks of integrations."""
    steps = equal_steps(h, [*span])
    count, last = core.equal_steps(*span, h)
    assert count == steps
    return Grid(steps, last)


def times(span, h):
    """Return the times of all steps of an integration."""
    run = integrate(lambda t, y: [0.0], span, [0.0], frame=Euclidean(1), method="LieEuler", h=h)
    assert run.steps == make_grid(span, h).steps == len(run.t) - 1
    return run.t
