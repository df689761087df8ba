"""Settings of all tests."""

import ctypes
import signal
import subprocess
import sys
import threading
from pathlib import Path

import hypothesis
import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # loads the libraries whose threads are limited below
from compiled_examples import DOUBLES
from scipy import LowLevelCallable
from threadpoolctl import threadpool_limits

# After installed packages, so that `research` is found and `cg` remains the installed one.
sys.path.append(str(Path(__file__).parents[1]))

# A suite that was started in the background ignores interrupts, and so would all that it starts.
if (
    threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The matrices of the tests are small: threads of BLAS would only wait for each other.
threadpool_limits(1)

# Every run draws the same examples, and a busy machine is no reason to fail. With
# `--hypothesis-profile=nightly` each run draws others, and prints how to repeat what fails.
hypothesis.settings.register_profile("same", derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile(
    "nightly", derandomize=False, database=None, deadline=None, print_blob=True
)
hypothesis.settings.load_profile("same")


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    target = tmp_path_factory.mktemp("library") / "compiled_rhs.so"
    source = Path(__file__).parent / "helpers" / "compiled_rhs.c"
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", target, source, "-lm"], check=True)
    return ctypes.CDLL(str(target))


@pytest.fixture
def function(library):
    def get(name):
        actual = library[name]  # a new object each time, unlike an attribute
        actual.restype = ctypes.c_int
        actual.argtypes = [ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p]
        return actual

    return get


@pytest.fixture
def affine(function):
    def make(problem):
        m, n = problem.linear.shape
        numbers = [[m, n], problem.constant, problem.slope, problem.linear.ravel()]
        data = np.concatenate(numbers)
        callable_ = LowLevelCallable(function("affine"), ctypes.c_void_p(data.ctypes.data))
        return callable_, data

    return make


def pytest_terminal_summary(terminalreporter):
    skipped = len(terminalreporter.stats.get("skipped", []))
    run = sum(len(terminalreporter.stats.get(kind, [])) for kind in ("passed", "failed", "xfailed"))
    terminalreporter.write_line(f"{skipped} of {run + skipped} tests were skipped.")
