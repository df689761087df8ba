"""Allocations that fail raise MemoryError."""

import os
import subprocess
import sys

import pytest
from refusals import refuses

from cg.support.memory import check_memory

resource = pytest.importorskip("resource")

# runs each case in a child of its own, below a limit; prints what became of it
_RUNNER = """
import os, resource, sys, traceback
import numpy as np
import cg
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.system import ConditionSystem

def in_use():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[0]) * resource.getpagesize()

def outcome(case, limit):
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        try:
            exec(case)
            os.write(writing, b"done")
        except MemoryError as error:
            os.write(writing, b"MemoryError: " + str(error).encode())
        except BaseException as error:
            os.write(writing, repr(error).encode())
        os._exit(0)
    os.close(writing)
    output = b""
    while part := os.read(reading, 1000):
        output += part
    status = os.waitpid(child, 0)[1]
    return output.decode() if status == 0 else f"died: {status}"
"""


_SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # what was freed is given back, so that limits mean the same for each case
    "MALLOC_MMAP_THRESHOLD_": "16384",
    "MALLOC_TRIM_THRESHOLD_": "0",
}


def _run(code):
    run = subprocess.run(
        [sys.executable, "-c", _RUNNER + code], capture_output=True, text=True,
        env={**os.environ, **_SETTINGS}, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


LARGE = {
    "cg.conditions.residuals(np.zeros((1500, 1500)), np.zeros(1500), 8)": "1500 stages",
    "cg.conditions.weights(np.zeros((900, 900)), np.zeros(900), 8)": "900 stages",
    "cg.conditions.jacobian(np.zeros((400, 400)), np.zeros(400), 8)": "400 stages",
    "cg.search(8, 1000, 1, 1, workers=1)": "1000 stages",
    "cg.search(8, 1000, 1, 1, workers=2)": "1000 stages",
    "cg.search(6, 600, 1, 1, algorithm='lmdif', workers=1)": "600 stages",
    "cg.solve_ivp(np.negative, (0, 1), np.ones(1 << 25), frame=cg.frames.Euclidean(1 << 25))": (
        "trajectories of 33554432 numbers"
    ),
}


@pytest.mark.skipif(sys.platform != "linux", reason="limits of addresses are Linux's")
@pytest.mark.parametrize("case", LARGE)
def test_what_is_large_is_refused_below_a_limit_of_4_gib(case):
    message = _run(f"print(outcome({case!r}, 4 << 30))")[0]
    assert message.startswith("MemoryError: ")
    assert LARGE[case] in message


# before the call itself, so that what Python allocates isn't part of it
_PREPARED = """
from cg.construction.layouts import Layout
layout = Layout.tableau(50)
small = Layout.tableau(18)
system = ConditionSystem(7, layout)
x = np.zeros(layout.size)
trees, owner = system.conditions(True)
flag = np.zeros(1, dtype=np.intc)
from cg.construction.conditions import core_calls as door
from cg.construction.solvers.lmdif import fit_lmdif
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.support import quads
start = np.zeros(small.size)
enough = np.resize(ConditionSystem(5, small).conditions(True)[0], small.size)
start_quad = quads.from_float(start)
bits, tolerance = quads.from_float(x), quads.from_float([1e-9]).T
cases = {
    "door.residuals(7, layout, x, trees, owner)": door.evaluation_bytes(7, layout, trees.size),
    "door.residuals(7, layout, bits, trees, owner)":
        door.evaluation_bytes(7, layout, trees.size, 16),
    "door.jacobian(7, layout, x, trees, owner)": door.derivatives_bytes(7, layout, trees.size),
    "fit_conditions(x, system, max_iterations=1)":
        door.derivatives_bytes(7, layout, trees.size),
    "fit_lmdif(5, small, start, enough, np.array([1e-9]), 1, flag)":
        door.evaluation_bytes(5, small, enough.size) + 8 * enough.size * small.size,
    "fit_lmdif(5, small, start_quad.T, enough, tolerance, 1, flag)":
        door.evaluation_bytes(5, small, enough.size, 16) + 16 * enough.size * small.size,
}
door.jacobian(7, layout, x, trees, owner), door.residuals(7, layout, bits, trees, owner)
np.linalg.svd(np.ones((50, 50)))  # work space of the linear algebra
for case, bound in cases.items():
    for k in range(13):
        print(outcome(case, in_use() + bound * k // 4 + (k << 18)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of addresses are Linux's")
def test_calls_below_any_limit_are_done_or_refused():
    lines = _run(_PREPARED)
    assert len(lines) == 6 * 13
    assert not [line for line in lines if line != "done" and not line.startswith("MemoryError")]
    for k in range(6):
        outcomes = [line == "done" for line in lines[13 * k : 13 * (k + 1)]]
        assert not outcomes[0]
        assert outcomes[-1]
        assert outcomes == sorted(outcomes)


def test_message_of_refused_memory():
    message = r"^a thing needs 1\.05e\+06 GiB of memory"
    refuses(MemoryError, message, check_memory, 2**50, "a thing")
