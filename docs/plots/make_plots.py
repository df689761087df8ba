"""Draw the pictures of the page on `cg.plot`: ``python docs/plots/make_plots.py``."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from PIL import Image

import cg
from cg.analysis.convergence import final_errors
from cg.problems import FreeRigidBody, StateDependentRotation

FOLDER = Path(__file__).parent


def figure(width: float = 4.5, height: float = 3.2, **options: Any) -> Any:
    """Return new axes of some size in inches."""
    return plt.figure(figsize=(width, height), layout="constrained").add_subplot(**options)


def trees() -> Any:
    """Draw the five trees of order three."""
    fig, axes = plt.subplots(1, 5, figsize=(7.5, 2.2), layout="constrained")
    for text, ax in zip(
        ["[[][][]]", "[[][[]]]", "[[[]][]]", "[[[][]]]", "[[[[]]]]"], axes, strict=True
    ):
        cg.plot.tree(text, ax)
    return fig


def fine(problem: Any, stop: float) -> Any:
    """Return the solution of a problem to rounding."""
    run = cg.integrate(
        problem.f, (0, stop), problem.y0, frame=problem.frame, method="CF6c", h=0.0025
    )
    return run.y[-1]


def convergence() -> Any:
    """Draw the convergence of three methods."""
    problem = StateDependentRotation()
    h = 0.2 / 2.0 ** np.arange(5)
    exact = fine(problem, 1.0)
    ax = figure()
    for name in ("CG3", "CF4", "CF5a"):
        errors = final_errors(
            problem.f, (0, 1), problem.y0, exact, frame=problem.frame, method=name, h=h
        )
        cg.plot.convergence(h, errors, ax, label=name, order=cg.methods[name].order)
    return ax.figure


def work_precision() -> Any:
    """Draw the work that pairs take for some errors."""
    problem = StateDependentRotation()
    exact = fine(problem, 5.0)
    ax = figure()
    for name in ("CG3(2)", "DP5(4)", "RKMK8(5,3)"):
        runs = [
            cg.solve_ivp(
                problem.f, (0, 5), problem.y0, frame=problem.frame, method=name, rtol=tol, atol=tol
            )
            for tol in 10.0 ** -np.arange(3, 11)
        ]
        errors = [problem.frame.distance(run.y[-1], exact) for run in runs]
        cg.plot.work_precision([run.nfev for run in runs], errors, ax, label=name)
    return ax.figure


def sphere() -> Any:
    """Draw two trajectories of a point on the sphere."""
    ax = figure(4.2, 4.0, projection="3d")
    frame = cg.frames.Sphere(2)
    for start, label in (([1.0, 0.0, 0.0], "from the equator"), ([0.6, 0.0, 0.8], "from 53° N")):
        run = cg.solve_ivp(
            lambda t, y: [0.4 * y[1], 0.3 * np.cos(t), 1.0], (0, 12), start, frame=frame,
            max_step=0.1,
        )  # fmt: skip
        cg.plot.trajectory_on_sphere(run, ax, label=label)
    return ax.figure


def axes_of_a_body() -> Any:
    """Draw the axes of a tumbling body."""
    problem = FreeRigidBody()
    run = cg.solve_ivp(
        problem.f, (0, 8), problem.y0, frame=problem.frame, max_step=0.05, rtol=1e-8, atol=1e-8
    )
    attitude, _ = problem.frame.split(run.y)
    return cg.plot.trajectory_of_axes(attitude, figure(4.2, 4.0, projection="3d")).figure


PICTURES = {
    "trees": trees,
    "tableau": lambda: cg.plot.tableau("CG4a", figure(4.2, 2.6)).figure,
    "points": lambda: cg.plot.points("CF4", figure(5.0, 3.0)).figure,
    "points_of_a_pair": lambda: cg.plot.points("DP5(4)", figure(6.0, 3.6)).figure,
    "stability": lambda: (
        cg.plot.stability_region(["CG2", "CG3", "CF4", "DP5(4)"], figure(4, 4)).figure
    ),
    "convergence": convergence,
    "work_precision": work_precision,
    "sphere": sphere,
    "axes": axes_of_a_body,
}


def main() -> None:
    """Draw all pictures."""
    for name, draw in PICTURES.items():
        whole = BytesIO()
        draw().savefig(whole, dpi=90)
        plt.close("all")
        # few colours are a half of the size
        Image.open(whole).convert("RGB").quantize(256).save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
