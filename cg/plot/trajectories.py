"""Plots of trajectories on the sphere and of the axes of a rotating body."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.plot.drawn_rotations import drawn_rotations
from cg.plot.style import COLOURS, axes_for, check_label, check_stored
from cg.support.arrays import check_finite, complex_array, real_array
from cg.support.checks import check_integer

_NAMES = "xyz"


def trajectory_on_sphere(
    y: Any, ax: Any = None, *, label: str | None = None, color: str | None = None
) -> Any:
    """Draw a trajectory on a sphere around the origin, and the sphere; a dot marks the start.

    Parameters
    ----------
    y
        Shape ``(n, 3)``. Points, or a solution on ``cg.frames.Sphere(2)``.
    label
        Name of the curve in the legend.
    color
        Colour of the curve.

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
    check_stored(y, "y")
    points = real_array(getattr(y, "y", y), "y")
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise ValueError(f"y must have shape (n, 3), got {points.shape}")
    check_finite(points, "y")
    radius = float(np.linalg.norm(points, axis=-1).max())
    return _trajectory(points, radius, ax, label, color)


def _trajectory(
    points: NDArray[np.float64], radius: float, ax: Any, label: str | None, color: str | None
) -> Any:
    """Draw points within a sphere."""
    check_label(label)
    if color is not None and not isinstance(color, str):
        raise TypeError(f"color must be a str or None, got {color!r}")
    ax = axes_for(ax, spatial=True)
    number = len(ax.get_lines())
    _draw_sphere(ax, radius)
    colour = COLOURS[number % len(COLOURS)] if color is None else color
    _draw_path(ax, points, colour, label)
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax


def bloch(y: Any, ax: Any = None, *, label: str | None = None, color: str | None = None) -> Any:
    """Draw the Bloch vector of a two-level system over time, on the sphere of pure states.

    Parameters
    ----------
    y
        State vectors, shape ``(n, 2)``; density matrices or unitary propagators, shape
        ``(n, 2, 2)``, of the latter the state that began in the first level; or a solution with
        such points.
    ax, label, color
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
    check_stored(y, "y")
    states = complex_array(getattr(y, "y", y), "y")
    if states.ndim not in (2, 3) or states.shape[1:] not in ((2,), (2, 2)) or len(states) == 0:
        raise ValueError(f"y must have shape (n, 2) or (n, 2, 2), got {states.shape}")
    check_finite(states, "y")
    is_density = states.ndim == 3 and np.allclose(np.trace(states, axis1=1, axis2=2), 1.0)
    if not (is_density and np.allclose(states, states.conj().swapaxes(1, 2))):
        kets = states if states.ndim == 2 else states[:, :, 0]
        states = kets[:, :, None] * kets[:, None, :].conj()
    upper = 2 * states[:, 0, 1].conj()
    vectors = np.stack([upper.real, upper.imag, (states[:, 0, 0] - states[:, 1, 1]).real], axis=-1)
    return _trajectory(vectors, 1.0, ax, label, color)


def trajectory_of_axes(y: Any, ax: Any = None, *, triads: int = 2) -> Any:
    """Draw the paths of the three axes of a rotating body, and the axes at some times.

    Parameters
    ----------
    y
        A solution on `SO3`, `UnitQuaternion`, `SE3` or a product with one of them, rotations,
        matrices of shape ``(n, 3, 3)``, whose columns are the axes of the body in space, or
        quaternions of shape ``(n, 4)``, scalar last. A solution with dense output is drawn between
        its steps too.
    triads
        Number of times, including the first and the last, at which the axes are drawn.

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
    triads = min(check_integer("triads", triads, 0), len(matrices))
    ax = axes_for(ax, spatial=True)
    _draw_sphere(ax, 1.0)
    for k, name in enumerate(_NAMES):
        _draw_path(ax, matrices[:, :, k], COLOURS[k], f"{name} axis")
    for n in np.unique(np.linspace(0, len(matrices) - 1, triads).round().astype(int)).tolist():
        early = n < len(matrices) - 1
        for k in range(3):
            x = np.stack([np.zeros(3), matrices[n, :, k]])
            ax.plot(*x.T, color=COLOURS[k], linewidth=1.0 if early else 2.5)
    ax.legend(frameon=False, fontsize=8)
    return ax


def _draw_path(ax: Any, points: NDArray[np.float64], colour: str, label: str | None) -> None:
    ax.plot(*points.T, color=colour, linewidth=1.4, label=label)
    ax.scatter(*points[:1].T, color=colour, s=25)


def _draw_sphere(ax: Any, radius: float) -> None:
    """Draw lines of latitude and longitude, unless the axes have a sphere."""
    if any(part.get_gid() == "cg-sphere" for part in ax.collections):
        return
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    grid = ax.plot_wireframe(radius * x, radius * y, radius * z, color="#cccccc", linewidth=0.4)
    grid.set_gid("cg-sphere")
    ax.set_box_aspect((1, 1, 1))
    ax.set_xlabel("x")
    ax.set_ylabel("y")
    ax.set_zlabel("z")
    ticks = [-radius, 0.0, radius]
    ax.set(xticks=ticks, yticks=ticks, zticks=ticks)
