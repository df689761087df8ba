"""Ensembles on executors: each member is the same on every executor."""

import ctypes
import math
import pickle
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from refusals import refuses
from threadpoolctl import threadpool_info, threadpool_limits

import cg
from cg.construction import catalogue
from cg.frames import SO3, Euclidean
from cg.integration import ensemble
from cg.tables import stored_table

pytestmark = pytest.mark.sanitize

FRAME = SO3()
TIMES = [0.0, 0.3, 1.0]
RATES = np.random.default_rng(3).uniform(0.5, 2.0, (10, 2))
POINTS = FRAME.random_point(np.random.default_rng(4), 10)


@pytest.fixture
def library_path(compiled_library):
    """Return the path of the library of right-hand sides."""
    return compiled_library._name


def field(t, y):
    return np.stack([y[..., 0, 0], np.cos(t) * y[..., 1, 1], 0.5 + 0 * y[..., 0, 0]], axis=-1)


@pytest.mark.filterwarnings("ignore:Failure of")
def test_all_members_that_fail_are_named(library_path):
    f = cg.CompiledFunction(library_path, "limited")
    y0 = FRAME.random_point(np.random.default_rng(4), (40,))
    rates = np.full((40, 2), 200.0)
    rates[::3] = 1.0
    options = {"frame": FRAME, "t_eval": TIMES, "parameters": rates, "rtol": 1e-6}
    whole = cg.solve_ensemble(f, (0, 1), y0, **options)
    for workers in (1, 2):
        apart = cg.solve_ensemble(f, (0, 1), y0, **options, workers=workers)
        assert list(apart.messages) == [k for k in range(40) if k % 3]
        assert (apart.messages, apart.message) == (whole.messages, whole.message)
        np.testing.assert_array_equal(apart.status, whole.status)
        np.testing.assert_array_equal(apart.y, whole.y)


def test_zarr_and_hdf5(library_path, tmp_path):
    zarr, h5py = pytest.importorskip("zarr"), pytest.importorskip("h5py")
    f = cg.CompiledFunction(library_path, "limited", [1.0, 2.0])
    y0 = POINTS
    whole = cg.solve_ensemble(f, (0, 1), y0, frame=FRAME, t_eval=TIMES)
    options = {"frame": FRAME, "t_eval": TIMES, "workers": 2}
    array = zarr.open(str(tmp_path / "y.zarr"), mode="w", shape=(3, 10, 3, 3), dtype="f8")
    cg.solve_ensemble(f, (0, 1), y0, **options, out=array)
    np.testing.assert_array_equal(array[:], whole.y)
    with h5py.File(tmp_path / "y.h5", "w") as file:
        data = file.create_dataset("y", (3, 10, 3, 3), dtype="f8")
        cg.solve_ensemble(f, (0, 1), y0, **options, out=data)
        np.testing.assert_array_equal(data[:], whole.y)


def test_methods_of_the_package_travel_by_name(monkeypatch):
    """Thus data that are cached for a method are computed once per process."""
    known, complete = [], ensemble.completed

    def noted(work, items, *args):
        known.append(next(items)[1])
        return complete(work, items, *args)

    monkeypatch.setattr(ensemble, "completed", noted)
    pair = cg.methods["CF4(3)"]
    renamed = catalogue.loads(catalogue.dumps(pair).replace("CF4(3)", "Mine", 1))
    for method in ("CF4(3)", pair, "RKMK5(4)", renamed):
        cg.solve_ensemble(field, (0, 0.1), POINTS, frame=FRAME, method=method, workers=2)
    again = [pickle.loads(pickle.dumps(part)).plan.table for part in known]
    assert again[0] is again[1] is stored_table(pair.name)
    assert again[2] is known[2].plan.table
    assert again[3].method == renamed


def test_pointers_do_not_travel(library_path):
    pointer = ctypes.CDLL(library_path).limited
    doubles = ctypes.POINTER(ctypes.c_double)
    pointer.argtypes = [ctypes.c_double, doubles, doubles, ctypes.c_void_p]
    pointer.restype = ctypes.c_int
    message = "f must be picklable .*; a cg.CompiledFunction or"
    refuses(ValueError, message, in_processes, pointer, parameters=RATES)


def in_processes(f, executor="processes", **options):
    """Integrate in other processes."""
    return cg.solve_ensemble(f, (0, 1), POINTS, frame=FRAME, executor=executor, **options)


@pytest.mark.parametrize(("name", "options"), [
    ("args", {}), ("events", {}), ("observe", {}), ("jac", {"method": "RadauIIA5"}),
    ("noise", {"derivatives": "forward"}), ("df_dp", {"derivatives": "forward"}),
])  # fmt: skip
def test_functions_that_cannot_be_pickled_are_named_before_any_call(name, options):
    def local(*arguments):
        raise AssertionError

    options = options | {name: (local,) if name == "args" else local}
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        for executor in ("processes", pool):
            refuses(ValueError, "f must be picklable", in_processes, local, executor)
            refuses(ValueError, f"{name} must be pickl", in_processes, field, executor, **options)


def driven(t, y, u):
    return u * field(t, y)


def test_a_pool_takes_derivatives_of_members_with_inputs_of_their_own():
    """Parts get the options of derivatives alone, not the pool, nor what reports progress."""
    curves = [cg.Samples([0.0, 0.3 + 0.05 * k, 1.0], [1.0, 0.5, k], "linear") for k in range(10)]
    options = {"inputs": curves, "derivatives": "forward", "P0": np.eye(3), "t_eval": TIMES}
    done = []
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        apart = in_processes(driven, pool, progress=lambda *now: done.append(now), **options)
    whole = in_processes(driven, None, **options)
    assert done[-1] == (10.0, 10.0)
    for name in ("y", "transition", "covariance"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(whole, name))


LINE = Euclidean(1)


def steady(t, y):
    return np.ones_like(y)


def at_one(t, y):
    return y[0] - 1.0


at_one.terminal = True


class TestOut:
    OPTIONS = {"frame": LINE, "events": at_one, "h": 0.25, "method": "CG3"}  # noqa: RUF012

    @pytest.mark.parametrize("y0", [[-5.0, 0.0, 0.5], [0.0, 0.5, -5.0]])
    @pytest.mark.parametrize("kind", [np.float64, np.float32, np.complex128])
    def test_out_has_the_values_returned_without_it(self, y0, kind):
        y0 = np.array(y0)[:, None]
        times = [0.0, 0.25, 0.75, 2.0]
        without = cg.solve_ensemble(steady, (0, 2), y0, t_eval=times, workers=1, **self.OPTIONS)
        out = np.full((4, 3, 1), 777.0, dtype=kind)
        run = cg.solve_ensemble(steady, (0, 2), y0, t_eval=times, out=out, **self.OPTIONS)
        assert run.y is out
        np.testing.assert_array_equal(out, without.y.astype(kind))

    @pytest.mark.parametrize(("out", "error", "message"), [
        ([1], TypeError, r"out must be an array, such as one of .*, got \[1\]"),
        (np.zeros((2, 2, 1), dtype=int), ValueError, "hold numbers of type float64, got"),
        (np.zeros((2, 2, 1), dtype="S3"), ValueError, "hold numbers of type float64, got"),
        (np.zeros((3, 2, 1)), ValueError, r"out must have shape \(2, 2, 1\), got \(3, 2, 1\)"),
        (np.broadcast_to(0.0, (2, 2, 1)), ValueError, "out must be writable, got ndarray"),
    ])  # fmt: skip
    def test_rejected_before_any_call(self, out, error, message):
        def never(t, y):
            raise AssertionError

        with pytest.raises(error, match=message):
            cg.solve_ensemble(never, (0, 1), np.zeros((2, 1)), frame=LINE, out=out)


@pytest.mark.parametrize("workers", [None, 2])
def test_blas_has_one_thread(workers):
    """So that workers change no bit where ``f`` calls it."""
    counts = set()

    def f(t, y):
        counts.update(library["num_threads"] for library in threadpool_info())
        return [0.0]

    with threadpool_limits(2):
        cg.solve_ensemble(f, (0, 1), np.zeros((2, 1)), frame=LINE, h=1.0, workers=workers)
    assert counts == {1}


class TestCompiledFunction:
    def test_it_travels(self, library_path):
        f = cg.CompiledFunction(library_path, "limited", [1.0, math.pi])
        again = pickle.loads(pickle.dumps(f))
        assert (
            repr(again)
            == repr(f)
            == f"CompiledFunction({library_path!r}, 'limited', [1.0, {math.pi}])"
        )
        one, two = (cg.solve_ivp(g, (0, 1), np.eye(3), frame=FRAME).y[-1] for g in (f, again))
        np.testing.assert_array_equal(one, two)

    @pytest.mark.parametrize(("arguments", "error", "message"), [
        ((3, "rhs"), TypeError, "path must be a path, got 3"),
        (("/none.so", "rhs"), ValueError, "path must be a shared library, got '/none.so'"),
        (("LIBRARY", 3), TypeError, "symbol must be a string, got 3"),
        (("LIBRARY", "lhs"), ValueError, "symbol must be a function of .*, got 'lhs'"),
        (("LIBRARY", "limited", "x"), ValueError, "user_data must be an array of real numbers"),
    ])  # fmt: skip
    def test_arguments(self, library_path, arguments, error, message):
        arguments = tuple(library_path if each == "LIBRARY" else each for each in arguments)
        refuses(error, message, cg.CompiledFunction, *arguments)


@pytest.mark.parametrize("members", [6, 40])
def test_batches_of_vectorized_members_do_not_depend_on_time(members):
    """Each batch is a call of all stages; slow calls would make smaller chunks."""

    def calls(seconds):
        sizes = []

        def f(t, y):
            time.sleep(seconds)
            sizes.append(len(t))
            return -y

        points = np.ones((members, 1))
        options = {"frame": Euclidean(1), "h": 0.5, "method": "CF4"}
        cg.solve_ensemble(f, (0, 1), points, vectorized=True, workers=2, **options)
        return sorted(sizes)

    assert calls(0.0) == calls(0.001)
    assert calls(0.0)[-1] == -(-members // 8)
