"""Results as datasets of xarray, whose axes have names."""

from __future__ import annotations

from typing import Any

from cg.integration.results import Solution, Trajectory

__all__ = ["to_xarray"]

_NUMBERS = ("nfev", "njev", "nlu", "nexp", "steps", "nrejected", "status", "message", "h")


def to_xarray(result: Solution | Trajectory) -> Any:
    """Return the times and points of a result as a dataset of xarray.

    Returns
    -------
    xarray.Dataset
        With the variable ``y`` and the coordinate ``t``. Axes of ``y`` are ``t``; of an ensemble
        ``member``, or ``member_0``, ``member_1``, ...; and of points ``component`` if they are
        vectors, ``row`` and ``column`` if they are matrices. Attributes are the name of the
        method, the frame, and the numbers of what the integration took.

    Raises
    ------
    ModuleNotFoundError
        If xarray isn't installed.

    Examples
    --------
    >>> import cg
    >>> run = cg.integrate(lambda t, y: [1.0], (0, 1), [0.0], frame=cg.frames.Euclidean(1),
    ...                    method="CG3", h=0.5)
    >>> run.to_xarray().y.sel(t=0.5).item()  # doctest: +SKIP
    0.5
    """
    import xarray

    axes = result.y.ndim - 1 if result.frame is None else len(result.frame.point_shape)
    batch = result.y.ndim - 1 - axes
    members = ["member"] if batch == 1 else [f"member_{k}" for k in range(batch)]
    points = {0: [], 1: ["component"], 2: ["row", "column"]}.get(
        axes, [f"axis_{k}" for k in range(axes)]
    )
    attributes = {"method": result.method.name}
    if result.frame is not None:
        attributes["frame"] = repr(result.frame)
    attributes |= {name: getattr(result, name) for name in _NUMBERS if hasattr(result, name)}
    return xarray.Dataset({"y": (["t", *members, *points], result.y)}, {"t": result.t}, attributes)
