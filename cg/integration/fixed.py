"""Integration with a fixed step."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.checks import LARGEST_COUNT
from cg.frames.base import Frame
from cg.integration.arguments import check_count
from cg.integration.compiled_function import CompiledFunction
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.problem import make_problem
from cg.integration.progress import Progress
from cg.integration.python_rhs import Coefficients
from cg.integration.recorder import Recorder
from cg.integration.results import Trajectory
from cg.integration.stop_iteration import keeping_stop_iteration
from cg.integration.time_grid import make_grid
from cg.method import Method
from cg.pairs import check_order

__all__ = ["integrate"]


@keeping_stop_iteration
def integrate(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Method,
    h: float,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    save_every: int = 1,
    workers: int = 1,
    parameters: ArrayLike | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Trajectory:
    r"""Integrate :math:`y' = \sum_i f_i(t, y) E_i(y)` with a fixed step.

    A step of an explicit method follows its points: with :math:`F_k` the vector field whose
    coefficients are frozen at stage :math:`k`,

    .. math:: y_m = \exp\Bigl(h \sum_k \alpha_{m,k} F_k\Bigr) y_{\mathrm{parent}(m)} ,

    which for a Crouch-Grossman method is equation (2.2) of [1]_; for an implicit one it is (2.3).
    The flow of the lowest stage is applied first, the coefficients of stage :math:`i` are taken
    at :math:`t_k + c_i h`, and a coefficient that is exactly zero costs no flow.  Steps of
    methods on Lie algebras are those of `cg.MuntheKaas`.

    Parameters
    ----------
    f
        ``f(t, y)`` returns the coefficients, shape ``(*batch, frame.dim)``.  It is given a
        read-only ``y`` of shape ``(*batch, *frame.point_shape)``.  An exception that it raises
        ends the call.

        It may also be a compiled function ``int f(double t, const double *y, double *f,
        void *user_data)``, given as a `scipy.LowLevelCallable`, a function pointer of ctypes, or
        a ``numba.cfunc``.  It is given one point, writes the coefficients, and returns zero, or
        else ends the call.  Explicit methods then run wholly in compiled code, without Python's
        lock, on SO(n), SU(n), U(n) up to n = 12, unit quaternions, SE(3), the sphere in space,
        Euclidean space and their products, and isospectral orbits of real matrices up to n = 12.
    t_span
        Initial and final time.  If the final time is smaller, integration runs backward.
    y0
        Initial point, shape ``frame.point_shape``; or with any number of leading axes, an
        ensemble of initial points that are integrated at once.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, or a method; see `cg.solve_ivp`.
    h
        Step size, positive whatever the direction.  If it doesn't divide the span, the last
        step is shorter.
    stage_solver
        How the stages of an implicit method are found: ``"newton"`` or ``"fixed-point"``.
    save_every
        Store the result of every so many steps, besides the initial and the final point.
    workers
        Number of threads over which a compiled ``f`` spreads an ensemble; it must allow that.
    parameters
        For a compiled ``f``: numbers whose address it is given as its last argument, shape
        ``(*batch, k)``, those of its own member of an ensemble.
    progress
        Called with the time that was covered and the length of ``t_span``, at most ten times a
        second and when the end is reached.

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError
        If ``f`` isn't callable, ``frame`` isn't a `Frame`, ``method`` is neither a name nor a
        tableau, or ``h`` isn't a real number.
    ValueError
        If ``t_span``, ``y0``, ``method`` or ``h`` has an impossible value, or if ``f`` returns
        another shape or numbers that aren't finite; or if the steps need more memory than there
        is.
    OverflowError
        If the solution exceeds the range of floating point.
    ConvergenceError
        If the stages of an implicit method can't be found.
    StepTooLongError
        If a step of a method on a Lie algebra is too long for dexp⁻¹.
    RuntimeError
        If a compiled ``f`` returns another number than zero, for a single point.

    Warns
    -----
    UserWarning
        If members of an ensemble for a compiled ``f`` fail; they are NaN from there on.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    A rotation about a fixed body axis is solved exactly by any method.

    >>> import numpy as np
    >>> from cg.frames import SO3
    >>> from cg.integration import integrate
    >>> turn = lambda t, y: [0.0, 0.0, np.pi / 2]
    >>> solution = integrate(turn, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.25)
    >>> solution.y[-1].round(12)[:, 0]
    array([0., 1., 0.])
    """
    problem = make_problem(f, frame, method, y0, parameters=parameters, stage_solver=stage_solver)
    check_order(problem.method, stacklevel=3)
    save_every = min(check_count(save_every, "save_every"), LARGEST_COUNT)
    workers = check_count(workers, "workers")
    if workers != 1 and not (isinstance(problem.rhs, CompiledRhs) and problem.in_compiled_code):
        raise ValueError(
            f"workers must be 1 unless f is compiled and so are the flows, got {workers!r}"
        )
    grid = make_grid(t_span, h)
    problem.check_grid(grid, h, every=save_every, between=False)
    watch = Progress(progress, grid.start, grid.stop)
    stepper = problem.stepper(grid, every=save_every, workers=workers, keep=True)
    recorder = Recorder(stepper, grid.start, problem.points, None, False, {})
    for block in stepper.blocks():
        recorder.add(block)
        watch.reach(block.t[-1])
    watch.finish()
    if stepper.failures:
        index, reason = min(stepper.failures.items())
        warnings.warn(
            f"{len(stepper.failures)} members of the ensemble failed, y0{list(index)} since "
            f"{reason}",
            stacklevel=3,
        )
    counts = stepper.counts
    return Trajectory(
        t=recorder.times(),
        y=recorder.points(),
        nfev=counts.nfev,
        nexp=counts.nexp,
        steps=counts.steps,
        method=problem.method,
        h=float(h),
        failures=dict(stepper.failures),
        frame=frame,
    )
