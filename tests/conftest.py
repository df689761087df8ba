"""Settings of all tests."""

import ctypes
import importlib
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


# Folders whose tests exercise no compiled code that others don't; other files say so themselves.
NO_CORE = "analysis benchmarks command docs formats plot proofs reproduce research trees"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name in NO_CORE.split():
            item.add_marker("no_core")


@pytest.fixture(scope="session")
def compiled_library(tmp_path_factory):
    target = tmp_path_factory.mktemp("library") / "compiled_rhs.so"
    source = Path(__file__).parent / "helpers" / "compiled_rhs.c"
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", target, source, "-lm"], check=True)
    return ctypes.CDLL(str(target))


@pytest.fixture
def compiled_function(compiled_library):
    def get(name):
        symbol = compiled_library[name]  # a new object each time, unlike an attribute
        symbol.restype = ctypes.c_int
        symbol.argtypes = [ctypes.c_double, DOUBLES, DOUBLES, ctypes.c_void_p]
        return symbol

    return get


@pytest.fixture
def affine_rhs(compiled_function):
    def make(problem):
        m, n = problem.linear.shape
        numbers = [[m, n], problem.constant, problem.slope, problem.linear.ravel()]
        data = np.concatenate(numbers)
        callable_ = LowLevelCallable(compiled_function("affine"), ctypes.c_void_p(data.ctypes.data))
        return callable_, data

    return make


@pytest.fixture
def store_path(tmp_path):
    """Return the file of a store of runs."""
    return tmp_path / "runs.jsonl"


@pytest.fixture
def run_command(capsys):
    """Run the command in this process; return its exit code, its output and its errors."""
    from cg.command import main

    def run_command(*arguments):
        code = main(list(arguments))
        output = capsys.readouterr()
        return code, output.out, output.err

    return run_command


@pytest.fixture(scope="session")
def load_script():
    """Import a script of a folder that is no package, such as ``research/run_recipe``."""

    def load(path):
        folder, name = (Path(__file__).parents[1] / path).parent, Path(path).name
        sys.path.insert(0, str(folder))
        try:
            return importlib.import_module(name)
        finally:
            sys.path.remove(str(folder))

    return load


@pytest.fixture(scope="module")
def tool(request, load_script):
    """Import the program that the module of tests names."""
    return load_script(request.module.TOOL)


def pytest_terminal_summary(terminalreporter):
    skipped = len(terminalreporter.stats.get("skipped", []))
    run = sum(len(terminalreporter.stats.get(kind, [])) for kind in ("passed", "failed", "xfailed"))
    terminalreporter.write_line(f"{skipped} of {run + skipped} tests were skipped.")
