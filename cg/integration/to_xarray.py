"""Results as datasets of xarray, whose axes have names."""

from __future__ import annotations

from typing import Any

import numpy as np

_DERIVATIVES = {  # with their last axes
    "transition": "initial_coordinate",
    "sensitivity": "parameter",
    "covariance": "other_coordinate",
}
_NUMBERS = ("nfev", "njev", "nlu", "nexp", "steps", "nrejected", "status", "message", "h")


def to_xarray(result: Any) -> Any:
    """Return the times and points of a result as a dataset of xarray."""
    import xarray

    axes = len(result.frame.point_shape)
    members = ["member"] if np.ndim(result.status) else []
    points = {0: [], 1: ["component"], 2: ["row", "column"]}.get(
        axes, [f"axis_{k}" for k in range(axes)]
    )
    attributes = {"method": result.method.name, "frame": repr(result.frame)}
    variables = {} if result.y is None else {"y": (["t", *members, *points], result.y)}
    if result.observed is not None:
        last = [f"observable_{k}" for k in range(np.ndim(result.observed) - 1 - len(members))]
        variables["observed"] = (["t", *members, *last], result.observed)
    for name, axis in _DERIVATIVES.items():
        value = getattr(result, name, None)
        if value is not None:
            variables[name] = (["t", *members, "coordinate", axis], value)
    for name in _NUMBERS:
        value = getattr(result, name)
        if isinstance(value, np.ndarray):
            variables[name] = (members, value)
        elif value is not None:
            attributes[name] = value
    return xarray.Dataset(variables, {"t": result.t}, attributes)
