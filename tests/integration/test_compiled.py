"""Compiled right-hand sides: all kinds of C functions on all compiled frames."""

import ctypes
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from compiled_examples import DOUBLES, ORBITS, PROBLEMS
from frame_examples import name
from kinds import MUNTHE_KAAS
from python_steps import Step
from refusals import refuses
from scipy import LowLevelCallable

import cg
from cg.frames import GL, SL, SO, SO3, SU, Euclidean, Power, Product, Sphere, U
from cg.frames.facts import dexpinv_of
from cg.integration import integrate
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.rhs.form import RhsForm
from cg.integration.run.drive import StepBudget

pytestmark = pytest.mark.sanitize


@pytest.mark.parametrize("every", [1, 2, 3, 6, 7, 30])
def test_stored_steps_do_not_depend_on_pauses(every, monkeypatch):
    options = {"frame": SO3(), "method": "CG3", "h": 0.05, "save_every": every}
    f = lambda t, y: [t, y[0, 0], 1.0]
    expected = integrate(f, (0, 1), np.eye(3), **options)
    rng = np.random.default_rng(6)
    for most in range(1, 20):
        monkeypatch.setattr(StepBudget, "start", lambda _, most=most: rng.integers(1, most + 1))
        solution = integrate(f, (0, 1), np.eye(3), **options)
        np.testing.assert_array_equal(solution.t, expected.t)
        np.testing.assert_array_equal(solution.y, expected.y)


def test_pointers_and_callables_are_the_same(compiled_function, compiled_library):
    pointer = compiled_function("growth")
    address = ctypes.cast(pointer, ctypes.c_void_p).value
    prototype = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, ctypes.POINTER(ctypes.c_int)
    )
    options = {"frame": Euclidean(1), "method": "CG4a", "h": 0.125}
    results = [
        integrate(f, (0, 1), [1.0], **options).y
        for f in (pointer, LowLevelCallable(pointer), prototype(address))
    ]
    for actual in results:
        np.testing.assert_array_equal(actual, results[0])
    assert results[0][-1, 0] == pytest.approx(np.e, abs=1e-4)


class Meeting(ctypes.Structure):
    _fields_ = (("callers", ctypes.c_int), ("patience", ctypes.c_int))


def meeting(function, patience):
    data = Meeting(0, patience)
    return LowLevelCallable(
        function("meets"), ctypes.cast(ctypes.byref(data), ctypes.c_void_p)
    ), data


OPTIONS = {"frame": Euclidean(1), "method": "CG3", "h": 0.5}


def test_python_lock_is_released(compiled_function):
    f, data = meeting(compiled_function, 20_000)
    with ThreadPoolExecutor(2) as pool:
        runs = [pool.submit(integrate, f, (0, 1), [0.0], **OPTIONS) for _ in range(2)]
        actual = [run.result().y for run in runs]
    np.testing.assert_array_equal(actual[0], actual[1])
    assert data.callers == 2


@pytest.mark.filterwarnings("ignore:Failure of")
def test_workers_run_at_the_same_time(compiled_function):
    f, data = meeting(compiled_function, 20_000)
    cg.solve_ensemble(f, (0, 1), np.zeros((2, 1)), workers=2, **OPTIONS)
    assert data.callers == 2
    f, data = meeting(compiled_function, 2)
    alone = cg.solve_ensemble(f, (0, 1), np.zeros((2, 1)), workers=1, **OPTIONS)
    assert alone.messages[0] == "f returned the error code 3 at t = 0"


def test_ensembles_and_complex_points_from_python(compiled_function):
    growth = compiled_rhs(compiled_function("growth"))
    points = np.array([[2.0], [3.0]])
    assert growth.values(RhsForm(Euclidean(1)), 0, 0.0, points).tolist() == points.tolist()
    # SU(2) has three coefficients; the others stay unwritten.
    y = np.array([[0.6 + 0.8j, 0.0], [0.0, 0.6 - 0.8j]])
    actual = growth.on_form(RhsForm(SU(2))).at_member(0, 0.0, y)
    assert actual[0] == 0.6
    assert np.isnan(actual[1:]).all()
    stops = compiled_rhs(compiled_function("stops")).on_form(RhsForm(Euclidean(1)))
    with pytest.raises(RuntimeError, match="f returned the error code 7 at t = 1"):
        stops.at_member(0, 1.0, np.zeros(1))


@pytest.mark.parametrize(("method", "message"), [
    ("LieEuler", "the solution is no longer finite at t = 10000000000"),
    ("CG2", "a stage is no longer finite at t = 5000000000"),
    ("RKMK4", "a stage is no longer finite at t = 5000000000"),
])  # fmt: skip
def test_solutions_that_overflow(method, message, compiled_function):
    with pytest.raises(OverflowError, match=message):
        integrate(
            compiled_function("growth"),
            (0, 1e10),
            [1e300],
            frame=Euclidean(1),
            method=method,
            h=1e10,
        )


@pytest.mark.parametrize(("frame", "y0"), [
    (Sphere(3), [0.0, 0.0, 0.0, 1.0]),
    (SL(3), np.eye(3)),
    (Product(SO3(), GL(2)), np.concatenate([np.eye(3).ravel(), np.eye(2).ravel()])),
])  # fmt: skip
def test_on_frames_that_are_not_compiled_it_is_called_from_python(frame, y0, compiled_function):
    with pytest.raises(ValueError, match="f must return finite numbers"):  # it sets one only
        integrate(compiled_function("growth"), (0, 1), y0, frame=frame, method="CG3", h=0.1)
    options = {"frame": frame, "method": "CG3", "h": 0.1, "parameters": [frame.dim]}
    still = integrate(compiled_function("rests_all"), (0, 1), y0, **options)
    np.testing.assert_allclose(still.y[-1], y0, rtol=0, atol=1e-15)


def requires_data(library):
    """Return functions that read numbers, and would crash with a null pointer."""
    pointer = library["decays"]
    pointer.argtypes, pointer.restype = [ctypes.c_double, DOUBLES, DOUBLES, DOUBLES], ctypes.c_int
    address = ctypes.cast(pointer, ctypes.c_void_p).value
    prototype = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, DOUBLES, DOUBLES, DOUBLES)
    capsule = ctypes.PYFUNCTYPE(
        ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
    )(ctypes.cast(ctypes.pythonapi.PyCapsule_New, ctypes.c_void_p).value)
    text = b"int (double, double const *, double *, double const *)"
    return {
        "pointer": pointer, "prototype": prototype(address), "callable": LowLevelCallable(pointer),
        "capsule": LowLevelCallable(capsule(address, text, None)),
        "cfunc": type("CFunc", (), {"address": address, "ctypes": prototype(address)})(),
        "text": text,
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["pointer", "prototype", "callable", "capsule", "cfunc"])
def test_functions_that_read_numbers_need_them(kind, compiled_library):
    f = requires_data(compiled_library)[kind]
    message = "parameters must be given for a compiled f .* double \\*, got None"
    refuses(ValueError, message, integrate, f, (0, 1), [1.0], **OPTIONS)
    refuses(ValueError, message, cg.solve_ensemble, f, (0, 1), [[1.0], [2.0]], frame=Euclidean(1))
    options = OPTIONS | {"parameters": [-1.0, 2.0], "h": 0.125}
    solution = integrate(f, (0, 1), [1.0], **options)
    assert solution.y[-1, 0] == pytest.approx(np.exp(-1.0), abs=1e-4)


def test_functions_that_read_numbers_may_have_user_data(compiled_library):
    data = np.array([-1.0, 2.0])
    f = LowLevelCallable(
        requires_data(compiled_library)["pointer"], ctypes.c_void_p(data.ctypes.data)
    )
    solution = integrate(f, (0, 1), [1.0], **(OPTIONS | {"h": 0.125}))
    assert solution.y[-1, 0] == pytest.approx(np.exp(-1.0), abs=1e-4)


def test_other_signatures_are_refused(compiled_library):
    bare = compiled_library["growth"]
    with pytest.raises(ValueError, match="f must have argtypes and restype"):
        integrate(bare, (0, 1), [1.0], **OPTIONS)
    bare.argtypes = [ctypes.c_double, DOUBLES, ctypes.c_void_p]
    bare.restype = ctypes.c_int
    with pytest.raises(ValueError, match=r"f must have the signature 'int \(double, .* got 'int"):
        integrate(bare, (0, 1), [1.0], **OPTIONS)
    bare.argtypes = [ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p]
    bare.restype = ctypes.c_double
    with pytest.raises(ValueError, match="f must have the signature"):
        integrate(LowLevelCallable(bare), (0, 1), [1.0], **OPTIONS)


@pytest.mark.parametrize(("name", "y0", "error", "message"), [
    ("stops", [0.0], RuntimeError, r"^f returned the error code 7 at t = 0\.[5-9]"),
    ("writes_nothing", [0.0], ValueError, "finite numbers and write each of them, got array.*nan"),
    ("square", [1e160], ValueError, r"f must return finite numbers.*, got array\(\[inf\]\) at t ="),
])  # fmt: skip
@pytest.mark.parametrize("output", [{}, {"dense_output": True}, {"t_eval": [0.1, 0.9]}])
@pytest.mark.parametrize("steps", [{"method": "CG2", "h": 0.25}, {}, {"max_step": 0.01}], ids=str)
def test_failures_of_f(name, y0, error, message, output, steps, compiled_function):
    with pytest.raises(error, match=message):
        cg.solve_ivp(compiled_function(name), (0, 1), y0, frame=Euclidean(1), **steps, **output)
    if name == "writes_nothing" and "h" not in steps:  # nor of time alone
        refuses(error, message, cg.solve_linear, compiled_function(name), (0, 1), y0,
                frame=Euclidean(1), **steps, **output)  # fmt: skip


@pytest.mark.parametrize("key", [key for key, method in MUNTHE_KAAS.items() if method.explicit])
@pytest.mark.parametrize("problem", PROBLEMS)
def test_compiled_code_and_python_take_the_same_steps(problem, key):
    problem, method = PROBLEMS[problem], MUNTHE_KAAS[key]
    run = cg.integrate(problem.f, (0, 1), problem.y0, frame=problem.frame, method=key, h=0.25)
    step = Step(problem.f, problem.frame, method)
    point = problem.y0
    for k in range(4):
        point = step(0.25 * k, point, 0.25)
    np.testing.assert_allclose(run.y[-1], point, rtol=1e-14, atol=1e-14)
    assert (run.nfev, run.nexp) == (step.nfev, step.nexp)
    assert run.nexp == 4 * method.exponentials


GROUPS = [SO(2), SO(4), SO(5, "space"), SU(3), SU(4, "body"), U(1), U(2), Power(SU(3), 2)]


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("frame", [*GROUPS, *ORBITS], ids=name)
def test_the_series_in_compiled_code(frame, order):
    u, v = np.random.default_rng(0).standard_normal((2, 3, frame.dim))
    if frame in ORBITS:  # within the radius of convergence
        u /= 4
    expected = frame.dexpinv(u, v, order=order)
    values = dexpinv_of(frame, order)(u, v)
    np.testing.assert_allclose(values, expected, rtol=2e-14, atol=2e-14)
