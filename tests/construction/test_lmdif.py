"""lmdif against SciPy's and Debian's MINPACK on the problems of Moré, Garbow and Hillstrom."""

import ctypes
import ctypes.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from refusals import refuses
from scipy.optimize import leastsq

import cg
from cg import conditions
from cg.construction.layouts import Layout
from cg.construction.search import start as random_start
from cg.construction.search.shapes import start_generator
from cg.support import quads

pytestmark = pytest.mark.sanitize

Vector = NDArray[np.float64]
Residual = Callable[[Vector], Vector]


@dataclass(frozen=True)
class Problem:
    """One problem: m residuals of n unknowns.

    Sums are written out rather than left to BLAS, whose order of summation
    depends on the processor: a last digit can change a solver's path.
    """

    name: str
    m: int
    residual: Residual
    standard_start: tuple[float, ...]

    @property
    def n(self):
        return len(self.standard_start)

    def start(self, factor):
        """The standard start times `factor`; a zero start moves to `factor` itself."""
        start = np.array(self.standard_start)
        if factor != 1 and not start.any():
            return np.full(self.n, float(factor))
        return factor * start


def linear_rank_one(x, m):
    return np.arange(1, m + 1) * (np.arange(1, x.size + 1) * x).sum() - 1


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


BARD = np.array(
    [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39]
)


def bard(x):
    u = np.arange(1.0, 16.0)
    v = 16 - u
    return BARD - (x[0] + u / (x[1] * v + x[2] * np.minimum(u, v)))


KOWALIK_OSBORNE_INVERSE_DOSE = np.array(
    [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]
)
KOWALIK_OSBORNE = np.array(
    [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
)


def kowalik_osborne(x):
    v = KOWALIK_OSBORNE_INVERSE_DOSE
    return KOWALIK_OSBORNE - x[0] * v * (v + x[1]) / (v * (v + x[2]) + x[3])


def brown_dennis(x, m):
    t = np.arange(1, m + 1) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + np.sin(t) * x[3] - np.cos(t)) ** 2


def chebyquad(x, m):
    """Means of the shifted Chebyshev polynomials minus their integrals over [0, 1]."""
    f = np.empty(m)
    shifted = 2 * x - 1
    previous, current = np.ones_like(x), shifted
    for i in range(1, m + 1):
        f[i - 1] = current.mean() + (1 / (i**2 - 1) if i % 2 == 0 else 0.0)
        previous, current = current, 2 * shifted * current - previous
    return f


OSBORNE_1 = np.array([
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751,
    0.718, 0.685, 0.658, 0.628, 0.603, 0.580, 0.558, 0.538, 0.522, 0.506, 0.490,
    0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420, 0.414, 0.411, 0.406,
])  # fmt: skip


def osborne_1(x):
    t = 10.0 * np.arange(33)
    return OSBORNE_1 - (x[0] + x[1] * np.exp(-x[3] * t) + x[2] * np.exp(-x[4] * t))


def _with_rows(name, m, function, start):
    return Problem(name, m, partial(function, m=m), start)


def _chebyquad(n):
    start = tuple(float(v) for v in np.arange(1, n + 1) / (n + 1))
    return _with_rows(f"chebyquad-{n}", max(n, 8), chebyquad, start)


ONES = (1.0,) * 5

PROBLEMS = (
    _with_rows("linear-rank-one", 50, linear_rank_one, ONES),
    Problem("rosenbrock", 2, rosenbrock, (-1.2, 1.0)),
    Problem("bard", 15, bard, (1.0, 1.0, 1.0)),
    Problem("kowalik-osborne", 11, kowalik_osborne, (0.25, 0.39, 0.415, 0.39)),
    _with_rows("brown-dennis", 20, brown_dennis, (25.0, 5.0, -5.0, -1.0)),
    *map(_chebyquad, (1, 8, 10)),
    Problem("osborne-1", 33, osborne_1, (0.5, 1.5, -1.0, 0.01, 0.02)),
)


EPS = float(np.finfo(float).eps)
DEBIANS_EPS = 2.22044604926e-16  # its dpmpar(1): the machine precision rounded to twelve digits
MINPACK = ctypes.util.find_library("minpack")
C_DOUBLES = ctypes.POINTER(ctypes.c_double)
C_INTS = ctypes.POINTER(ctypes.c_int)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
CASES = [(problem.name, factor) for problem in PROBLEMS for factor in (1, 10, 100)]
SOME = ("rosenbrock", "bard", "kowalik-osborne", "osborne-1", "brown-dennis", "chebyquad-8")

# On the way the residual overflows. leastsq goes on with infinities; lmdif stops and says so.
OVERFLOWS = {("osborne-1", 100)}


class Recorded:
    """A residual that records its arguments and values."""

    def __init__(self, problem):
        self._residual = problem.residual
        self.points = []
        self.values = []

    def __call__(self, x):
        with np.errstate(over="ignore", invalid="ignore"):
            value = self._residual(x)
        self.points.append(x.copy())
        self.values.append(value.copy())
        return value


def scipy_solve(problem, start, **options):
    """Return leastsq's result and its evaluations, without those before the solver starts."""
    residual = Recorded(problem)
    with np.errstate(all="ignore"):
        answer = leastsq(residual, start, full_output=True, **options)
    extra = len(residual.points) - answer[2]["nfev"]
    residual.points, residual.values = residual.points[extra:], residual.values[extra:]
    return residual, answer


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("options", [
    {}, {"ftol": 0.0, "xtol": 0.0}, {"ftol": 0.0, "xtol": 0.0, "gtol": 1e-3},
    {"ftol": 1e-3, "xtol": 1e-3}, {"ftol": 1e-4, "xtol": 0.0}, {"ftol": 0.0, "xtol": 1e-3},
    {"maxfev": 20}, {"factor": 0.1}, {"epsfcn": 1e-10}, {"diag": True},
], ids=str)  # fmt: skip
def test_iterates_equal_scipy_with_options(name, options):
    problem = BY_NAME[name]
    if "diag" in options:
        options = {"diag": 0.5 + np.arange(problem.n)}
    defaults = {"ftol": EPS**0.5, "xtol": EPS**0.5, "epsfcn": EPS}
    _, (x, _, details, _, info) = scipy_solve(problem, problem.start(1), **{**defaults, **options})
    fit = cg.lmdif(problem.residual, problem.start(1), **options)
    assert (fit.info, fit.nfev) == (info, details["nfev"])
    assert fit.success is (info < 5)
    assert_allclose(fit.x, x, rtol=1e-12)


def test_pivots_where_norms_cancel():
    """Of columns that differ by 1e-9 from the first, of which the second differs by more."""
    # those of SciPy 1.17 vary from call to call
    matrix = np.array([[2.0, 1.0, 1.0], [0.0, 3e-9, 0.0], [0.0, 0.0, 2e-9], [0.0, 0.0, 0.0]])
    f = lambda x: matrix @ x - [1.0, 0.0, 0.0, 4.0]
    assert cg.lmdif(f, np.zeros(3), maxfev=8).ipvt.tolist() == [0, 1, 2]


def debians_lmdif(f, x0, m):
    """Return the results of MINPACK's subroutine as Debian compiles it, with our defaults."""
    n = x0.size
    x, fvec, fjac = x0.copy(), np.empty(m), np.empty((m, n), order="F")
    diag, qtf, ipvt = np.ones(n), np.empty(n), np.empty(n, np.intc)
    work = [np.empty(n), np.empty(n), np.empty(n), np.empty(m)]
    info, nfev = ctypes.c_int(), ctypes.c_int()

    def reference(value):
        return ctypes.byref((ctypes.c_int if isinstance(value, int) else ctypes.c_double)(value))

    def pointer(array):
        return array.ctypes.data_as(ctypes.c_void_p)

    def callback(_m, _n, x_in, f_out, _flag):
        at = np.ctypeslib.as_array(x_in, (n,)).copy()
        np.ctypeslib.as_array(f_out, (m,))[:] = f(at)

    signature = ctypes.CFUNCTYPE(None, C_INTS, C_INTS, C_DOUBLES, C_DOUBLES, C_INTS)
    ctypes.CDLL(MINPACK).lmdif_(
        signature(callback), reference(m), reference(n), pointer(x), pointer(fvec),
        *map(reference, (EPS**0.5, EPS**0.5, 0.0, 200 * (n + 1), DEBIANS_EPS)), pointer(diag),
        *map(reference, (1, 100.0, 0)), ctypes.byref(info), ctypes.byref(nfev),
        pointer(fjac), reference(m), pointer(ipvt), pointer(qtf), *map(pointer, work),
    )  # fmt: skip
    return {"info": info.value, "nfev": nfev.value}, {
        "x": x, "fvec": fvec, "fjac": fjac, "ipvt": ipvt - 1, "qtf": qtf
    }  # fmt: skip


@pytest.mark.skipif(MINPACK is None, reason="libminpack (minpack-dev) not found")
@pytest.mark.parametrize(("name", "factor"), CASES)
def test_iterates_equal_minpack_bitwise(name, factor):
    # epsfcn as Debian's idea of the machine precision, or its differences have other steps.
    problem = BY_NAME[name]
    run = Recorded(problem)
    counts, arrays = debians_lmdif(run, problem.start(factor), problem.m)
    if (name, factor) in OVERFLOWS:
        # MINPACK goes on with infinities: its path is ours up to the first of them
        ours = Recorded(problem)
        with pytest.raises(ValueError, match="the residuals must be finite"):
            cg.lmdif(ours, problem.start(factor), epsfcn=DEBIANS_EPS)
        first = next(k for k, value in enumerate(run.values) if not np.isfinite(value).all())
        assert first > problem.n
        assert_array_equal(ours.points, run.points[: first + 1])
        assert_array_equal(ours.values, run.values[: first + 1])
        return
    fit = cg.lmdif(problem.residual, problem.start(factor), epsfcn=DEBIANS_EPS)
    assert {key: getattr(fit, key) for key in counts} == counts
    for key, theirs in arrays.items():
        assert_array_equal(getattr(fit, key), theirs, err_msg=key)


def test_tolerances_of_the_papers_search(monkeypatch):
    given = []
    fit_lmdif = random_start.fit_lmdif

    def recorded(order, layout, x, trees, tolerance, *rest):
        given.append(tolerance)
        return fit_lmdif(order, layout, x, trees, tolerance, *rest)

    monkeypatch.setattr(random_start, "fit_lmdif", recorded)
    result = cg.search(3, 3, 3, seed=0, algorithm="lmdif", workers=1, refine_below=1.0)
    assert any(start.quad is not None for start in result.starts)
    doubles = [tolerance for tolerance in given if tolerance.dtype == np.float64]
    others = [tolerance for tolerance in given if tolerance.dtype != np.float64]
    assert len(doubles) == 3
    assert others
    assert {float(tolerance[0]) for tolerance in doubles} == {1e-18}
    assert {quads.to_float(tolerance.T)[0] for tolerance in others} == {1e-32}


def test_search_status_is_that_of_solver():
    settings = cg.search(3, 3, 6, seed=0, algorithm="lmdif").settings
    layout = Layout.tableau(3)
    table = np.array(conditions.table_rows(3))
    assert len(table) >= layout.size

    def residual(x):
        return np.where(table, conditions.residuals(layout, x, 3), 0)

    for index in range(6):
        guess = start_generator(0, index).uniform(-settings.width, settings.width, layout.size)
        fit = cg.lmdif(residual, guess, ftol=1e-18, xtol=1e-18, maxfev=settings.maxfev)
        start = random_start.run_start(settings, index)
        assert (start.double.info, start.double.nfev) == (fit.info, fit.nfev)
        assert_array_equal(start.double.f, fit.fvec @ fit.fvec)


def at_call(number, then):
    """Return Rosenbrock's function, which returns `then` at the given call."""
    calls = 0

    def f(x):
        nonlocal calls
        calls += 1
        return then(x) if calls == number else rosenbrock(x)

    return f


# Calls 2 and 3 are differences, call 4 is the first step.
@pytest.mark.parametrize("call", [1, 2, 3, 4, 20])
@pytest.mark.parametrize(("returned", "message"), [
    (None, r"be an array of real numbers, got None"),
    ([1j, 2j], "be an array of real numbers"),
    (3.0, r"have shape \(n,\) with n > 0, got shape \(\)"),
    (np.ones((2, 1)), r"have shape .* got shape \(2, 1\)"),
    ([[1.0], [1.0, 2.0]], "be an array"),
    ([1.0, np.nan], r"be finite, got nan at \[1\]"),
    ([-np.inf, 1.0], r"be finite, got -inf at \[0\]"),
])  # fmt: skip
def test_rejects_bad_residuals(call, returned, message):
    message = f"^f: the residuals must {message}"
    refuses(ValueError, message, cg.lmdif, at_call(call, lambda x: returned), [-1.2, 1.0])


@pytest.mark.parametrize("call", [2, 4])
@pytest.mark.parametrize("size", [1, 3])
def test_rejects_changing_number_of_residuals(call, size):
    with pytest.raises(ValueError, match=f"f must return 2 residuals as it did at x0, got {size}"):
        cg.lmdif(at_call(call, lambda x: np.ones(size)), [-1.2, 1.0])


class Interrupted(BaseException):
    pass


def test_exception_passes_through_nested_calls():
    error = Interrupted()

    def inner(y):
        raise error

    outer = lambda x: cg.lmdif(inner, x).x
    with pytest.raises(Interrupted) as caught:
        cg.lmdif(at_call(4, outer), [-1.2, 1.0])
    assert caught.value is error
    assert cg.lmdif(rosenbrock, [-1.2, 1.0]).nfev == 54
