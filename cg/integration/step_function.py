"""Variable steps of splitting methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.frames.phase_space import PhaseSpace
from cg.integration.langevin import is_symmetric
from cg.integration.plan.plan import Plan
from cg.integration.rhs.checks import read_finite
from cg.integration.rhs.observer import Observer, observer_of
from cg.support.arrays import Array, Points
from cg.support.checks import short
from cg.tables import Kind

_ROUNDING = 1e-10  # of values that should be equal


@dataclass(frozen=True, eq=False)
class Sizes(Observer):
    """The function of step sizes, after checking."""

    def check(self, value: Any, t: float, _: Points) -> Array:
        """Return a value as an array, after checking it."""
        number = read_finite(value, "step_function", (), t, number=True)
        if not number > 0.0:
            raise ValueError(
                f"step_function must return a positive number, got {value!r} at t = {t:.17g}"
            )
        return number


def sizes_of(
    options: Any, plan: Plan, rhs: Any, t: float, stop: float, y: Points
) -> Observer | None:
    """Return the function of step sizes after checking it, None without one."""
    function = options["step_function"]
    if function is None:
        return None
    if plan.method.kind is not Kind.SPLITTING or not is_symmetric(plan.method):
        raise ValueError(
            "step_function must be given with a symmetric splitting method, whose steps can be "
            f"reversed, got {plan.method!r}"
        )
    for name in ("thermostat", "derivatives", "common_steps"):
        if options[name]:
            raise ValueError(f"step_function must be None with {name}, got {short(function)}")
    try:
        given = observer_of(function, "all", plan.frame, rhs, t, y)
    except TypeError as error:
        raise TypeError(f"{error}".replace("observe", "step_function")) from None
    assert given is not None
    sizes = Sizes(given.function, plan.frame, (), True)
    if not isinstance(given.function, list):
        frame, data = plan.frame, rhs.arguments(0)
        assert isinstance(frame, PhaseSpace)
        momentum = frame.split(y)[1]
        shift = np.sqrt(np.arange(2.0, 2.0 + frame.rhs_dim)) * (1.0 + np.abs(momentum))
        other = frame.join(frame.split(y)[0], momentum + shift)
        first = sizes.check(given.function(t, y.copy(), *data), t, y)
        later = t + float(np.clip(stop - t, -1.0, 1.0)) * 0.37 * options["h"]
        for what, time, point in (("momentum", t, other), ("time", later, y)):
            found = sizes.check(given.function(time, point.copy(), *data), time, point)
            if not abs(found - first) <= _ROUNDING * abs(first):
                raise ValueError(
                    "step_function must depend on the configuration alone, or steps can't be "
                    f"reversed, got {first:.17g} and for another {what} {found:.17g} at t = "
                    f"{t:.17g}"
                )
    return sizes
