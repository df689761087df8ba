"""MINPACK's ``lmdif`` on a Python function, and on order conditions in double or real(16).

It minimises ``|f(x)|`` with a Jacobian by differences (J. J. Moré, LNM 630, 1978); see
``fortran/conditions/levenberg_marquardt.f90``. The paper's searches used it, so that this is the
algorithm to compare with.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg import _core_r64
from cg.construction.conditions.core_calls import Trees, described, evaluation_bytes
from cg.construction.layouts import Layout
from cg.support import quads
from cg.support.arrays import check_finite, real_array
from cg.support.checks import MAX_COUNT, check_integer, check_real
from cg.support.frozen import ReadOnly
from cg.support.memory import check_memory
from cg.support.parallel import StopFlag
from cg.support.shared_numbers import LmdifStatus

Vector = NDArray[np.float64]
Residual = Callable[[Vector], ArrayLike]

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class LmdifResult(ReadOnly):
    """The result of ``lmdif``. All arrays are read-only.

    Attributes
    ----------
    x
        Shape ``(n,)``. The last accepted point.
    fvec
        Shape ``(m,)``. ``f(x)``.
    info
        Why the solver stopped, MINPACK's code; compares equal to the integer.
    nfev
        Number of calls of ``f``, including those for differences.
    fjac
        Shape ``(m, n)``. The last Jacobian ``J`` factored as ``J[:, ipvt] = Q R``: ``R`` in the
        upper triangle of the first ``n`` rows, diagonal elements of decreasing magnitude.
    ipvt
        Shape ``(n,)``. The columns of ``J`` in the order of ``R``, counted from 0.
    qtf
        Shape ``(n,)``. The first ``n`` elements of ``Q^T f(x)``, with the ``x`` of the last
        Jacobian.
    """

    x: Vector
    fvec: Vector
    info: LmdifStatus
    nfev: int
    fjac: Vector
    ipvt: NDArray[np.intp]
    qtf: Vector

    @property
    def success(self) -> bool:
        """Whether one of the requested convergence tests was met."""
        return self.info.converged

    @property
    def message(self) -> str:
        """Why the solver stopped, as a sentence."""
        return self.info.message


def lmdif(
    f: Residual, x0: ArrayLike, *, ftol: float = math.sqrt(_EPS), xtol: float = math.sqrt(_EPS),
    gtol: float = 0.0, maxfev: int | None = None, epsfcn: float = _EPS, factor: float = 100.0,
    diag: ArrayLike | None = None,
) -> LmdifResult:  # fmt: skip
    """Minimise the sum of squares of ``f`` by the Levenberg–Marquardt algorithm.

    The Jacobian is estimated by forward differences. The algorithm, its tests of convergence
    and its status codes are those of MINPACK's subroutine of the same name [1]_, [2]_.

    Parameters
    ----------
    f
        ``f(x)`` with ``x`` of shape (n,) returns the residuals, finite, of shape (m,), m ≥ n.
    x0
        Shape ``(n,)``. The start.
    ftol
        Relative reduction of the sum of squares at which to stop, ≥ 0.
    xtol
        Relative change between two iterates at which to stop, ≥ 0.
    gtol
        Cosine of the angle between the residual and the columns of the Jacobian at which to
        stop, ≥ 0.
    maxfev
        Number of calls of ``f`` after which no further iteration starts, > 0; by default
        200 (n + 1).
    epsfcn
        Relative error of ``f``, ≥ 0, from which the steps of the differences are found; below
        the machine precision that is taken.
    factor
        The first step has at most the length ``factor * |diag * x0|``, > 0.
    diag
        Shape ``(n,)``. Positive scale factors of the unknowns; by default the largest norms so far
        of the columns of the Jacobian.

    Raises
    ------
    TypeError
        If an argument, or what ``f`` returns, isn't of a type listed here.
    ValueError
        If an argument is out of its range, or ``f`` returns an array that isn't finite, has
        another shape than at ``x0``, or has fewer elements than ``x0``, or varies so much that
        its differences overflow.
    BaseException
        Whatever ``f`` raises ends the call and is raised again.

    References
    ----------
    .. [1] J. J. Moré, B. S. Garbow, K. E. Hillstrom, User Guide for MINPACK-1,
       Argonne National Laboratory report ANL-80-74 (1980).
    .. [2] J. J. Moré, The Levenberg–Marquardt algorithm: implementation and theory,
       Lecture Notes in Mathematics 630 (1978) 105–116.

    Examples
    --------
    >>> from cg.construction.solvers.lmdif import lmdif
    >>> fit = lmdif(lambda x: [10 * (x[1] - x[0] ** 2), 1 - x[0]], [-1.2, 1.0])
    >>> fit.x
    array([1., 1.])
    >>> fit.info.name, fit.nfev
    ('SMALL_STEP', 54)
    """
    if not callable(f):
        raise TypeError(f"f must be callable, got {f!r}")
    start = _vector("x0", x0)
    n = start.size
    max_calls = 200 * (n + 1) if maxfev is None else check_integer("maxfev", maxfev, 1, MAX_COUNT)
    arguments = (
        np.zeros(n) if diag is None else _scale_factors(diag, n),
        check_real("ftol", ftol),
        check_real("xtol", xtol),
        check_real("gtol", gtol),
        max_calls,
        check_real("epsfcn", epsfcn),
        check_real("factor", factor, positive=True),
    )
    evaluate, rows = _callback(f, start)
    x, fvec, info, nfev, fjac, ipvt, qtf = _core_r64.lmdif_of_python(
        id(evaluate), rows, start, *arguments
    )
    if not np.isfinite(fjac).all():
        raise ValueError(f"f varies too much: its differences overflow near x = {x}")
    ipvt = ipvt.astype(np.intp) - 1
    for array in (x, fvec, fjac, ipvt, qtf):
        array.setflags(write=False)
    return LmdifResult(x, fvec, LmdifStatus(info), int(nfev), fjac, ipvt, qtf)


def fit_lmdif(
    order: int, layout: Layout, x: NDArray[Any], trees: Trees, tolerance: NDArray[Any], maxfev: int,
    stop_flag: StopFlag,
) -> tuple[Any, ...]:  # fmt: skip
    """Call the compiled lmdif; return x, f, info and nfev, in the kind of x.

    x has shape (n,), or (16, n) in real(16), `tolerance` (1,) or (16, 1). There are n trees or
    more.
    """
    m, n = trees.size, layout.size
    core, size = (_core_r64, 8) if x.ndim == 1 else (quads.core("lmdif in real(16)"), 16)
    needed = evaluation_bytes(order, layout, m, size) + size * (m * n + 6 * m + 16 * n)
    check_memory(needed, described("lmdif", order, layout))
    results: tuple[Any, ...] = core.fit_lmdif(
        order, layout.code, x, trees, tolerance, tolerance, maxfev, stop_flag
    )
    return results


def _callback(f: Residual, start: Vector) -> tuple[Callable[[int, Vector, Vector], Vector], int]:
    """Return the function that compiled code calls, and its number of rows."""
    residuals = _residuals(f, start, None)
    rows = residuals.size
    if rows < start.size:
        raise ValueError(
            f"f must return at least as many residuals as x0 has elements: "
            f"{rows} residuals, {start.size} unknowns"
        )
    at_start = [residuals]  # the solver's first call is there

    def evaluate(operation: int, x: Vector, _: Vector) -> Vector:
        return at_start.pop() if at_start else _residuals(f, x, rows)

    return evaluate, rows


def _residuals(f: Residual, x: Vector, rows: int | None) -> Vector:
    """Return a checked copy of ``f(x)``; `x` may be the solver's memory, so f gets a copy."""
    if not np.isfinite(x).all():
        raise ValueError(f"f varies too much: the next point would be x = {x}")
    values = _vector("f: the residuals", f(x.copy()))
    if rows is not None and values.size != rows:
        raise ValueError(f"f must return {rows} residuals as it did at x0, got {values.size}")
    return values


def _vector(name: str, value: ArrayLike) -> Vector:
    array = real_array(value, name)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} must have shape (n,) with n > 0, got shape {array.shape}")
    check_finite(name, array)
    return array


def _scale_factors(diag: ArrayLike, n: int) -> Vector:
    array = _vector("diag", diag)
    if array.size != n:
        raise ValueError(f"diag must have shape ({n},) as x0 has, got shape {array.shape}")
    if not (array > 0).all():
        raise ValueError(f"diag must be positive, got {diag!r}")
    return array
