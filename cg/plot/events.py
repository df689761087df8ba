"""Plots of solutions with events: their times and modes, and curves in a phase plane."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from cg.plot import style
from cg.support.arrays import real_array

Entry = int | tuple[int, ...] | Callable[[Any], Any]
_HATCHES = ("", "////", "...", "xxxx", "||||")
_MAX_MODES = 20  # more values are a variable, not a mode


def timeline(solution: Any, ax: Any = None, *, events: Any = None, mode: Any = None) -> Any:
    """Draw when events happened, a row for each, and the modes between them.

    Parameters
    ----------
    solution
        With events, of one member.
    events
        Names of the events: strings, or what `cg.solve_ivp` was given, for names of functions.
    mode
        Index of the entry of points that is the mode, a tuple in matrices, or a function of points,
        time along the first axis, that returns numbers or names.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> floor = cg.Event(lambda t, y: y[0], direction=-1, jump=lambda t, y: [0.0, -0.9 * y[1]])
    >>> run = cg.solve_ivp(
    ...     lambda t, y: [y[1], -9.81], (0, 3), [1, 0], frame=cg.frames.Euclidean(2), events=floor
    ... )
    >>> [row.get_text() for row in cg.plot.timeline(run, events="impact").get_yticklabels()]
    ['impact']
    """
    style.check_solution(solution)
    if np.ndim(solution.status) or solution.t_events is None:
        what = "be of one member, such as run[0]" if np.ndim(solution.status) else "have events"
        raise ValueError(f"solution must {what}, got {solution!r}")
    rows, (times, points, _) = solution.t_events, _path(solution)
    names = [f"event {i}" for i in range(len(rows))]
    if events is not None:
        labels = events if isinstance(events, list | tuple) else [events]
        if len(labels) != len(rows):
            raise ValueError(f"events must name {len(rows)} events, got {labels!r}")
        names = list(map(_name, labels, names))
    values = np.empty(0) if mode is None else _values(mode, "mode", points)
    if len(modes := np.unique(values)) > _MAX_MODES:
        raise ValueError(f"mode must be constant between jumps, got {len(modes)} values")
    ax, top = style.axes_for(ax), -1 if len(modes) else 0
    _draw_modes(ax, times, values, modes)
    low, *_, high = np.sort(np.concatenate([times, times, *rows]))
    ax.hlines(range(len(rows)), low, high, color=style.FAINT, linewidth=0.6, zorder=0)
    end = (high if times[0] <= times[-1] else low) if solution.status == 1 else np.nan
    number = np.repeat(range(len(rows)), [len(row) for row in rows])
    when, jumped = np.concatenate([[], *rows]), np.concatenate([[], *_jumped(solution)]) > 0
    for label, marker, fill, which in (
        ("event", "o", "none", ~jumped & (when != end)),
        ("jump", "D", "full", jumped),
        ("end of the solution", "X", "full", ~jumped & (when == end)),
    ):
        if which.any():
            look = {"color": "black", "fillstyle": fill, "label": label}
            ax.plot(when[which], number[which], marker, **look)
    ax.set_yticks(range(top, len(rows)), ["mode"] * -top + list(map(style.verbatim, names)))
    ax.set(xlabel="t", ylim=(len(rows) - 0.5, top - 0.5))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def _draw_modes(ax: Any, times: Any, values: Any, modes: Any) -> None:
    """Draw a bar for each interval with one mode, above the rows of events."""
    cuts = [0, *(np.flatnonzero(values[1:] != values[:-1]) + 1), -1]
    for k, value in enumerate(modes.tolist()):
        bars = [(times[i], times[j] - times[i]) for i, j in pairwise(cuts) if values[i] == value]
        label = style.verbatim(value if isinstance(value, str) else f"mode {value:g}")
        colour, hatch = style.COLOURS[k % len(style.COLOURS)], _HATCHES[k % len(_HATCHES)]
        look = {"facecolor": colour, "hatch": hatch, "edgecolor": "white"}
        ax.broken_barh(bars, (-1.35, 0.7), label=label, linewidth=0, **look)


def phase_plane(
    solution: Any, x: Entry, y: Entry, ax: Any = None, *,
    label: str | None = None, names: Sequence[str] | None = None,
) -> Any:  # fmt: skip
    """Draw one number of points against another; a dot marks the start, a square the end.

    Parameters
    ----------
    solution
        With dense output it is drawn between its steps too, of an ensemble all members that
        succeeded. Dotted lines are jumps.
    x, y
        Index of an entry of points, a tuple in matrices, or a function of points, time along the
        first axis, that returns numbers.
    label
        Name of the curves in the legend.
    names
        Names of the axes, with units. By default they are as ``y[0]``, or those of functions.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> run = cg.solve_ivp(
    ...     lambda t, y: [y[1], -np.sin(y[0])], (0, 6), [2, 0], frame=cg.frames.Euclidean(2),
    ...     dense_output=True,
    ... )
    >>> ax = cg.plot.phase_plane(run, 0, 1, names=("angle (rad)", "rate (rad/s)"))
    """
    style.check_solution(solution)
    names = [_name(x, "x"), _name(y, "y")] if names is None else names
    if isinstance(names, str) or [isinstance(name, str) for name in names] != [True, True]:
        raise TypeError(f"names must be two strings, got {names!r}")
    curves = []
    for member in style.members_of(solution, "solution"):
        _, points, cuts = _path(member)
        rows = [real_array(_values(*entry, points), entry[1]) for entry in ((x, "x"), (y, "y"))]
        curves.append((np.stack(rows), cuts))
    ax = style.axes_for(ax)
    look = style.curve_style(ax) | {"marker": "", "alpha": style.opacity_of(curves)}
    thin = {name: look[name] for name in ("color", "alpha")} | {"linewidth": 0.9, "markersize": 5}
    for k, (curve, cuts) in enumerate(curves):
        look["label"] = None if k or label is None else style.verbatim(label)
        ax.plot(*np.insert(curve, cuts, np.nan, axis=1), **look)
        look["gid"] = None  # the curves of members have one style
        ax.plot(*curve[:, [cuts - 1, cuts]], ":", **thin)
        ax.plot(*curve[:, :1], "o", **thin)
        ax.plot(*curve[:, -1:], "s", fillstyle="none", **thin)
    ax.set(xlabel=style.verbatim(names[0]), ylabel=style.verbatim(names[1]))
    if label is not None:
        ax.legend(frameon=False, fontsize=8)
    return ax


def _name(source: Any, otherwise: str) -> str:
    """Return a string, or the name of an entry, a function, or the function of an event."""
    if isinstance(source, int | tuple):
        return f"y[{str(source).strip('(,)')}]"
    name = getattr(getattr(source, "function", source), "__name__", source)
    return name if isinstance(name, str) and name != "<lambda>" else otherwise


def _values(entry: Entry, name: str, points: Any) -> Any:
    """Return an entry of points, or what a function returns for them."""
    index = entry if isinstance(entry, tuple) else (entry,)
    try:
        values = np.asarray(entry(points) if callable(entry) else points[:, *index])
    except IndexError:
        values = np.empty(0)
    if not len(points) or values.shape != points.shape[:1]:
        raise ValueError(
            f"{name} must be an index of an entry of points of shape {points.shape[1:]}, or a "
            f"function that returns one value for each of several points, got {entry!r}"
        )
    return values


def _jumped(solution: Any) -> list[Any]:
    """Return for each event whether there is a jump at each of its times."""
    pairs = zip(solution.y_events or (), solution.y_after or (), strict=True)
    return [np.any(a != b, axis=tuple(range(1, np.ndim(a)))) for a, b in pairs]


def _path(solution: Any) -> tuple[Any, Any, Any]:
    """Return times and points, before and after each jump, and the indices of points after."""
    times, points, rows = solution.t, solution.y, solution.t_events or ()
    if solution.sol is not None:
        ts = solution.sol.ts
        # Each step has four points, also if it is short.
        within = np.interp(np.arange(4 * len(ts) - 3) / 4, range(len(ts)), ts)
        times = np.append(within, np.linspace(ts[0], ts[-1], style.POINTS))
        points = solution.sol(times)
    series = [(2 * len(rows), times, points)]
    for i, jumped in enumerate(_jumped(solution)):
        for k, sides in enumerate((solution.y_events, solution.y_after)):
            series += [(2 * i + k, rows[i][jumped], sides[i][jumped])]
    rank = np.concatenate([np.full(len(row[1]), row[0]) for row in series])
    times, points = (np.concatenate([row[k] for row in series]) for k in (1, 2))
    backward = any((np.diff(row) < 0.0).any() for row in (solution.t, *rows))
    order = np.lexsort((rank, -times if backward else times))
    return times[order], points[order], np.flatnonzero(rank[order] % 2)
