"""Ensembles on executors: every member by itself, the same wherever it runs."""

import ctypes
import math
import pickle
import subprocess
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import cg
from cg.frames import SO3
from cg.integration import members

FRAME = SO3()
SOURCE = """
int rhs(double t, const double *y, double *f, void *user_data)
{
    const double *rate = user_data;
    if (rate[0] > 100.0 && t > 0.5)
        return 3;
    f[0] = rate[0];
    f[1] = y[0] - t;
    f[2] = rate[1] * y[4];
    return 0;
}
"""
TIMES = [0.0, 0.3, 1.0]
RATES = np.random.default_rng(3).uniform(0.5, 2.0, (2, 5, 2))
POINTS = FRAME.random_point(np.random.default_rng(4), (2, 5))


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compiled")
    (folder / "rhs.c").write_text(SOURCE)
    built = folder / "librhs.so"
    command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(built), str(folder / "rhs.c")]
    subprocess.run(command, check=True)
    return built


def field(t, y):
    return np.stack([y[..., 0, 0], np.cos(t) * y[..., 1, 1], 0.5 + 0 * y[..., 0, 0]], axis=-1)


def turned(t, y):
    return y[0, 0]


def diverging(t, y):
    if t > 0.5:
        raise ArithmeticError("too late")
    return field(t, y)


turned.terminal = True


def processes():
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


@pytest.mark.parametrize("step", [{"rtol": 1e-7}, {"h": 0.1}])
@pytest.mark.parametrize("method", ["auto", "CF4(3)"])
def test_compiled_members_are_those_of_the_whole(library, step, method):
    f = cg.CompiledFunction(library, "rhs")
    options = {"frame": FRAME, "parameters": RATES, "t_eval": TIMES, "method": method, **step}
    whole = cg.solve_ivp(f, (0, 1), POINTS, **options)
    for change in ({"workers": 1}, {"workers": 2}, {"executor": ThreadPoolExecutor(3)}):
        apart = cg.solve_ivp(f, (0, 1), POINTS, **options, **change)
        np.testing.assert_array_equal(apart.y, whole.y)
        np.testing.assert_array_equal(apart.t, whole.t)
        assert (apart.status, apart.message) == (whole.status, whole.message)
        if "rtol" in step:
            assert (apart.steps, apart.nfev, apart.nexp) == (whole.steps, whole.nfev, whole.nexp)
        assert not apart.y.flags.writeable


def test_processes_are_told_of_everything(library):
    f = cg.CompiledFunction(library, "rhs")
    options = {"frame": FRAME, "t_eval": TIMES, "rtol": 1e-6}
    with processes() as pool:
        apart = cg.solve_ivp(f, (0, 1), POINTS, **options, parameters=RATES, executor=pool)
        python = cg.solve_ivp(field, (0, 1), POINTS, **options, events=turned, executor=pool)
    whole = cg.solve_ivp(f, (0, 1), POINTS, **options, parameters=RATES)
    np.testing.assert_array_equal(apart.y, whole.y)
    for member in np.ndindex(2, 5):
        alone = cg.solve_ivp(field, (0, 1), POINTS[member], **options, events=turned)
        np.testing.assert_array_equal(python.y[: len(alone.t), *member], alone.y)
        assert np.isnan(python.y[len(alone.t) :, *member]).all()
        np.testing.assert_array_equal(python.t_events[0][member], alone.t_events[0])
        np.testing.assert_array_equal(python.y_events[0][member], alone.y_events[0])


@pytest.mark.parametrize("step", [{"rtol": 1e-6}, {"h": 0.25}])
def test_python_members_are_those_alone(step):
    apart = cg.solve_ivp(field, (0, -1), POINTS, frame=FRAME, **step, workers=2)
    assert apart.t[0] == 0
    assert apart.t[-1] == -1
    total = 0
    for member in np.ndindex(2, 5):
        alone = cg.solve_ivp(field, (0, -1), POINTS[member], frame=FRAME, **step)
        np.testing.assert_array_equal(apart.y[-1, *member], alone.y[-1])
        total += alone.nfev
    assert apart.y.shape == ((5 if "h" in step else 2), 2, 5, 3, 3)
    assert apart.nfev >= total  # output at the end takes its own in adaptive steps
    assert apart.success


def test_members_that_fail_are_named(library):
    f = cg.CompiledFunction(library, "rhs")
    rates = RATES.copy()
    rates[1, 2, 0] = 200.0
    options = {"frame": FRAME, "t_eval": TIMES, "parameters": rates, "rtol": 1e-6}
    whole = cg.solve_ivp(f, (0, 1), POINTS, **options)
    apart = cg.solve_ivp(f, (0, 1), POINTS, **options, workers=2)
    assert apart.status == -1
    assert apart.failures == whole.failures
    assert list(apart.failures) == [(1, 2)]
    assert apart.message == whole.message
    np.testing.assert_array_equal(apart.y, whole.y)


def test_all_members_that_fail_are_named(library):
    f = cg.CompiledFunction(library, "rhs")
    y0 = FRAME.random_point(np.random.default_rng(4), (40,))
    rates = np.full((40, 2), 200.0)
    rates[::3] = 1.0
    options = {"frame": FRAME, "t_eval": TIMES, "parameters": rates, "rtol": 1e-6}
    apart = cg.solve_ivp(f, (0, 1), y0, **options, workers=1)
    assert list(apart.failures) == [(k,) for k in range(40) if k % 3]


def test_an_exception_of_f_ends_the_call():
    with pytest.raises(ArithmeticError, match="too late"):
        cg.solve_ivp(diverging, (0, 1), POINTS, frame=FRAME, workers=2)


def test_a_worker_that_dies(monkeypatch, library):
    def ended(work, indices, total, workers, executor, *, data):
        for k in indices:
            if k == 3:
                yield members_finished(k, None, "Killed")
            else:
                yield members_finished(k, work(data([k])), None)

    def members_finished(k, result, failure):
        from cg.runs import Finished

        return Finished(k, result, 0.0, failure, [k])

    monkeypatch.setattr(members, "completed", ended)
    apart = cg.solve_ivp(field, (0, 1), POINTS, frame=FRAME, workers=1)
    assert apart.failures == {(0, 3): "Killed"}
    assert np.isnan(apart.y[:, 0, 3]).all()
    assert np.isfinite(apart.y[:, 0, 2]).all()


def test_results_go_to_an_array_on_disk(library, tmp_path):
    f = cg.CompiledFunction(library, "rhs", [1.0, 2.0])
    y0 = POINTS.reshape(10, 3, 3)
    options = {"frame": FRAME, "t_eval": TIMES, "workers": 2}
    out = np.lib.format.open_memmap(tmp_path / "y.npy", "w+", float, (3, 10, 3, 3))
    found = cg.solve_ivp(f, (0, 1), y0, **options, out=out)
    assert found.y is out
    out.flush()
    whole = cg.solve_ivp(f, (0, 1), y0, frame=FRAME, t_eval=TIMES)
    np.testing.assert_array_equal(np.load(tmp_path / "y.npy"), whole.y)
    with pytest.raises(
        ValueError, match=r"out must have shape \(3, 10, 3, 3\), got \(3, 9, 3, 3\)"
    ):
        cg.solve_ivp(f, (0, 1), y0, **options, out=np.empty((3, 9, 3, 3)))


def test_zarr_and_hdf5(library, tmp_path):
    zarr, h5py = pytest.importorskip("zarr"), pytest.importorskip("h5py")
    f = cg.CompiledFunction(library, "rhs", [1.0, 2.0])
    y0 = POINTS.reshape(10, 3, 3)
    whole = cg.solve_ivp(f, (0, 1), y0, frame=FRAME, t_eval=TIMES)
    options = {"frame": FRAME, "t_eval": TIMES, "workers": 2}
    array = zarr.open(str(tmp_path / "y.zarr"), mode="w", shape=(3, 10, 3, 3), dtype="f8")
    cg.solve_ivp(f, (0, 1), y0, **options, out=array)
    np.testing.assert_array_equal(array[:], whole.y)
    with h5py.File(tmp_path / "y.h5", "w") as file:
        data = file.create_dataset("y", (3, 10, 3, 3), dtype="f8")
        cg.solve_ivp(f, (0, 1), y0, **options, out=data)
        np.testing.assert_array_equal(data[:], whole.y)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"y0": np.eye(3)}, ValueError, "are for ensembles, got a single point"),
        ({"dense_output": True}, ValueError, "dense_output must be False with an executor"),
        ({"executor": "fast"}, ValueError, "executor must be 'threads'"),
        ({"workers": 0}, ValueError, "workers must be at least 1"),
        ({"executor": "processes", "f": lambda t, y: [0, 0, 0]}, TypeError, "pickled"),
        ({"rtol": -1.0}, ValueError, "rtol"),
    ],
)
def test_arguments(change, error, message):
    given = {"f": field, "y0": POINTS, "frame": FRAME, "executor": "threads", **change}
    with pytest.raises(error, match=message):
        cg.solve_ivp(given.pop("f"), (0, 1), given.pop("y0"), **given)


def test_methods_of_the_package_travel_by_name(monkeypatch):
    """So that what was found out about one isn't found out again for each chunk."""
    known, complete = [], members.completed

    def noted(work, *args, **options):
        known.append(work.options["method"])
        return complete(work, *args, **options)

    monkeypatch.setattr(members, "completed", noted)
    pair = cg.methods["CF4(3)"]
    own = cg.catalogue.loads(cg.catalogue.dumps(pair).replace("CF4(3)", "Mine", 1))
    for method in ("CF4(3)", pair, "RKMK5(4)", own):
        cg.solve_ivp(field, (0, 0.1), POINTS[0], frame=FRAME, method=method, workers=2)
    assert known == ["CF4(3)", "CF4(3)", "RKMK5(4)", own]


def test_pointers_do_not_travel(library):
    pointer = ctypes.CDLL(str(library)).rhs
    doubles = ctypes.POINTER(ctypes.c_double)
    pointer.argtypes = [ctypes.c_double, doubles, doubles, ctypes.c_void_p]
    pointer.restype = ctypes.c_int
    with pytest.raises(TypeError, match=r"a compiled one cg\.CompiledFunction\(path, symbol\)"):
        cg.solve_ivp(pointer, (0, 1), POINTS, frame=FRAME, parameters=RATES, executor="processes")


class TestCompiledFunction:
    def test_it_travels(self, library):
        f = cg.CompiledFunction(library, "rhs", [1.0, math.pi])
        again = pickle.loads(pickle.dumps(f))
        assert again == f
        assert hash(again) == hash(f)
        assert f != cg.CompiledFunction(library, "rhs")
        assert repr(f) == f"CompiledFunction({str(library)!r}, 'rhs', [1.0, {math.pi}])"
        one, two = (cg.solve_ivp(g, (0, 1), np.eye(3), frame=FRAME).y[-1] for g in (f, again))
        np.testing.assert_array_equal(one, two)

    @pytest.mark.parametrize(
        ("arguments", "error", "message"),
        [
            ((3, "rhs"), TypeError, "path must be a path, got 3"),
            (("/none.so", "rhs"), ValueError, "path must be a shared library, got '/none.so'"),
            (("LIBRARY", 3), TypeError, "symbol must be a string, got 3"),
            (("LIBRARY", "lhs"), ValueError, "symbol must be a function of .*, got 'lhs'"),
            (("LIBRARY", "rhs", "x"), ValueError, "user_data must be an array of real numbers"),
        ],
    )
    def test_arguments(self, library, arguments, error, message):
        arguments = tuple(library if each == "LIBRARY" else each for each in arguments)
        with pytest.raises(error, match=message):
            cg.CompiledFunction(*arguments)
