"""Derivatives of solutions, and the solver for JAX, compared with differences of the model."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tests.model import accuracy, scripts
from tests.model.accuracy import EPS, Case, Difference, Unclear, near, raise_if_unclear
from tests.model.reference import covariance, difference, solve
from tests.model.scripts import CALL
from tests.model.spaces import reals


def _changes(case: Case) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return coordinates of a change of the start, and the changes of what f is given."""
    program, space = case.program, case.program.frame
    rng = np.random.default_rng(program.seed + 5)
    xi = rng.uniform(-1, 1, space.coordinates)
    changes = {"y0": space.tangent(xi, case.names["y0"])}
    if program.parameters:
        changes["parameters"] = rng.uniform(-1, 1, 2)
    return xi, changes


def _numbers(case: Case, step: float, changes: dict, times: Sequence[float]) -> np.ndarray:
    """Return points at times and then the times of events, of the changed problem."""
    path = solve(case.program.task(case.names, step, **changes))
    happened, before = ([t for events in each.events for t, *_ in events]
                        for each in (path, case.path))  # fmt: skip
    # an event that moves this far for a small step is another one
    if list(map(len, path.events)) != list(map(len, case.path.events)) or not np.allclose(
        happened, before, rtol=0.0, atol=0.1 * case.length
    ):
        raise Unclear("events change with the start")
    return np.concatenate([*(path(t) for t in times), happened])


def _check_derivative(case: Case, ours: Any, expected: Any, code: str) -> None:
    error = float(np.abs(ours - expected).max(initial=0.0))
    # differences multiply the rounding of f, which is that of t in parts of the span
    floor = 1e-7 + 4e5 * EPS * abs(case.program.start) / case.length
    if error > case.bound + floor:
        raise_if_unclear(case)
        bound = case.grown() * (1 + floor / case.bound)
        if error > bound:
            text = f"a derivative is off by {error:.2e}, bound {bound:.2e}"
            text += f": {np.array(ours)}, of the model {np.array(expected)}"
            raise Difference("derivative", text, code)


def derivatives(case: Case) -> None:
    if not case.program.derivatives or np.isinf(case.bound):
        return
    forward(case) if case.program.derivatives == "forward" else backward(case)


def _with_bound(case: Case, change: float) -> Case:
    """Return the case for derivatives that change by as much with shorter fixed steps."""
    return replace(case, bound=max(case.bound, 5 * change))


def _change_of_derivatives(case: Case, times: Sequence[float]) -> float:
    """Return by how much derivatives at times and those of events change with shorter steps."""
    coarse, fine = (case.solve(h=h, t_eval=list(times))
                    for h in (case.names["options"]["h"], case.short))  # fmt: skip
    pairs = [(getattr(coarse, name), getattr(fine, name))
             for name in ("transition", "sensitivity", "covariance")]  # fmt: skip
    pairs += zip(coarse.dt_events or (), fine.dt_events or (), strict=True)
    if any(a is not None and len(a) != len(b) for a, b in pairs):
        raise Unclear("shorter steps have other events")
    return max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs if a is not None)


def forward(case: Case) -> None:
    """Derivatives and covariances by the variational equation."""
    program, space, s = case.program, case.program.frame, case.solution
    xi, changes = _changes(case)
    size = reals(space.base).size
    model = difference(lambda step: _numbers(case, step, changes, s.t))
    points, happened = np.split(model, [len(s.t) * size])
    moves = 3e-4 * np.abs(happened)  # of jumps; steps of the difference are up to 2e-4
    kept = [i for i, t in enumerate(s.t) if not case.beside_jump(t, case.bound, moves)]
    if program.steps:
        ends = abs(case.path.end - s.t) < 1e-9 * case.length  # shorter steps may end before
        times = [float(s.t[i]) for i in kept if not (case.path.terminated and ends[i])]
        case = _with_bound(case, _change_of_derivatives(case, times))
    lines = f"{CALL}\nprint(s.transition, s.sensitivity)  # xi = {xi.tolist()}, {changes}"
    for i, row in zip(kept, points.reshape(len(s.t), size)[kept], strict=True):
        coordinates = s.transition[i] @ xi
        if program.parameters:
            coordinates = coordinates + s.sensitivity[i] @ changes["parameters"]
        _check_derivative(case, space.tangent(coordinates, s.y[i]), row, lines)
    if program.events and sum(map(len, s.t_events)) != len(happened):
        raise Unclear("the number of events depends on errors")  # or `alone` has raised
    elif program.events:
        change = np.append(xi, changes.get("parameters", []))
        ours, slopes = np.concatenate(s.dt_events) @ change, np.concatenate(case.path.slopes)
        scale = np.minimum(1.0, slopes)
        _check_derivative(case, ours * scale, happened * scale, lines)
    elif size <= 9 and program.output is None:
        fields = np.stack([space.tangent(e, s.y[-1]) for e in np.eye(space.coordinates)], axis=1)
        ours = fields @ s.covariance[-1] @ fields.T
        spread = np.diag(np.arange(1.0, space.coordinates + 1)) / program.length * program.noisy
        model = covariance(case.path.task, 0.1 * np.eye(space.coordinates), spread)
        size = max(1.0, float(np.abs(model).max()))
        _check_derivative(
            case, ours / (2 * size), model / (2 * size), f"{CALL}\nprint(s.covariance)"
        )


def backward(case: Case) -> None:
    """The gradient of one number by the start, parameters and inputs, by the adjoint equation."""
    program, space, s = case.program, case.program.frame, case.solution
    if not s.success:  # whether it may fail is compared elsewhere
        raise Unclear("the solution has failed")
    accuracy.raise_if_singular(case, 2)
    rng = np.random.default_rng(7)
    xi, changes = _changes(case)
    for k, samples in enumerate(program.inputs):
        changes[f"values{k}"] = samples.scale * rng.uniform(-1, 1, samples.count)
    rows = range(len(s.t)) if program.output else [-1]
    # errors at several times add up as their root mean square does
    weights = rng.uniform(-1, 1, (len(rows), reals(space.base).size)) / np.sqrt(len(rows))

    def gradient(call: str, s: Any) -> tuple[str, float]:
        """Return the lines of a gradient, and the change of the cost that it says."""
        cotangent = np.array([
            [weight @ space.tangent(e, s.y[i]) for e in np.eye(space.coordinates)]
            for i, weight in zip(rows, weights, strict=True)
        ])  # fmt: skip
        cotangent = cotangent if program.output else cotangent[0]
        code = f"{call}\ng = s.gradient(np.array({cotangent.tolist()}))"
        g = case.run(code)["g"]
        inputs = g.inputs if isinstance(g.inputs, tuple) else (g.inputs,)
        change = g.y0 @ xi + (g.parameters @ changes["parameters"] if program.parameters else 0.0)
        of_inputs = (inputs[k] * changes[f"values{k}"] for k in range(len(program.inputs)))
        return code, float(change + sum(map(np.sum, of_inputs)))

    code, ours = gradient(CALL, s)
    if program.steps:
        call = CALL.replace("**options", f"**{{**options, 'h': {case.short!r}}}")
        case = _with_bound(case, abs(ours - gradient(call, case.solve(call))[1]))
    expected = difference(lambda step: _numbers(case, step, changes, s.t[rows]))
    lines = f"{code}\nprint(g)  # xi = {xi.tolist()}, {changes}"
    _check_derivative(case, ours, weights.ravel() @ expected, lines)


def in_jax(case: Case) -> None:
    """The solver for JAX, and its derivatives by parameters."""
    program = case.program
    code = scripts.JAX.replace("REST", "(parameters,)" if program.parameters else "()")
    run = case.run(code)
    times = np.linspace(program.start, program.end, 4)[1:]
    near(case, times, np.array(run["y"]), code)
    if program.parameters:
        weights = np.random.default_rng(7).uniform(-1, 1, run["y"].shape)
        changes = {"parameters": np.array([1.0, 0.5])}
        ours = float(run["slope"](weights)[0][0] @ changes["parameters"])
        expected = difference(lambda step: _numbers(case, step, changes, times))
        _check_derivative(case, ours, weights.ravel() @ expected, code)
