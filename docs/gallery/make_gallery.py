"""Draw the problems of `cg.problems` and of this folder: their motion, invariants and errors.

Run ``python docs/gallery/make_gallery.py [NAME ...]``; the figures go beside this file.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import body_with_pendulum as chain
import double_pendulum as pendulum
import matplotlib as mpl
import numpy as np
import rolling_ball as ball
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cg import integrate, methods
from cg.analysis.convergence import final_errors
from cg.problems import (
    AffineField,
    ConingMotion,
    ForcedRigidBody,
    FreeRigidBody,
    GradientFlow,
    HeavyTop,
    ReactionWheels,
    Spacecraft,
    StateDependentRotation,
    TodaFlow,
    TwoLevelSystem,
)

FOLDER = Path(__file__).parent

# Colours that stay apart for colour-blind readers (Okabe and Ito); lines differ in dashes too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES: tuple[Any, ...] = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1)), (0, (3, 1)))
STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.handlelength": 3.0,
    "lines.linewidth": 1.4,
}


def solve(problem: Any, stop: float, h: float, method: str = "CG4a") -> Any:
    """Integrate a problem from time zero."""
    return integrate(problem.f, (0, stop), problem.y0, frame=problem.frame, method=method, h=h)


def lines(ax: Axes, x: Any, values: Sequence[Any], labels: Sequence[str]) -> None:
    """Draw several lines, each with its colour and dashes."""
    for value, label, colour, dash in zip(values, labels, COLOURS, DASHES, strict=False):
        ax.plot(x, value, color=colour, linestyle=dash, label=label)


def drift(ax: Axes, problem: Any, solution: Any, unit: str = " s") -> None:
    """Draw how far the invariants and the manifold have been left so far."""
    start = problem.invariants(problem.y0)
    curves, labels = [], []
    for name, values in problem.invariants(solution.y).items():
        change = np.abs(values - start[name])
        curves.append(change if change.ndim == 1 else change.max(axis=-1))
        labels.append(name)
    curves.append(problem.frame.membership_error(solution.y))
    labels.append("distance from the manifold")
    largest = [np.maximum.accumulate(c[1:]) for c in curves]
    labels = [
        label if curve[-1] > 0.0 else f"{label} (zero)"
        for label, curve in zip(labels, largest, strict=True)
    ]
    lines(ax, solution.t[1:], [np.where(c > 0.0, c, np.nan) for c in largest], labels)
    ax.set(yscale="log", xlabel=f"time ({unit.strip() or 1})", ylabel="largest change so far")
    ax.set_ylim(bottom=1e-17)
    ax.set_title(f"invariants, {solution.method.name}, h = {solution.h:g}{unit}")
    below(ax)


def below(ax: Axes) -> None:
    """Put the legend under the axes, where no line is."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, columnspacing=1.5)


def orders(ax: Axes, problem: Any, exact: Any, steps: Sequence[int], unit: str = "s") -> None:
    """Draw the error at time 1 against the step size for three methods."""
    h = 1.0 / np.array(steps)
    for name, colour, dash, marker in zip(
        ("CG3", "CG4a", "CG5a"), COLOURS, DASHES, "os^", strict=False
    ):
        errors = final_errors(
            problem.f, (0.0, 1.0), problem.y0, exact, frame=problem.frame, method=name, h=h
        )
        label = f"{name}, order {methods[name].order}"
        ax.loglog(h, errors, color=colour, linestyle=dash, marker=marker, label=label)
    ax.set_xticks(h, [f"1/{n}" for n in steps])
    ax.minorticks_off()
    ax.set(xlabel=f"step size ({unit})", ylabel=f"error at time 1 {unit}")
    ax.set_title("global error")
    ax.legend(loc="lower right")


def heavy_top(figure: Figure) -> None:
    """Draw the axis of the spinning top, and its invariants."""
    top = HeavyTop()
    solution = solve(top, 10.0, 0.01)
    ax, other = figure.subplots(1, 2)
    axis = top.frame.split(solution.y)[0][..., :, 2]
    ax.plot(axis[:, 0], axis[:, 1], color=COLOURS[0], linewidth=1.0)
    ax.set(xlabel="axis of the top, $x$ (1)", ylabel="axis of the top, $y$ (1)", aspect="equal")
    ax.set_title("where the axis points, seen from above")
    drift(other, top, solution)


def free_rigid_body(figure: Figure) -> None:
    """Draw polhodes on the sphere of momenta, and errors."""
    ax = figure.add_subplot(1, 2, 1, projection="3d")
    inertia = (3.0, 2.0, 1.25)
    grid = np.linspace(0, 2 * np.pi, 41)
    rings = np.linspace(0, np.pi, 21)
    ax.plot_wireframe(
        np.outer(np.cos(grid), np.sin(rings)), np.outer(np.sin(grid), np.sin(rings)),
        np.outer(np.ones_like(grid), np.cos(rings)), color="#bbbbbb", linewidth=0.3,
    )  # fmt: skip
    starts = {
        "about the largest moment": (1.0, 0.5, 0.25),
        "near the middle one": (0.05, 1.0, 0.05),
        "about the smallest": (0.25, 0.5, 1.0),
    }
    t = np.linspace(0, 40, 2000)
    for (label, m), colour, dash in zip(starts.items(), COLOURS, DASHES, strict=False):
        u = FreeRigidBody(inertia, m).exact_momentum(t) / np.linalg.norm(m)
        ax.plot(*u.T, color=colour, linestyle=dash, label=label)
    ax.set(xlabel="$m_1/|m|$ (1)", ylabel="$m_2/|m|$ (1)", zlabel="$m_3/|m|$ (1)")
    ax.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1), zticks=(-1, 0, 1))
    ax.set_box_aspect((1, 1, 1), zoom=0.85)
    ax.set_title("angular momentum in body axes")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=1)
    body = FreeRigidBody(inertia)
    reference = body.reference([1], bits=128).y[0]
    orders(figure.add_subplot(1, 2, 2), body, reference, (8, 16, 32, 64, 128))


def rolling_ball(figure: Figure) -> None:
    """Draw the path of the ball over its turntable, and its invariants."""
    solution = solve(ball, 12.0, 0.02)
    ax, other = figure.subplots(1, 2)
    exact = ball.exact_position(np.linspace(0, 12, 400))
    ax.plot(*exact.T, color=COLOURS[1], linewidth=4.0, alpha=0.4, label="exact circle")
    ax.plot(*solution.y[:, 12:].T, color=COLOURS[0], label="CG4a", linestyle="--")
    ax.plot(*ball.y0[12:], "o", color="black", label="start")
    ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)", aspect="equal")
    ax.set_title("place of the ball, seen from above")
    ax.legend(loc="center")
    drift(other, ball, solution)


def spacecraft(figure: Figure) -> None:
    """Draw how control aligns the craft with its orbit, and the energy without control."""
    ax, other = figure.subplots(1, 2)
    craft = Spacecraft(stiffness=1.0, damping=1.0)
    solution = solve(craft, 15.0, 0.02)
    lines(ax, solution.t, solution.y[:, :4].T, ("$q_1$", "$q_2$", "$q_3$", "$q_4$"))
    ax.set(xlabel="time (s)", ylabel="quaternion from body to orbit (1)")
    ax.set_title("with control")
    ax.legend(loc="center right", ncols=2)
    free = Spacecraft()
    drift(other, free, solve(free, 15.0, 0.02))


def gyro(figure: Figure) -> None:
    """Draw sampled rates of a coning motion, and what the sampling costs."""
    ax, other = figure.subplots(1, 2)
    motion = ConingMotion()
    coarse = np.linspace(0.0, 4.0, 21)
    fine = np.linspace(0.0, 4.0, 400)
    labels = (r"$\omega_1$", r"$\omega_2$", r"$\omega_3$")
    lines(ax, fine, motion.rate(fine).T, labels)
    for row, colour in zip(motion.rate(coarse).T, COLOURS, strict=False):
        ax.plot(coarse, row, "o", color=colour, markersize=4.0)
    ax.set(xlabel="time (s)", ylabel="angular velocity in body axes (rad/s)", ylim=(-1.6, 2.1))
    ax.set_title("coning motion and samples of a gyro")
    ax.legend(loc="upper center", ncols=3)
    for n, colour, dash in zip((20, 80, 320), COLOURS, DASHES, strict=False):
        problem = motion.sampled(np.linspace(0.0, 4.0, n + 1))
        solution = solve(problem, 4.0, 1 / 64)
        error = problem.frame.distance(solution.y, motion.attitude(solution.t))
        label = f"interval {4 / n:g} s"
        other.semilogy(solution.t[1:], error[1:], color=colour, linestyle=dash, label=label)
    other.set(xlabel="time (s)", ylabel="error of the attitude (rad)")
    other.set_title("CG4a, h = 1/64 s, cubic spline through the samples")
    other.legend(loc="lower right")


def toda(figure: Figure) -> None:
    """Draw how the diagonal sorts itself, and that the eigenvalues stay."""
    ax, other = figure.subplots(1, 2)
    flow = TodaFlow()
    solution = solve(flow, 8.0, 0.02)
    diagonal = np.diagonal(solution.y, axis1=1, axis2=2).T
    lines(ax, solution.t, diagonal, [f"$L_{{{i}{i}}}$" for i in range(1, 5)])
    for value in flow.frame.spectrum:
        ax.axhline(value, color="black", linewidth=0.6, linestyle=":")
    ax.set(xlabel="time (1)", ylabel="diagonal of the matrix (1)")
    ax.set_title("the diagonal tends to the eigenvalues (dotted)")
    ax.legend(loc="center right", ncols=2)
    drift(other, flow, solution, unit="")


def two_levels(figure: Figure) -> None:
    """Draw Rabi's oscillations, and the error of the propagator."""
    ax, other = figure.subplots(1, 2)
    for drive, colour, dash in zip((2.0, 2.5, 4.0), COLOURS, DASHES, strict=False):
        system = TwoLevelSystem(splitting=2.0, coupling=1.0, drive=drive)
        solution = solve(system, 15.0, 0.1)
        population = np.abs(solution.y[:, 1, 0]) ** 2
        label = f"field at {drive:g} rad/s"
        ax.plot(solution.t, population, color=colour, linestyle=dash, label=label)
        exact = system.transition_probability(solution.t)
        ax.plot(solution.t[::5], exact[::5], ".", color=colour, markersize=4.0)
    ax.set(xlabel="time (s)", ylabel="population of the other level (1)", ylim=(-0.02, 1.2))
    ax.set_yticks(np.linspace(0.0, 1.0, 6))
    ax.set_title("levels 2 rad/s apart; dots: Rabi's formula")
    ax.legend(loc="upper center", ncols=3, columnspacing=1.0, handlelength=2.0, fontsize=8.5)
    system = TwoLevelSystem()
    orders(other, system, system.exact(1.0), (4, 8, 16, 32, 64))


def double_pendulum(figure: Figure) -> None:
    """Draw the paths of both masses, and the invariants."""
    solution = solve(pendulum, 8.0, 0.005)
    ax = figure.add_subplot(1, 2, 1, projection="3d")
    for place, label, colour in zip(
        pendulum.positions(solution.y), ("first mass", "second mass"), COLOURS, strict=False
    ):
        ax.plot(*place.T, color=colour, label=label, linewidth=0.9)
    first, second = pendulum.positions(pendulum.y0)
    ax.plot(*np.stack([np.zeros(3), first, second]).T, "o-", color="black", label="at time 0")
    ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)", zlabel="$z$ (m)")
    ax.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1), zticks=(-1.5, -1, -0.5, 0))
    ax.set_aspect("equal")
    ax.set_title("the masses in space, 8 s")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=3, columnspacing=1.0)
    drift(figure.add_subplot(1, 2, 2), pendulum, solution)


def body_with_pendulum(figure: Figure) -> None:
    """Draw the paths of the joint and the mass, and the invariants."""
    solution = solve(chain, 5.0, 0.005)
    ax = figure.add_subplot(1, 2, 1, projection="3d")
    names = ("joint of the body", "mass of the pendulum")
    for place, label, colour in zip(chain.positions(solution.y), names, COLOURS, strict=False):
        ax.plot(*place.T, color=colour, label=label, linewidth=0.9)
    joint, mass = chain.positions(chain.y0)
    ax.plot(*np.stack([np.zeros(3), joint, mass]).T, "o-", color="black", label="at time 0")
    ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)", zlabel="$z$ (m)")
    ax.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1), zticks=(-1.5, -1, -0.5, 0))
    ax.zaxis.labelpad = 8.0
    ax.set_aspect("equal")
    ax.set_title("body and pendulum in space, 5 s")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=2, columnspacing=1.0)
    drift(figure.add_subplot(1, 2, 2), chain, solution)


def reaction_wheels(figure: Figure) -> None:
    """Draw where the momentum goes, and that its sum stays."""
    ax, other = figure.subplots(1, 2)
    satellite = ReactionWheels()
    solution = solve(satellite, 12.0, 0.02)
    satellite_momentum = np.array(satellite.inertia) * solution.y[:, 4:7]
    size = np.linalg.norm
    parts = (size(satellite_momentum, axis=1), size(solution.y[:, 7:], axis=1))
    angle = 2.0 * np.arcsin(np.minimum(size(solution.y[:, :3], axis=1), 1.0))
    labels = ("momentum of the satellite (N m s)", "momentum of the wheels (N m s)")
    lines(ax, solution.t, (*parts, angle), (*labels, "angle to the commanded attitude (rad)"))
    ax.set(xlabel="time (s)", ylabel="size (N m s, rad)")
    ax.set_title("the wheels take the momentum over")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16))
    drift(other, satellite, solution)


def forced_rigid_body(figure: Figure) -> None:
    """Draw the angular velocity under a torque, and errors."""
    ax, other = figure.subplots(1, 2)
    body = ForcedRigidBody()
    solution = solve(body, 20.0, 0.02)
    labels = (r"$\omega_1$", r"$\omega_2$", r"$\omega_3$")
    lines(ax, solution.t, solution.y[:, 9:].T, labels)
    ax.set(xlabel="time (s)", ylabel="angular velocity in body axes (rad/s)")
    ax.set_title("a torque that goes round once in 6.3 s")
    ax.legend(loc="upper center", ncols=3)
    ax.set_ylim(top=1.35 * solution.y[:, 9:].max())
    orders(other, body, body.reference([1], bits=128).y[0, :12], (8, 16, 32, 64, 128))


def gradient_flow(figure: Figure) -> None:
    """Draw how the action falls, and errors."""
    ax, other = figure.subplots(1, 2)
    for roughness, colour, dash in zip((0.25, 0.5, 1.0), COLOURS, DASHES, strict=False):
        problem = GradientFlow(roughness=roughness)
        solution = solve(problem, 1.0, 0.02, "CF4")
        action = problem.action(solution.y) / (6 * problem.lattice.sites)
        label = f"links {roughness:g} from the identity"
        ax.semilogy(solution.t, action, color=colour, linestyle=dash, label=label)
    ax.set(xlabel="flow time (1)", ylabel="action for each plaquette (1)")
    ax.set_title("the flow smooths a field, $2^4$ sites")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16))
    small = GradientFlow((2, 2))
    exact = small.reference([1]).y.view(complex).reshape(small.y0.shape)
    orders(other, small, exact, (8, 16, 32, 64, 128), unit="")
    other.set(xlabel="step size (1)", ylabel="error at time 1")
    other.set_title("global error, $2^2$ sites")


def order_tests(figure: Figure) -> None:
    """Draw the errors on the two problems that see every tree."""
    ax, other = figure.subplots(1, 2)
    steps = (8, 16, 32, 64, 128)
    rotation = StateDependentRotation()
    exact = rotation.reference([1], bits=128).y[0, :9].reshape(3, 3)
    orders(ax, rotation, exact, steps)
    ax.set_title("a rotation that depends on where it is")
    from cg.frames import Sphere

    field = AffineField(Sphere(2), [0.0, 0.0, 1.0], seed=3)
    orders(other, field, field.reference([1], bits=128).y[0, :3], steps)
    other.set_title("affine coefficients on the sphere")


FIGURES: dict[str, Callable[[Figure], None]] = {
    "heavy_top": heavy_top,
    "free_rigid_body": free_rigid_body,
    "rolling_ball": rolling_ball,
    "spacecraft": spacecraft,
    "gyro": gyro,
    "toda": toda,
    "two_levels": two_levels,
    "double_pendulum": double_pendulum,
    "body_with_pendulum": body_with_pendulum,
    "reaction_wheels": reaction_wheels,
    "forced_rigid_body": forced_rigid_body,
    "gradient_flow": gradient_flow,
    "order_tests": order_tests,
}


def main(names: Sequence[str]) -> None:
    """Draw the figures of the given names, or all."""
    unknown = set(names) - FIGURES.keys()
    if unknown:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(FIGURES)}")
    for name in names or FIGURES:
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(9.0, 4.2), layout="constrained")
            FigureCanvasAgg(figure)
            FIGURES[name](figure)
            figure.savefig(FOLDER / f"{name}.png", dpi=110)
        print(f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
