"""Plots of trajectories, of the axes of a rotating body, and of numbers over time."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.plot.attitude import drawn_rotations, rotations_on
from cg.plot.style import (
    COLOURS,
    DASHES,
    axes_for,
    check_solution,
    curve_style,
    drawn,
    is_solution,
    verbatim,
)
from cg.support.arrays import Array, check_finite, is_qobj, real_array

_ARC = math.radians(3)  # angle between points that are drawn of a great circle
_QUANTILES = ((0.05, 0.95), (0.25, 0.75))


def trajectory_on_sphere(y: Any, ax: Any = None, *, label: str | None = None) -> Any:
    """Draw a trajectory on a sphere around the origin, and the sphere; a dot marks the start.

    Parameters
    ----------
    y
        Points, shape ``(n, 3)``; rotation matrices ``(n, 3, 3)`` or quaternions ``(n, 4)``, whose
        third axis is drawn; or a solution with such points, of one member or of several. A solution
        with dense output is drawn between its steps too, others along great circles.
    label
        Name of the curve in the legend.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> run = cg.integrate(
    ...     lambda t, y: [0.2, 0.0, 1.0], (0, 3), [1.0, 0.0, 0.0], frame=cg.frames.Sphere(2),
    ...     method="CG3", h=0.1,
    ... )
    >>> ax = cg.plot.trajectory_on_sphere(run.y, label="CG3")
    >>> ax.name
    '3d'
    """
    curves = _vector_curves(y, _vectors)
    radius = max(float(np.linalg.norm(curve, axis=-1).max()) for curve in curves)
    return _trajectory(curves, radius, ax, label)


def _trajectory(curves: list[Array], radius: float, ax: Any, label: str | None) -> Any:
    """Draw curves within a sphere, in one colour."""
    ax = axes_for(ax, spatial=True)
    _draw_sphere(ax, radius)
    style = curve_style(ax) | {"marker": "", "label": label}
    for curve in curves:
        ax.plot(*_along_great_circles(curve).T, **style)
        ax.scatter(*curve[:1].T, color=style["color"], s=25)
        style |= {"gid": None, "label": None}  # the curves of a call count as one
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax


def bloch(y: Any, ax: Any = None, *, label: str | None = None) -> Any:
    """Draw the Bloch vector of a two-level system over time, on the sphere of pure states.

    Parameters
    ----------
    y
        State vectors, shape ``(n, 2)``; density matrices, shape ``(n, 2, 2)`` or, complex,
        ``(n, 4)``; unitary propagators, shape ``(n, 2, 2)``, of which the state that began in the
        first level is drawn; Bloch vectors, or rotations of them, as for `trajectory_on_sphere`; a
        list of QuTiP's states; or a solution with such points, of one member or of several.
    ax, label
        As for `trajectory_on_sphere`.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> run = cg.solve_linear(
    ...     lambda t: [np.cos(t), 0.0, 1.0], (0, 3), np.eye(2), frame=cg.frames.SU(2)
    ... )
    >>> cg.plot.bloch(run).get_zlabel()
    'z'
    """
    ax = _trajectory(_vector_curves(y, _bloch_vectors), 1.0, ax, label)
    if not ax.texts:
        for height, name in ((1.2, "|0⟩"), (-1.2, "|1⟩")):
            ax.text(0.0, 0.0, height, name, ha="center", va="center")
    return ax


def _vector_curves(y: Any, convert: Callable[[Any, Frame | None], Array]) -> list[Array]:
    """Return the curves of vectors of a solution, of each member, or of an array."""
    if is_solution(y) and np.ndim(y.status):
        return [curve for k in range(len(y.status)) for curve in _vector_curves(y[k], convert)]
    if isinstance(y, list | tuple) and y and all(map(is_qobj, y)):
        y = np.array([state.full().squeeze() for state in y])
    frame, _, points = drawn(y)
    points = np.asarray(points)
    check_finite("y", points)
    if not points.size:
        raise ValueError("y must hold points at one or more times, got none")
    return [convert(points, frame)]


def _vectors(points: Any, frame: Frame | None) -> Array:
    """Return real vectors, or the third axes of rotations, shape ``(n, 3)``."""
    if points.ndim == 2 and points.shape[1:] == (3,):
        return real_array(points, "y")
    if (rotations := rotations_on(frame, points)) is None:
        raise ValueError(
            "y must have shape (n, 3), or (n, 3, 3) or (n, 4) of rotations, got "
            f"{points.shape} on {frame!r}"
        )
    return rotations.apply([0.0, 0.0, 1.0])


def _bloch_vectors(states: Any, frame: Frame | None) -> Array:
    """Return the Bloch vectors of states or propagators, shape ``(n, 3)``."""
    shape = states.shape[1:]
    if np.isrealobj(states) and shape not in ((2,), (2, 2)):
        return _vectors(states, frame)
    if shape not in ((2,), (2, 2), (4,)):
        raise ValueError(
            "y must hold states of shape (n, 2), (n, 2, 2) or, complex, (n, 4), or vectors, got "
            f"shape {states.shape}"
        )
    if shape == (4,):
        states = states.reshape(-1, 2, 2)
    kets = states
    if states.ndim == 3:
        adjoint, kets = states.conj().mT, states[:, :, 0]
        traces = np.trace(states, axis1=1, axis2=2)
        if np.allclose(states, adjoint) and np.allclose(traces, 1.0):
            kets = None
        elif not np.allclose(adjoint @ states, np.eye(2)):
            raise ValueError(
                "y must hold density matrices, Hermitian with trace one, or unitary matrices, got "
                f"one of trace {traces[np.argmax(np.abs(traces - 1.0))]:.6g}"
            )
    if kets is not None:
        states = kets[:, :, None] * kets[:, None, :].conj()
    upper = 2 * states[:, 0, 1].conj()
    return np.stack([upper.real, upper.imag, (states[:, 0, 0] - states[:, 1, 1]).real], axis=-1)


def _along_great_circles(curve: Array) -> Array:
    """Return a curve with points between those that are more than a few degrees apart."""
    lengths = np.maximum(np.linalg.norm(curve, axis=1), np.finfo(float).tiny)
    units, arcs = curve / lengths[:, None], [curve[:1]]
    for k in range(len(curve) - 1):
        cosine = float(np.clip(units[k] @ units[k + 1], -1.0, 1.0))
        angle = math.acos(cosine)
        s = np.linspace(0.0, 1.0, 2 + int(angle / _ARC))[1:, None]
        same = abs(lengths[k + 1] - lengths[k]) < 1e-3 * lengths[k]
        # opposite points have no great circle
        if len(s) == 1 or not same or math.pi - angle < _ARC:
            arcs.append(curve[k + 1 : k + 2])
            continue
        arc = np.sin((1 - s) * angle) * units[k] + np.sin(s * angle) * units[k + 1]
        arcs.append(((1 - s) * lengths[k] + s * lengths[k + 1]) * arc / math.sin(angle))
    return np.concatenate(arcs)


def trajectory_of_axes(y: Any, ax: Any = None) -> Any:
    """Draw the paths of the three axes of a rotating body, and the axes at the first and last time.

    Parameters
    ----------
    y
        A solution on `SO3`, `UnitQuaternion`, `SE3` or a product with one of them, rotations,
        matrices of shape ``(n, 3, 3)``, whose columns are the axes of the body in space, or
        quaternions of shape ``(n, 4)``, scalar last. A solution with dense output is drawn between
        its steps too.

    Warns
    -----
    UserWarning
        If the attitude turns by more than 90 degrees between two times.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> run = cg.integrate(
    ...     lambda t, y: [0.2, 0.0, 1.0], (0, 3), np.eye(3), frame=cg.frames.SO3(),
    ...     method="CG3", h=0.1,
    ... )
    >>> ax = cg.plot.trajectory_of_axes(run.y)
    >>> ax.name
    '3d'
    """
    matrices = drawn_rotations(y)[0].as_matrix()
    ax = axes_for(ax, spatial=True)
    _draw_sphere(ax, 1.0)
    for k, name in enumerate("xyz"):
        _draw_curve(ax, matrices[:, :, k], COLOURS[k], DASHES[k], f"{name} axis")
        for n, width in ((0, 1.0), (-1, 2.5)):
            axis = np.stack([np.zeros(3), matrices[n, :, k]])
            ax.plot(*axis.T, "-", color=COLOURS[k], linewidth=width)
    ax.legend(frameon=False, fontsize=8)
    return ax


def _draw_curve(ax: Any, points: Array, colour: str, dashes: Any, label: str | None) -> None:
    ax.plot(*points.T, color=colour, linestyle=dashes, linewidth=1.4, label=label)
    ax.scatter(*points[:1].T, color=colour, s=25)


def _draw_sphere(ax: Any, radius: float) -> None:
    """Draw lines of latitude and longitude, unless the axes have a sphere."""
    if any(collection.get_gid() == "cg-sphere" for collection in ax.collections):
        return
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    grid = ax.plot_wireframe(radius * x, radius * y, radius * z, color="#cccccc", linewidth=0.4)
    grid.set_gid("cg-sphere")
    ax.set_box_aspect((1, 1, 1))
    ticks = [-radius, 0.0, radius]
    ax.set(xlabel="x", ylabel="y", zlabel="z", xticks=ticks, yticks=ticks, zticks=ticks)


def invariants(
    solution: Any, functions: Callable[[Any], Any] | Mapping[str, Callable[[Any], ArrayLike]],
    ax: Any = None,
) -> Any:  # fmt: skip
    """Draw how far invariants of a solution are from their initial values, against time.

    Parameters
    ----------
    solution
        A solution of one member.
    functions
        A function of the points ``solution.y``, time along the first axis, that returns the values
        of one invariant, or of each by its name, such as the ``invariants`` of problems; or a dict
        with a function of one invariant by each name.

    Returns
    -------
    matplotlib.axes.Axes
        With logarithmic errors; zeros are left out.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> top = cg.problems.HeavyTop()
    >>> run = cg.solve_ivp(top.f, (0, 5), top.y0, frame=top.frame)
    >>> ax = cg.plot.invariants(run, top.invariants)
    >>> ax.get_ylabel()
    'change since the start'
    """
    check_solution(solution)
    if callable(functions):
        values = functions(solution.y)
        if not isinstance(values, Mapping):
            values = {getattr(functions, "__name__", "invariant"): values}
    elif isinstance(functions, Mapping) and all(map(callable, functions.values())):
        values = {name: function(solution.y) for name, function in functions.items()}
    else:
        raise TypeError(f"functions must be a function, or a dict of them, got {functions!r}")
    times = np.asarray(solution.t, dtype=np.float64)
    ax = axes_for(ax)
    for name, value in values.items():
        curve = real_array(value, f"functions: {name}")
        if curve.shape != times.shape:
            raise ValueError(
                f"functions must return {len(times)} numbers for {name!r}, got shape {curve.shape}"
            )
        check_finite(f"functions: {name}", curve)
        style = curve_style(ax) | {"marker": ""}
        ax.plot(times, np.abs(curve - curve[0]), label=verbatim(name), **style)
    ax.set_yscale("log", nonpositive="mask")
    ax.set(xlabel="t", ylabel="change since the start")
    ax.legend(frameon=False, fontsize=8)
    return ax


def bands(t: ArrayLike, values: ArrayLike, ax: Any = None, *, label: str | None = None) -> Any:
    """Draw an observable of an ensemble: its median, and bands with half and 90 % of the members.

    Parameters
    ----------
    t
        Times, shape ``(n,)``.
    values
        Shape ``(n, members)``. Numbers of each member, NaN where it has none.
    label
        Name of the median in the legend.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> t = np.linspace(0, 1, 20)
    >>> ax = cg.plot.bands(t, np.outer(t, np.arange(50)), label="angle")
    >>> len(ax.collections), len(ax.lines)
    (2, 1)
    """
    times, numbers = real_array(t, "t"), real_array(values, "values")
    check_finite("t", times)
    if times.ndim != 1 or numbers.ndim != 2 or len(numbers) != len(times):
        raise ValueError(
            f"values must have shape (n, members) for t of shape (n,), got {numbers.shape} for "
            f"{times.shape}"
        )
    ax = axes_for(ax)
    style = curve_style(ax) | {"marker": ""}
    with warnings.catch_warnings():  # NaN where no member has a number: curves have a gap there
        warnings.filterwarnings("ignore", "All-NaN slice|Mean of empty slice", RuntimeWarning)
        bounds = [np.nanquantile(numbers, pair, axis=1) for pair in _QUANTILES]
        median = np.nanmedian(numbers, axis=1)
    for edges in bounds:
        ax.fill_between(times, *edges, color=style["color"], alpha=0.2, linewidth=0)
    ax.plot(times, median, label=None if label is None else verbatim(label), **style)
    ax.set_xlabel("t")
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax
