"""Linear equations: coefficients that depend on time alone."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Unpack

from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.executors import ExecutorLike
from cg.frames.base import Frame
from cg.frames.linear_action import LinearAction
from cg.integration.adjoint import check_derivatives
from cg.integration.arguments import check_args
from cg.integration.default_method import AUTO
from cg.integration.ensemble import solve_members, solve_one
from cg.integration.linear_adjoint import with_linear_adjoint
from cg.integration.options import Options, complete_options, expand_options
from cg.integration.problem import Problem, make_problem
from cg.integration.results import EnsembleSolution, Solution
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.rhs.function import CompiledFunction, TimeFunction
from cg.integration.step.plan import has_brackets
from cg.support.checks import check_flag
from cg.support.shared_numbers import BlockKind

_WITH_BRACKETS, _WITHOUT = "Magnus8(4)", "CFM8(4)"
# Blocks with flows in closed form, where time and evaluations are least without brackets
_CLOSED_FORMS = frozenset(
    (BlockKind.EUCLIDEAN, BlockKind.SO3, BlockKind.QUATERNION, BlockKind.SE3, BlockKind.SPHERE,
     BlockKind.SU2)
)  # fmt: skip
# Nine nodes of interpolation on LinearAction; more of them save few evaluations and no products.
_LOBATTO = "Lobatto's formula"


@expand_options
def solve_linear(
    a: Callable[..., ArrayLike] | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Any,
    frame: Frame,
    vectorized: bool = False,
    derivatives: str | None = None,
    da_dp: Callable[..., ArrayLike] | CompiledFunction | LowLevelCallable[Any, Any] | None = None,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> Solution:
    r"""Solve :math:`y' = \sum_i a_i(t) E_i(y)`, :math:`y(t_0) = y_0`, on a manifold.

    The coefficients depend on time alone: a prescribed angular velocity, or a Schrödinger equation
    with controls. A Magnus method with brackets takes a step of order eight with one flow.
    Commutator-free ones take one of order six with four or six flows and one of order eight with
    eight, where commutator-free Runge–Kutta methods of the catalogue need at least 13 and 39. On
    `cg.frames.LinearAction` a step is one flow, along the polynomial that interpolates the
    coefficients at the nodes of the method.

    Parameters
    ----------
    a
        ``a(t)`` returns the coefficients, shape ``(frame.dim,)``. Compiled functions are those of
        `cg.solve_ivp`; one that reads the point it gets is refused.
    t_span, y0, frame
        As for `cg.solve_ivp`.
    method
        A name in `cg.methods`, or a `cg.MagnusMethod`. By default ``"Magnus8(4)"``, where flows
        are in closed form (rotations, rigid motions, SU(2)) or there is no `Frame.bracket`
        ``"CFM8(4)"``, on `cg.frames.LinearAction` the nine nodes of Lobatto's formula. Other
        methods take the steps of `cg.solve_ivp` without computing points of stages, so that those
        of Munthe-Kaas need one flow per step.
    h, rtol, atol, t_eval, dense_output, events, breakpoints, max_step, first_step, max_steps
        As for `cg.solve_ivp`. Steps are chosen by the differences from two results of lower order,
        on `cg.frames.LinearAction` by the last coefficients of the interpolating polynomial, or
        are all of size ``h``.
    args, parameters, inputs, observe, store, progress
        As for `cg.solve_ivp`; ``a`` becomes ``a(t, u, *args)`` with ``inputs``.
    vectorized
        Whether ``a`` takes times of shape ``(k,)``, with rows of parameters of shape ``(k, p)``,
        and returns shape ``(k, frame.dim)``. It is called once per step, with the times of all
        stages but a first one at the start, which is known from the step before. Starts and nodes
        of dense output are single times.
    derivatives
        ``"adjoint"`` for an `AdjointSolution`, whose method ``gradient`` returns derivatives of a
        number with respect to ``y0``, the parameters and the values of ``inputs``. It takes no
        ``events``, and is meant for `cg.frames.LinearAction` of up to some 50 dimensions, since
        matrices are dense.
    da_dp
        A function of the arguments of ``a`` that returns the derivatives of the coefficients with
        respect to the parameters and the inputs, shape ``(frame.dim, k)``; if ``vectorized``
        ``(times, frame.dim, k)``. By default central differences.

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
    >>> solution = solve_linear(a, (0, np.pi), np.eye(2), frame=SU(2), rtol=1e-10, atol=1e-10)
    >>> solution.success, abs(solution.y[-1][1, 0]).round(8)
    (True, np.float64(0.70710678))
    """
    given = complete_options(solve_linear, rest, options)
    problem = make_linear_problem(a, t_span, y0, frame, vectorized, given)
    if check_derivatives(derivatives):
        problem = with_linear_adjoint(problem, da_dp)
    elif da_dp is not None:
        raise ValueError(f"da_dp must be None without derivatives='adjoint', got {da_dp!r}")
    return solve_one(problem, progress)


@expand_options
def solve_linear_ensemble(
    a: Callable[..., ArrayLike] | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Any,
    frame: Frame,
    vectorized: bool = False,
    common_steps: bool = False,
    executor: ExecutorLike = None,
    workers: int | None = None,
    out: Any = None,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> EnsembleSolution:
    r"""Solve a linear equation from many points, or with many sets of parameters.

    Each member takes the steps that it would take alone in `cg.solve_linear`. Members with their
    own generators are members with coefficients of their own along the generators of all.

    Parameters
    ----------
    a
        ``a(t, *args)``, or ``a(t, *args, row)`` with a row of ``parameters``, returns the
        coefficients of one member, shape ``(frame.dim,)``. If ``vectorized`` it takes times
        ``(k,)`` and rows ``(k, n)`` of any members, and returns shape ``(k, frame.dim)``.
    t_span, y0, frame, parameters
        As for `cg.solve_ensemble`.
    method, h, rtol, atol, dense_output, events, breakpoints, args, max_step, first_step, max_steps
        As for `cg.solve_linear`.
    t_eval, vectorized, common_steps, executor, workers, out, progress
        As for `cg.solve_ensemble`.

    Returns
    -------
    EnsembleSolution
        Members that fail are NaN after their ends, and the others go on.

    Raises
    ------
    TypeError, ValueError, RuntimeError
        As for `cg.solve_ensemble`.

    Examples
    --------
    Spins with different detunings:

    >>> import numpy as np
    >>> from cg.frames import SU
    >>> solution = solve_linear_ensemble(
    ...     lambda t, row: [1.0, 0.0, row[0]], (0, np.pi), np.eye(2), frame=SU(2),
    ...     parameters=[[0.0], [1.0]], rtol=1e-9, atol=1e-9,
    ... )
    >>> abs(solution.y[-1, :, 1, 0]).round(6)
    array([1.     , 0.56264])
    """
    given = complete_options(solve_linear_ensemble, rest, options)
    problem = make_linear_problem(a, t_span, y0, frame, vectorized, given, True, common_steps)
    return solve_members(problem, progress, executor, workers, out)


def make_linear_problem(
    a: Any,
    t_span: Sequence[float],
    y0: ArrayLike,
    frame: Frame,
    vectorized: Any,
    given: Options,
    many: bool = False,
    common: bool = False,
) -> Problem:
    """Return the problem of a linear equation, or of many, after checking the arguments."""
    vectorized = check_flag("vectorized", vectorized)
    given["args"] = args = check_args(given["args"])
    if compiled_rhs(a, "a") is None:
        _check_callable(a, args, given["parameters"], given["inputs"])
    method = given["method"]
    if isinstance(method, str) and method == AUTO:
        given["method"] = _LOBATTO if isinstance(frame, LinearAction) else _default(frame)
    return make_problem(
        TimeFunction(a, vectorized), t_span, y0, frame=frame, options=given, many=many,
        common=common,
    )  # fmt: skip


def _default(frame: Frame) -> str:
    """Return the method with brackets, unless exponentials are cheap or there are no brackets."""
    blocks = frame.compiled_blocks() if isinstance(frame, Frame) else ()
    if blocks is not None and _CLOSED_FORMS.issuperset(block[0] for block in blocks):
        return _WITHOUT
    return _WITH_BRACKETS if has_brackets(frame) else _WITHOUT


def _check_callable(a: Any, args: tuple[Any, ...], parameters: Any, inputs: Any) -> None:
    """Raise TypeError unless ``a`` takes a time with the further arguments."""
    names = ["t", *["u"] * (inputs is not None), *(f"args[{k}]" for k in range(len(args)))]
    names += ["parameters"] * (parameters is not None)
    call = f"a({', '.join(names)})" + " with inputs u" * (inputs is not None)
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
