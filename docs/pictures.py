"""Pictures of the pages, stored beside them: ``python docs/pictures.py`` draws them again."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from cycler import cycler
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import cg
from cg.plot.style import COLOURS
from cg.problems import FreeRigidBody, StateDependentRotation
from cg.problems.convergence import final_errors

FOLDER = Path(__file__).parent / "pictures"
GALLERY = Path(__file__).parent / "gallery"
SHOWN_OF_GALLERY = (
    "plot_drift",
    "plot_stability",
    "plot_trees",
    "plot_vortices",
    "plot_work_precision",
)
STYLE: dict[Any, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS[:4]) + cycler(linestyle=["-", "--", "-.", ":"]),
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def new_axes(width: float = 4.5, height: float = 3.2, **options: Any) -> Axes:
    """Return axes of a new figure, whose size is in inches."""
    return plt.figure(figsize=(width, height), layout="constrained").add_subplot(**options)


def new_panels() -> tuple[Axes, Axes]:
    """Return two axes side by side."""
    _, axes = plt.subplots(1, 2, figsize=(9.0, 4.2), layout="constrained")
    left, right = axes
    return left, right


def gallery(name: str) -> SimpleNamespace:
    """Return the names that a script of the gallery defines."""
    return SimpleNamespace(**runpy.run_path(str(GALLERY / f"{name}.py")))


def of_gallery(name: str) -> Figure:
    """Return the figure that a script of the gallery draws."""
    with mpl.rc_context(mpl.rcParamsDefault):
        gallery(name)
        return plt.gcf()


def integrate(problem: Any, stop: float, h: float, method: str = "CG4a") -> cg.Solution:
    """Integrate a problem from time zero with constant steps."""
    return cg.integrate(problem.f, (0, stop), problem.y0, frame=problem.frame, method=method, h=h)


def of_page(path: Path, name: str = "ax") -> Figure:
    """Return the figure whose axes have this name in the program of a page."""
    with mpl.rc_context(mpl.rcParamsDefault):
        names: dict[str, Any] = {}
        text = path.read_text(encoding="utf-8")
        for block in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
            exec(block, names)
        return names[name].figure


def trees() -> Figure:
    """Draw the five ordered trees with four nodes."""
    figure, axes = plt.subplots(1, 5, figsize=(7.5, 2.2), layout="constrained")
    texts = ("[[][][]]", "[[][[]]]", "[[[]][]]", "[[[][]]]", "[[[[]]]]")
    for text, ax in zip(texts, axes, strict=True):
        cg.plot.tree(text, ax)
    return figure


def convergence() -> Figure:
    """Draw the error of three methods against the step size."""
    problem = StateDependentRotation()
    ax = new_axes()
    draw_errors(ax, problem, integrate(problem, 1.0, 0.0025, "CF6c").y[-1], ("CG3", "CF4", "CF5a"))
    return ax.figure


def draw_errors(
    ax: Axes, problem: Any, exact: Any, names: tuple[str, ...] = ("CG3", "CG4a", "CG5a")
) -> None:
    """Draw the error at time 1 of several methods against the step size."""
    h = 0.125 / 2.0 ** np.arange(5)
    for name in names:
        errors = final_errors(
            problem.f, (0, 1), problem.y0, exact, frame=problem.frame, method=name, h=h
        )
        cg.plot.convergence(h, errors, ax, label=name, order=cg.methods[name].order)


def tumbling_body(**options: Any) -> cg.Solution:
    """Return the motion of a free rigid body."""
    problem = FreeRigidBody()
    return cg.solve_ivp(
        problem.f, (0, 8), problem.y0, frame=problem.frame, max_step=0.05, **options
    )


def attitude() -> Figure:
    """Draw Euler angles of a tumbling body, and the errors of two tolerances."""
    angles, errors = new_panels()
    exact = tumbling_body(rtol=1e-12, atol=1e-12, dense_output=True)
    cg.plot.attitude(exact, angles, show="ZYX")
    angles.set_ylim(top=1.35 * angles.get_ylim()[1])
    for tolerance, dashes in ((1e-5, "-"), (1e-8, "--")):
        run = cg.solve_ivp(
            FreeRigidBody().f, (0, 8), exact.y[0], frame=exact.frame, rtol=tolerance, atol=tolerance
        )
        rotations, reference = (
            exact.frame.factors[0].as_rotation(exact.frame.split(y)[0])
            for y in (run.y, exact.sol(run.t))
        )
        angle = np.rad2deg((reference.inv() * rotations).magnitude())
        errors.semilogy(run.t, angle, dashes, label=f"tolerance {tolerance:g}", linewidth=1.4)
    errors.set(xlabel="t", ylabel="error (°)")
    errors.legend(frameon=False)
    return angles.figure


def draw_drift(ax: Axes, problem: Any, solution: cg.Solution) -> None:
    """Draw the largest change of each invariant so far, and of the distance from the manifold."""
    start = problem.invariants(problem.y0)
    curves = {"distance from the manifold": problem.frame.membership_error(solution.y)}
    for name, values in problem.invariants(solution.y).items():
        change = np.abs(values - start[name])
        curves[name] = change if change.ndim == 1 else change.max(axis=-1)
    for name, curve in curves.items():
        largest = np.maximum.accumulate(curve[1:])
        label = name if largest[-1] > 0.0 else f"{name} (zero)"
        ax.plot(solution.t[1:], np.where(largest > 0.0, largest, np.nan), label=label)
    ax.set(yscale="log", xlabel="time (s)", ylabel="largest change so far")
    ax.set_title(f"invariants, {solution.method.name}, h = {solution.h:g} s")
    put_legend_below(ax)


def put_legend_below(ax: Axes) -> None:
    """Put the legend under the axes, where it covers no line."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)


def reaction_wheels() -> Figure:
    """Draw how the wheels take up the momentum of the satellite."""
    ax, other = new_panels()
    satellite = gallery("reaction_wheels")
    solution = integrate(satellite, 12.0, 0.02)
    norm = np.linalg.norm
    momentum = norm(np.array(satellite.INERTIA) * solution.y[:, 4:7], axis=1)
    angle = 2.0 * np.arcsin(np.minimum(norm(solution.y[:, :3], axis=1), 1.0))
    ax.plot(solution.t, momentum, label="momentum of the satellite (N m s)")
    ax.plot(solution.t, norm(solution.y[:, 7:], axis=1), label="momentum of the wheels (N m s)")
    ax.plot(solution.t, angle, label="angle to the commanded attitude (rad)")
    ax.set(xlabel="time (s)", title="the wheels take up the momentum")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16))
    draw_drift(other, satellite, solution)
    return ax.figure


def body_with_pendulum() -> Figure:
    """Draw the paths of joint and mass, and the invariants."""
    chain = gallery("body_with_pendulum")
    solution = integrate(chain, 5.0, 0.005)
    figure = plt.figure(figsize=(9.0, 4.2), layout="constrained")
    ax = figure.add_subplot(1, 2, 1, projection="3d")
    names = ("joint of the body", "mass of the pendulum")
    for place, label in zip(chain.positions(solution.y), names, strict=True):
        ax.plot(*place.T, label=label, linewidth=0.9)
    ax.plot(*np.stack([np.zeros(3), *chain.positions(chain.y0)]).T, "ko-", label="at time 0")
    ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)", zlabel="$z$ (m)", title="5 s in space")
    ax.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1), zticks=(-1.5, -1, -0.5, 0))
    ax.zaxis.labelpad = 8.0
    ax.set_aspect("equal")
    put_legend_below(ax)
    draw_drift(figure.add_subplot(1, 2, 2), chain, solution)
    return figure


def gradient_flow() -> Figure:
    """Draw how the action decreases, and errors."""
    flow = gallery("gradient_flow").GradientFlow
    ax, other = new_panels()
    for roughness in (0.25, 0.5, 1.0):
        problem = flow(sides=(2, 2, 2, 2), roughness=roughness)
        solution = integrate(problem, 1.0, 0.02, "CF4")
        action = [problem.action(links) for links in solution.y]
        ax.semilogy(solution.t, action, label=f"roughness {roughness:g}")
    ax.set(xlabel="flow time", ylabel="action per plaquette")
    ax.set_title("the flow smooths a field, $2^4$ sites")
    put_legend_below(ax)
    small = flow()
    draw_errors(other, small, integrate(small, 1.0, 1 / 256, "CF6c").y[-1])
    other.set_title("error at flow time 1, $2^2$ sites")
    return ax.figure


PICTURES: dict[str, Callable[[], Figure]] = {
    "first_steps": lambda: of_page(Path(__file__).parent / "start" / "first_steps.md"),
    "trees": trees,
    "tableau": lambda: cg.plot.tableau("CG4a", new_axes(4.2, 2.6)).figure,
    "points": lambda: cg.plot.points("CF4", new_axes(5.0, 3.0)).figure,
    **{name: partial(of_gallery, name) for name in SHOWN_OF_GALLERY},
    "points_of_a_pair": lambda: cg.plot.points("DP5(4)", new_axes(6.0, 3.6)).figure,
    "convergence": convergence,
    "axes": lambda: (
        cg.plot.trajectory_of_axes(tumbling_body(), new_axes(4.2, 4.0, projection="3d")).figure
    ),
    "attitude": attitude,
    "reaction_wheels": reaction_wheels,
    "body_with_pendulum": body_with_pendulum,
    "gradient_flow": gradient_flow,
    "heat_bath": lambda: of_page(Path(__file__).parent / "howto" / "heat_baths.md"),
    "timeline": lambda: of_page(Path(__file__).parent / "plots.md", "events"),
    "phase_plane": lambda: of_page(Path(__file__).parent / "plots.md"),
    "joints": lambda: of_page(Path(__file__).parent / "howto" / "joints.md"),
}


def draw_pictures() -> None:
    """Draw all pictures."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in PICTURES.items():
        with mpl.rc_context(STYLE):
            figure = draw()
            figure.savefig(FOLDER / f"{name}.png", dpi=110)
        plt.close("all")


if __name__ == "__main__":
    draw_pictures()
