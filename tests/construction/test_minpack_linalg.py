"""The linear algebra under lmdif, and the solver in either kind, by faces of their own."""

from __future__ import annotations

import ctypes
import math
import subprocess
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from minpack_libraries import (
    HAS_COMPILER,
    TESTS,
    Faces,
    compile_fortran,
    load_debian_minpack,
    pointer,
    reference,
)
from more_garbow_hillstrom import BARD
from numpy.testing import assert_allclose, assert_array_equal

pytestmark = pytest.mark.skipif(not HAS_COMPILER, reason="gfortran not found")
needs_minpack = pytest.mark.skipif(
    load_debian_minpack() is None, reason="libminpack (minpack-dev) not found"
)

EPS = float(np.finfo(float).eps)


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Faces:
    folder = tmp_path_factory.mktemp("faces")
    source = TESTS / "fortran" / "minpack_faces.f90"
    library = compile_fortran(folder, "r64", source, "faces.so", "-shared", "-fPIC")
    return Faces(ctypes.CDLL(str(library)))


@pytest.fixture(scope="module")
def minpack() -> ctypes.CDLL:
    library = load_debian_minpack()
    assert library is not None
    library.enorm_.restype = ctypes.c_double
    return library


def matrices() -> st.SearchStrategy[np.ndarray]:
    """Matrices with at least as many rows as columns; often singular, for the zeros in them."""
    entries = st.one_of(st.sampled_from([0.0, 1.0, -2.0]), st.floats(-1e3, 1e3, width=32))
    shapes = st.tuples(st.integers(1, 6), st.integers(0, 5)).map(lambda s: (s[0] + s[1], s[0]))
    return shapes.flatmap(lambda shape: arrays(np.float64, shape, elements=entries))


def seeds() -> st.SearchStrategy[np.random.Generator]:
    return st.integers(0, 2**32 - 1).map(np.random.default_rng)


def orthogonal_factor(factored: np.ndarray) -> np.ndarray:
    m, n = factored.shape
    q = np.eye(m)
    for j in range(n):
        u = np.zeros(m)
        u[j:] = factored[j:, j]
        if u[j] != 0:
            q -= np.outer(q @ u, u) / u[j]
    return q


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=8))
def test_norm_neither_overflows_nor_underflows(faces: Faces, fits: list[float]) -> None:
    norm = math.hypot(*fits)
    assume(math.isfinite(norm))
    x = np.array(fits, dtype=float)
    assert math.isclose(faces.enorm(x), norm, rel_tol=8 * EPS, abs_tol=1e-323)


@given(st.lists(st.floats(-1e10, 1e10), min_size=1, max_size=8), st.sampled_from([-0.0, 0.0]))
def test_norm_sees_no_zeros_and_no_signs(faces: Faces, fits: list[float], zero: float) -> None:
    x = np.array(fits)
    norm = faces.enorm(x)
    assert faces.enorm(-x) == norm
    assert math.isclose(faces.enorm(np.append(x, zero)), norm, rel_tol=4 * EPS)
    assert norm >= abs(x).max() * (1 - 4 * EPS)


def test_norm_sees_what_is_not_a_number(faces: Faces) -> None:
    assert math.isnan(faces.enorm(np.array([1.0, np.nan, 2.0])))


@given(matrices())
def test_qrfac_factors(faces: Faces, a: np.ndarray) -> None:
    m, n = a.shape
    factored, ipvt, rdiag, acnorm = faces.qrfac(a)
    r = np.triu(factored, 1)
    r[range(n), range(n)] = rdiag
    q = orthogonal_factor(factored)
    scale = abs(a).max() or 1.0
    assert sorted(ipvt) == list(range(n))
    assert_allclose(q.T @ q, np.eye(m), atol=1e-13)
    assert_allclose(q @ r, a[:, ipvt], atol=1e-13 * scale)
    assert_allclose(acnorm, np.linalg.norm(a, axis=0), rtol=1e-13)
    # Half of the digits of a column norm may be gone when the pivot is chosen by it.
    assert (np.diff(abs(rdiag)) <= 1e-6 * scale).all()


@given(seeds(), st.integers(1, 7), st.integers(0, 5))
def test_qrsolv_solves(faces: Faces, rng: np.random.Generator, n: int, extra: int) -> None:
    a, b = rng.normal(size=(n + extra, n)), rng.normal(size=n + extra)
    diag = rng.uniform(0.5, 2, n)
    factored, ipvt, rdiag, _ = faces.qrfac(a)
    r = np.triu(factored[:n], 1) + np.diag(rdiag)
    qtb = (orthogonal_factor(factored).T @ b)[:n]
    x, s = faces.qrsolv(r, ipvt, diag, qtb)
    stacked = np.vstack([a, np.diag(diag)])
    expected = np.linalg.lstsq(stacked, np.append(b, np.zeros(n)))[0]
    assert_allclose(x, expected, atol=1e-12)
    gram = (stacked.T @ stacked)[np.ix_(ipvt, ipvt)]
    assert_allclose(s.T @ s, gram, atol=1e-12 * abs(gram).max())


def test_qrsolv_puts_zeros_from_the_first_zero_of_s_on(faces: Faces) -> None:
    r = np.array([[2.0, 1.0, 1.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    x, _ = faces.qrsolv(r, np.array([2, 0, 1]), np.zeros(3), np.array([4.0, 5.0, 6.0]))
    assert_array_equal(x, [0.0, 0.0, 2.0])


@given(seeds(), st.integers(1, 7), st.floats(-3, 3))
def test_lmpar_meets_the_trust_region(
    faces: Faces, rng: np.random.Generator, n: int, size: float
) -> None:
    a, b = rng.normal(size=(n + 2, n)), rng.normal(size=n + 2)
    diag, delta = rng.uniform(0.5, 2, n), 10.0**size
    factored, ipvt, rdiag, _ = faces.qrfac(a)
    r = np.triu(factored[:n], 1) + np.diag(rdiag)
    qtb = (orthogonal_factor(factored).T @ b)[:n]
    x, par = faces.lmpar(r, ipvt, diag, qtb, delta)
    length = np.linalg.norm(diag * x)
    gram, gradient = a.T @ a + par * np.diag(diag**2), a.T @ b
    assert_allclose(gram @ x, gradient, atol=1e-11 * abs(gradient).max())
    if par == 0:
        assert length <= 1.1 * delta * (1 + 1e-12)
    else:
        assert par > 0
        assert abs(length - delta) <= 0.1 * delta * (1 + 1e-12)


def test_lmpar_on_a_singular_jacobian(faces: Faces) -> None:
    r = np.array([[2.0, 1.0], [0.0, 0.0]])
    x, par = faces.lmpar(r, np.array([0, 1]), np.ones(2), np.array([4.0, 0.0]), 0.5)
    assert par > 0
    assert abs(np.linalg.norm(x) - 0.5) <= 0.05


@needs_minpack
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=8))
def test_norm_is_that_of_minpack(faces: Faces, minpack: ctypes.CDLL, fits: list[float]) -> None:
    x = np.array(fits)
    assert faces.enorm(x) == minpack.enorm_(reference(x.size), pointer(x))


@needs_minpack
@given(matrices(), seeds(), st.floats(-3, 3))
def test_linear_algebra_is_that_of_minpack(
    faces: Faces, minpack: ctypes.CDLL, a: np.ndarray, rng: np.random.Generator, size: float
) -> None:
    m, n = a.shape
    theirs = np.array(a, order="F")
    ipvt, rdiag, acnorm = np.empty(n, np.intc), np.empty(n), np.empty(n)
    work, other = np.empty(n), np.empty(n)
    minpack.qrfac_(
        *(reference(m), reference(n), pointer(theirs), reference(m), reference(1)),
        *(pointer(ipvt), reference(n), pointer(rdiag), pointer(acnorm), pointer(work)),
    )
    ours = faces.qrfac(a)
    for mine, expected in zip(ours, (theirs, ipvt - 1, rdiag, acnorm), strict=True):
        assert_array_equal(mine, expected)

    r = np.array(np.triu(theirs[:n], 1) + np.diag(rdiag), order="F")
    diag, qtb, delta = rng.uniform(0.5, 2, n), rng.normal(size=n), 10.0**size
    x, sdiag, par = np.empty(n), np.empty(n), ctypes.c_double(0)
    minpack.lmpar_(
        *(reference(n), pointer(r.copy(order="F")), reference(n), pointer(ipvt), pointer(diag)),
        *(pointer(qtb), reference(delta), ctypes.byref(par), pointer(x), pointer(sdiag)),
        *(pointer(work), pointer(other)),
    )
    my_x, my_par = faces.lmpar(r, ipvt - 1, diag, qtb, delta)
    assert_array_equal(my_x, x)
    assert my_par == par.value


@dataclass(frozen=True)
class Outcome:
    info: int
    nfev: int
    norm: Fraction
    x: tuple[Fraction, ...]


@pytest.fixture(scope="module", params=["r64", "r128"])
def outcomes(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[float, dict[str, Outcome]]:
    """Machine precision of the kind, and what its program printed, by problem."""
    folder: Path = tmp_path_factory.mktemp(request.param)
    source = TESTS / "fortran" / "solve_both_kinds.f90"
    program = compile_fortran(folder, request.param, source, "solve")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    fits = {}
    for line in done.stdout.splitlines():
        name, info, nfev, norm, *x = line.split()
        fits[name] = Outcome(int(info), int(nfev), Fraction(norm), tuple(map(Fraction, x)))
    return {"r64": 2.0**-52, "r128": 2.0**-112}[request.param], fits


def test_zero_residuals_are_found_to_the_precision_of_the_kind(
    outcomes: tuple[float, dict[str, Outcome]],
) -> None:
    eps, fits = outcomes
    for name in ("rosenbrock", "helical-valley"):
        assert fits[name].info in (2, 4)
        assert fits[name].norm < 10 * eps
    assert max(abs(x - 1) for x in fits["rosenbrock"].x) < 10 * eps


def test_minimum_is_found_to_the_precision_of_the_differences(
    outcomes: tuple[float, dict[str, Outcome]],
) -> None:
    # The residuals are rational: their gradient where the solver stopped is computed exactly.
    eps, fits = outcomes
    x = fits["bard"].x
    gradient = [Fraction(0)] * 3
    square = Fraction(0)
    for u, datum in enumerate(BARD, start=1):
        v = 16 - u
        w = min(u, v)
        bottom = x[1] * v + x[2] * w
        f = Fraction(str(datum)) - (x[0] + u / bottom)
        square += f * f
        for j, slope in enumerate((-1, u * v / bottom**2, u * w / bottom**2)):
            gradient[j] += f * slope
    assert fits["bard"].info in (1, 2, 3)
    assert max(map(abs, gradient)) < 10 * math.sqrt(eps)
    assert abs(fits["bard"].norm ** 2 - square) < 10 * eps


def test_norms_at_the_ends_of_the_range(outcomes: tuple[float, dict[str, Outcome]]) -> None:
    eps, fits = outcomes
    for name in ("norm-large", "norm-small", "norm-mixed"):
        assert abs(fits[name].norm ** 2 - 2) < 10 * eps
    assert fits["norm-of-none"].norm == 0


def test_too_few_residuals_are_refused(outcomes: tuple[float, dict[str, Outcome]]) -> None:
    refused = outcomes[1]["too-few-residuals"]
    assert (refused.info, refused.nfev) == (0, 0)


@pytest.mark.parametrize(
    ("name", "info", "nfev"),
    [
        ("stops-at-once", -7, 1),
        ("stops-in-differences", -7, 3),
        ("stops-at-trial", -7, 4),
    ],
)
def test_a_negative_flag_stops_the_solver(
    outcomes: tuple[float, dict[str, Outcome]], name: str, info: int, nfev: int
) -> None:
    stopped = outcomes[1][name]
    assert (stopped.info, stopped.nfev) == (info, nfev)
    assert stopped.x == (5, 5)
