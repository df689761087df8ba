"""Linear equations: coefficients that depend on time alone."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Unpack

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.frames.base import Frame
from cg.frames.linear_action import LinearAction
from cg.integration.arguments import check_args
from cg.integration.default_method import AUTO
from cg.integration.ensemble import solve_members
from cg.integration.options import Options, complete_options, expand_options
from cg.integration.problem import make_problem
from cg.integration.results import Solution
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.rhs.function import CompiledFunction, TimeFunction
from cg.method.magnus import MagnusMethod
from cg.support.checks import check_flag

_DEFAULT = "CFM8(4)"  # within 20 % of the fewest evaluations and the least time on the benchmarks
_NODES = 9  # of interpolation on LinearAction; more of them save few evaluations and no products


@expand_options
def solve_linear(
    a: Callable[..., ArrayLike] | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Any,
    frame: Frame,
    vectorized: bool = False,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> Solution:
    r"""Solve :math:`y' = \sum_i a_i(t) E_i(y)`, :math:`y(t_0) = y_0`, on a manifold.

    The coefficients depend on time alone: a prescribed angular velocity, or a Schrödinger equation
    with controls. Commutator-free Magnus methods take a step of order six with four or six flows,
    and of order eight with eight, where commutator-free Runge–Kutta methods of the catalogue need
    at least 13 and 39. On `cg.frames.LinearAction` a step is one flow, along the polynomial that
    interpolates the coefficients at the nodes of the method.

    Parameters
    ----------
    a : callable
        ``a(t)`` returns the coefficients, shape ``(frame.dim,)``. Compiled functions are those of
        `cg.solve_ivp`; one that reads the point it gets is refused.
    t_span, y0, frame
        As for `cg.solve_ivp`.
    method : str or Method, optional
        A name in `cg.methods`, or a `cg.MagnusMethod`. By default ``"CFM8(4)"``, on
        `cg.frames.LinearAction` the nine nodes of Lobatto's formula. Other methods take the steps
        of `cg.solve_ivp` without computing points of stages, so that those of Munthe-Kaas need one
        flow per step.
    h, rtol, atol, t_eval, dense_output, events, breakpoints, max_step, first_step, max_steps
        As for `cg.solve_ivp`. Steps are chosen by the differences from two results of lower order,
        on `cg.frames.LinearAction` by the last coefficients of the interpolating polynomial, or
        are all of size ``h``.
    args, parameters, observe, store, progress
        As for `cg.solve_ivp`.
    vectorized : bool, optional
        Whether ``a`` takes times of shape ``(k,)``, with rows of parameters of shape ``(k, p)``,
        and returns shape ``(k, frame.dim)``. It is called once per step, with the times of all
        stages but a first one at the start, which is known from the step before. Starts and nodes
        of dense output are single times.

    Returns
    -------
    Solution
        That of `cg.solve_ivp`; ``nfev`` counts the times at which ``a`` was evaluated.

    Raises
    ------
    TypeError, ValueError
        As for `cg.solve_ivp`.

    Examples
    --------
    A driven two-level system:

    >>> import numpy as np
    >>> from cg.frames import SU
    >>> def a(t):  # a spin in a constant field and one that rotates in resonance with it
    ...     return [0.5 * np.cos(4 * t), 0.5 * np.sin(4 * t), 4.0]
    >>> run = solve_linear(a, (0, np.pi), np.eye(2), frame=SU(2), rtol=1e-10, atol=1e-10)
    >>> run.success, abs(run.y[-1][1, 0]).round(8)
    (True, np.float64(0.70710678))
    """
    given = complete_options(solve_linear, rest, options)
    vectorized = check_flag("vectorized", vectorized)
    given["args"] = args = check_args(given["args"])
    if compiled_rhs(a, "a") is None:
        _check_callable(a, args, given["parameters"])
    method = given["method"]
    if isinstance(method, str) and method == AUTO:
        given["method"] = _lobatto() if isinstance(frame, LinearAction) else _DEFAULT
    function: Any = a
    problem = make_problem(
        TimeFunction(function, vectorized), t_span, y0, frame=frame, options=given
    )
    return solve_members(problem, progress)[0]


@cache
def _lobatto() -> MagnusMethod:
    """Return the method whose only flow has the nodes and weights of Lobatto's formula."""
    legendre = Legendre.basis(_NODES - 1)
    x = np.array([-1.0, *legendre.deriv().roots(), 1.0])
    weights = 1 / (_NODES * (_NODES - 1) * legendre(x) ** 2)
    nodes, flow = ([f"{number:.16f}" for number in row] for row in ((x + 1) / 2, weights))
    return MagnusMethod(nodes, [flow], name="Lobatto's formula")


def _check_callable(a: Any, args: tuple[Any, ...], parameters: Any) -> None:
    """Raise TypeError unless ``a`` takes a time with the further arguments."""
    names = ["t", *(f"args[{k}]" for k in range(len(args)))]
    names += ["parameters"] * (parameters is not None)
    call = f"a({', '.join(names)})"
    if not callable(a):
        raise TypeError(f"a must be callable as {call}, got {a!r}")
    try:
        signature = inspect.signature(a)
    except ValueError:  # some functions that are not Python's have none
        return
    try:
        signature.bind(*names)
    except TypeError:
        raise TypeError(
            f"a must be callable as {call}, got a function of {signature}; coefficients that "
            "depend on the point need cg.solve_ivp"
        ) from None
