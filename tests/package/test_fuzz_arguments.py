"""Public functions with hostile arguments return a result or raise an error that names them.

The environment variable ``CG_FUZZ`` multiplies the number of calls. The slow test tries every value
for every argument.
"""

import contextlib
import os
import re
import signal
import threading
import warnings
from decimal import Decimal  # noqa: F401  # in expressions, as is the next
from fractions import Fraction  # noqa: F401
from importlib.util import find_spec

import numpy as np
import pytest
from argument_examples import FUNCTION_EXAMPLES
from frame_argument_examples import FRAME_EXAMPLES
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matplotlib import pyplot

import cg

MANY = int(os.environ.get("CG_FUZZ", "1"))
SECONDS = 5.0
EXAMPLES = FUNCTION_EXAMPLES | FRAME_EXAMPLES

# Expressions, each of which makes a new value
SCALARS = [
    "None", "True", "-1", "0", "1", "7", "2**31", "2**63", "10**400", "-(10**400)", "1.5",
    "np.nan", "np.inf", "-np.inf", "1e308", "5e-324", "1j", "Fraction(1, 3)", "Decimal('0.5')",
    "Decimal('nan')", "'x'", "''", r"'\ud800'", r"'\0'", "b'x'", "object()", "int", "np",
    "lambda *arguments: None", "iter([1, 2])", "[]", "{}", "{1, 2}", "[[]]", "[[1.0], [1.0, 2.0]]",
    "[None, None]", "['x', 'y']", "range(3)", "np.array(1.0)", "np.array(1)", "np.array(None)",
    "np.zeros(0)", "np.zeros((0, 3))", "np.zeros(3)", "np.zeros((2, 3, 4, 5))", "np.True_",
    "np.array(['2020-01-01'], 'datetime64[s]')", "np.zeros(3, [('a', float), ('b', int)])",
    "np.ma.masked", "np.int8(3)", "np.float16(0.5)", "np.complex128(1 + 1j)",
]  # fmt: skip


def is_array(value):
    """Return whether a valid argument is one of arrays, lists and tuples of numbers."""
    if not isinstance(value, list | tuple | np.ndarray) or len(value) == 0:
        return False
    try:
        return np.asarray(value).dtype.kind in "iufc"
    except ValueError:
        return False


def spaced(array):
    """Return the same array, not contiguous."""
    other = np.nan if array.dtype.kind in "fc" else -1
    wide = np.full((*array.shape, 2), other, array.dtype)
    wide[..., 0] = array
    return wide[..., 0]


def same_start(change):
    """Return a function that changes the first number of a copy."""

    def changed(array):
        copy = np.array(array, dtype=complex if array.dtype.kind == "c" else float)
        copy.flat[0] = change(copy.flat[0])
        return copy

    return changed


def masked(array):
    mask = np.zeros(array.shape, bool)
    mask.flat[0] = True
    return np.ma.masked_array(array, mask)


# Changes that keep the numbers: the result is the same, or an error
SAME = {
    "lists": lambda array: array.tolist(), "spaced": spaced, "Fortran": np.asfortranarray,
    "swapped": lambda array: array.astype(array.dtype.newbyteorder()),
    "object": lambda array: array.astype(object), "unmasked": np.ma.masked_array,
    "read-only": lambda array: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape),
}  # fmt: skip
# Changes of the numbers or the shape, which must not be ignored
OTHER = {
    "first nan": same_start(lambda x: np.nan), "first inf": same_start(lambda x: np.inf),
    "first huge": same_start(lambda x: 1e308), "first moved": same_start(lambda x: x + 0.125),
    "masked": masked,
    "first imaginary": lambda array: array + 1j * (np.arange(array.size) == 0).reshape(array.shape),
    "one less": lambda array: array[:-1],
    "one more": lambda array: np.concatenate([array, array[:1]]),
    "a dimension more": lambda array: array[None], "last dimension": lambda array: array[..., None],
    "first alone": lambda array: array[0], "reversed": lambda array: array[::-1],
    "texts": lambda array: array.astype(str),
}  # fmt: skip
# Arguments whose large values take long
COUNTS = {"starts", "tries", "hits", "save_every", "max_steps", "maxfev", "refine_maxfev"}


def values(key, right):
    """Return the names of the values to try in place of a valid argument."""
    names = [name for name in SCALARS if not (key in COUNTS and name.startswith("2**"))]
    if is_array(right):
        names += [f"array, {name}" for name in (*SAME, *OTHER)]
    return names


def argument(name, right):
    """Return the value of a name."""
    if name.startswith("array, "):
        change = name.removeprefix("array, ")
        return (SAME.get(change) or OTHER[change])(np.array(right))
    return eval(name)


class TooLong(BaseException):
    """Raised in a call that takes too long."""


@contextlib.contextmanager
def limited(what):
    """Raise TooLong in a block that takes more than `SECONDS`; compiled code isn't interrupted."""

    def stop(number, frame):
        raise TooLong(what)

    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def finite(result):
    """Return whether a result consists of finite numbers."""
    try:
        return bool(np.isfinite(np.asarray(result, dtype=complex)).all())
    except (TypeError, ValueError):
        return False


def error_of(name, changes):
    """Call a function with some arguments changed; return its error or None.

    A RuntimeWarning of NumPy counts as an error if the result is finite.
    """
    call = EXAMPLES[name]
    changed = {key: argument(value, call.arguments[key]) for key, value in changes.items()}
    if (axes := call.arguments.get("ax")) is not None:
        axes.clear()
    with warnings.catch_warnings(record=True) as caught, limited(f"{name} {changes}"):
        warnings.simplefilter("always")
        try:
            result = call.function(**call.arguments | changed)
        except Exception as error:
            return error
    huge = any("huge" in value or value == "1e308" for value in changes.values())
    warned = [one for one in caught if issubclass(one.category, RuntimeWarning) and not huge]
    return warned[0].message if warned and finite(result) else None


def is_named(call, message, called):
    """Return whether a message names an argument or a part of one.

    `called` is the name that messages use for the call.
    """
    if "broadcast" in message:  # leading axes that don't fit each other
        return True
    if called and re.search(rf"^{re.escape(called)} ", message):
        return True
    return any(
        re.search(rf"(^|\W){re.escape(word)}(\W|$)", message)
        for name in call.arguments
        for word in (name, *PARTS.get(name, ()))
    )


# Public classes that aren't called: results and errors
RETURNED = {
    "Certificate", "CompiledFunction", "DenseOutput", "Diagnosis", "Lifted", "Reference",
    "Solution", "EnsembleSolution", "Adjoint", "Rows", "Structure", "Frame",
    "HomogeneousSpace", "MatrixGroup", "Method", "MethodError", "MissingQuadsError", "TableauError",
    "CertificationError", "ConvergenceError", "FlowOverflowError", "LiftError",
    "StepTooLongError", "Product",
}  # fmt: skip
# Functions of the user, whose own errors are raised unchanged
FUNCTIONS = {
    "f", "functions", "jac", "df_dp", "noise", "observe", "events", "progress",
    "args",
}  # fmt: skip

# Parts of arguments that messages name
PARTS = {
    "points": ("point",), "stage_points": ("stage", "point"), "tree": ("point", "text"),
    "text": ("TOML", "certificate", "entry", "shape"), "x": ("x_1",), "factor": ("factors",),
    "c": ("c_1",), "times": ("t",),
}  # fmt: skip


def check(name, changes):
    """Check that a call with some arguments changed returns, or raises an error that names one."""
    call = EXAMPLES[name]
    error = error_of(name, changes)
    if error is None or isinstance(error, (MemoryError, *call.errors)):
        return
    assert isinstance(error, TypeError | ValueError), repr(error)
    called = argument(changes["name"], None) if "name" in changes else ""
    called = called if isinstance(called, str) else ""
    assert FUNCTIONS & changes.keys() or is_named(call, str(error), called), repr(error)


@st.composite
def changed_calls(draw):
    name = draw(st.sampled_from(sorted(EXAMPLES)))
    right = EXAMPLES[name].arguments
    keys = draw(st.lists(st.sampled_from(sorted(right)), min_size=1, max_size=2, unique=True))
    return name, {key: draw(st.sampled_from(values(key, right[key]))) for key in keys}


@pytest.fixture(autouse=True)
def _folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@settings(max_examples=300 * MANY, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changed_calls())
def test_arguments(call):
    check(*call)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_every_value_of_every_argument(name):
    for key, right in EXAMPLES[name].arguments.items():
        for value in values(key, right):
            check(name, {key: value})
            pyplot.close("all")


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_examples_run(name):
    EXAMPLES[name].function(**EXAMPLES[name].arguments)


def test_every_public_function_has_an_example():
    """Classes of results and errors are exempt, since other calls return or raise them."""
    modules = [cg, cg.conditions, cg.frames, cg.plot, cg.problems]
    public = {
        (module, name): getattr(module, name) for module in modules for name in module.__all__
    }
    called = [call.function for call in EXAMPLES.values()]
    left = {name for (_, name), one in public.items() if callable(one) and one not in called}
    # load and save have paths
    assert left - {"load", "save"} == RETURNED | (set() if find_spec("sympy") else {"equations"})
