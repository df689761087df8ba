"""Ensembles: many initial value problems, integrated independently on any executor."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from typing import Any, Unpack

from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.integration.member_results import Collector, MemberResults
from cg.integration.members import add_derivatives, check_output_size, integrate_members
from cg.integration.options import EnsembleOptions, complete_options, expand_options
from cg.integration.output.solutions import EnsembleSolution
from cg.integration.problem import DERIVATIVE_OPTIONS, Problem, make_problem
from cg.integration.rhs.function import Function
from cg.integration.run.drive import Progress
from cg.support.checks import warn_user
from cg.support.frozen import changed
from cg.support.parallel import check_executor, completed, count_workers, single_threads

_MEMBERS_PER_RUN = 1 << 14  # limits the memory of a run
_CHUNKS_PER_WORKER = 16  # many chunks, so that all workers end at about the same time
_BATCHES_PER_WORKER = 4  # chunks for a vectorized function, which is faster with many members


@expand_options()
def solve_ensemble(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[EnsembleOptions],
) -> EnsembleSolution:  # fmt: skip
    """Solve an initial value problem from many points, or with many sets of parameters.

    Each member takes the steps that it would take alone in `cg.solve_ivp`, to the bit.

    Parameters
    ----------
    f
        ``f(t, y, *args)``, or ``f(t, y, *args, row)`` with a row of ``parameters``, returns the
        coefficients of one member; see `cg.solve_ivp`. If ``vectorized`` it is given times
        ``(k,)``, points ``(k, *frame.point_shape)`` and rows ``(k, n)`` of any subset of the
        members, and returns shape ``(k, frame.dim)``, on a `cg.frames.PhaseSpace` ``(k, forces)``.
    y0
        Initial points, shape ``(members, *frame.point_shape)``; a single point serves all rows
        of ``parameters`` and all members of ``inputs``.
    t_span, frame
        As for `cg.solve_ivp`, as are all options that aren't listed here, of one member.
    inputs
        As for `cg.solve_ivp`; those with ``members=True`` have values of each member. If
        ``vectorized``, ``f`` gets a row of values for each member. A list has those of each member,
        with times of their own: steps of a member end where its own curves jump.
    t_eval
        Times at which to store the solution; by default the ends of ``t_span``.
    parameters
        Numbers of each member, shape ``(members, n)``, which all functions are given as last
        argument; a compiled ``f`` is given their address.
    inertia
        On a `cg.frames.PhaseSpace` a sequence of the inertia of each member, in place of that of
        the frame: an array of shape ``(members, 3)`` for bodies with three moments. What the frame
        itself computes, such as velocities and its kinetic energy, is that of its own inertia.
        Members with joints or ``derivatives`` are integrated one by one, not in ``common_steps``.
        Derivatives by parameters are those through ``f``, not through the inertia.
    vectorized
        Whether ``f`` takes many members at a time. ``jac``, ``df_dp`` and ``noise`` then take and
        return arrays of one member each too, with the axis of members first.
    derivatives
        None or ``"forward"``, not with ``linear``.
    P0
        Covariance of the coordinates of ``y0``, or one for each member, ``(members, dim, dim)``.
    common_steps
        Whether all members take the same steps, those that the member with the largest error
        calls for. Steps of ``"RadauIIA5"`` don't depend on how fast Newton's method converges
        then, which differs between members, so that even one member alone takes other steps than
        in `cg.solve_ivp`; the solutions differ by the errors of both.
    executor, workers
        Where members are integrated, and by how many workers: in this thread by default, by
        ``workers`` threads, or by any executor that `cg.search` takes. On one machine they
        change no bit of the result, since BLAS has one thread in all cases. Other processes must
        be able to unpickle ``f``: `cg.CompiledFunction` for a compiled one.
    out
        Array of shape ``(times, members, *frame.point_shape)`` that receives the points, such as
        one of NumPy on disk, of zarr or h5py; then ``y`` is ``out`` itself. With
        ``store="observed"`` it receives what ``observe`` returns, and ``observed`` is ``out``.
        It is None with ``derivatives``.
    progress
        Called with the time that was covered, summed over the members, and its total.

    Returns
    -------
    EnsembleSolution
        Members that fail are NaN after their ends, and the others go on.

    Raises
    ------
    RuntimeError
        If a worker died.

    Warns
    -----
    UserWarning
        If members failed; it names their number and the first one. Or, while members take
        thousands of steps, for the reasons of `cg.solve_ivp`.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> rates = np.linspace(0.5, 1.5, 5)[:, None]
    >>> solution = cg.solve_ensemble(
    ...     lambda t, y, rate: [0.0, np.sin(t), rate[0]], (0, 5), np.eye(3),
    ...     frame=cg.frames.SO3(), parameters=rates, t_eval=[0, 1, 5], rtol=1e-8, atol=1e-8,
    ... )
    >>> solution.y.shape, solution.success
    ((3, 5, 3, 3), True)
    """
    return solve_members(solve_ensemble, f, t_span, y0, frame, options)


@expand_options(linear=True)
def solve_linear_ensemble(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[EnsembleOptions],
) -> EnsembleSolution:  # fmt: skip
    """Solve a linear equation from many points: `cg.solve_ensemble` with ``linear=True``.

    Members with their own generators are members with coefficients of their own along the
    generators of all.

    Parameters
    ----------
    f
        ``f(t, *args)``, or ``f(t, *args, row)`` with a row of ``parameters``, returns the
        coefficients of one member, shape ``(frame.dim,)``. If ``vectorized`` it takes times
        ``(k,)`` and rows ``(k, n)`` of any members, and returns shape ``(k, frame.dim)``.
    t_span, y0, frame
        As for `cg.solve_ensemble`, as are all options.

    Examples
    --------
    Spins with different detunings:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_linear_ensemble(
    ...     lambda t, row: [1.0, 0.0, row[0]], (0, np.pi), np.eye(2), frame=cg.frames.SU(2),
    ...     parameters=[[0.0], [1.0]], rtol=1e-9, atol=1e-9,
    ... )
    >>> abs(solution.y[-1, :, 1, 0]).round(6)
    array([1.     , 0.56264])
    """
    return solve_members(solve_linear_ensemble, f, t_span, y0, frame, options)


@expand_options(derivatives="forward")
def solve_variational_ensemble(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[EnsembleOptions],
) -> EnsembleSolution:  # fmt: skip
    """Solve from many points with derivatives: `cg.solve_ensemble` with ``derivatives="forward"``.

    Parameters
    ----------
    f, t_span, y0, frame
        As for `cg.solve_ensemble`, as are all options.

    Returns
    -------
    EnsembleSolution
        With ``transition``, ``sensitivity``, ``covariance`` and ``dt_events``.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational_ensemble(
    ...     lambda t, y, rate: [rate[0] * y[0]], (0, 1), [1.0], frame=cg.frames.Euclidean(1),
    ...     parameters=[[0.5], [1.0]], rtol=1e-9, atol=1e-9,
    ... )
    >>> solution.transition[-1].ravel().round(6)
    array([1.648721, 2.718282])
    """
    return solve_members(solve_variational_ensemble, f, t_span, y0, frame, options)


def solve_members(
    function: Any, f: Function, t_span: Sequence[float], y0: ArrayLike, frame: Frame,
    given_options: EnsembleOptions,
) -> EnsembleSolution:  # fmt: skip
    """Integrate the members of an ensemble for a ``function`` of this module."""
    options = complete_options(function, given_options)
    executor, workers, out = options["executor"], options["workers"], options["out"]
    # Derivatives are added to the whole problem, or, where each member has a problem of its own, to
    # each chunk, by `chunk_options`: then the problem with all derivatives collects results only.
    chunk_options: Any = None
    whole = make_problem(f, t_span, y0, frame, options, ensemble=True)
    problem = add_derivatives(whole, options)
    if whole.one_by_one and problem is not whole:
        problem = changed(problem, inertia=None)
        # covariances are computed from the collected derivatives, and not by the chunks
        names = "derivatives", "jac", *DERIVATIVE_OPTIONS
        chunk_options = {name: value for name, value in options.items() if name in names}
        chunk_options["P0"] = None
    else:
        whole = problem
    members = len(problem.points)
    if out is not None and problem.split_solution is not None:
        raise ValueError(f"out must be None with derivatives, got {type(out).__name__}")
    check_output_size(problem)
    distributed = executor is not None or workers is not None
    if distributed and problem.common_steps:
        raise ValueError("executor and workers must be None with common_steps")
    collector = Collector(problem, out)
    progress = Progress(options["progress"], problem.t0, problem.t1, members)
    if distributed:
        _distribute(whole, chunk_options, *check_executor(executor, workers), collector, progress)
    else:
        size = members if problem.common_steps else 1 if whole.one_by_one else _MEMBERS_PER_RUN
        with single_threads():  # as with workers, so that they change no bit
            for first in range(0, members, size):
                chunk = slice(first, min(first + size, members))
                own = add_derivatives(whole.of_members(chunk), chunk_options)
                collector.add(chunk, integrate_members(own, progress))
                progress.count_finished(chunk.stop - first)
    progress.finish()
    solution = collector.solution()
    for text in dict.fromkeys(collector.results().warnings):
        warn_user(text)
    if not solution.success:
        warn_user(solution.message)
    return solution


def _integrate_chunk(options: Any, item: tuple[slice, Problem]) -> MemberResults:
    """Integrate members in a worker."""
    return integrate_members(add_derivatives(item[1], options), None)


def _distribute(
    problem: Problem, options: Any, executor: Any, workers: Any, collector: Collector,
    progress: Progress,
) -> None:  # fmt: skip
    """Integrate members on an executor, in chunks whose sizes depend on no measured time."""
    members, chunk_count = len(problem.points), count_workers(executor, workers)
    chunk_count *= _BATCHES_PER_WORKER if problem.vectorized else _CHUNKS_PER_WORKER
    size = 1 if problem.one_by_one else max(1, min(_MEMBERS_PER_RUN, -(-members // chunk_count)))
    chunks = (slice(first, min(first + size, members)) for first in range(0, members, size))
    items = ((chunk, problem.of_members(chunk)) for chunk in chunks)
    work = partial(_integrate_chunk, options)
    with closing(completed(work, items, executor, workers)) as finished:
        for (chunk, _), results in finished:
            collector.add(chunk, results)
            progress.count_finished(chunk.stop - chunk.start)
            progress.update(0.0)
