"""An interrupt ends every call that integrates for long."""

import shutil
import signal
import subprocess
import sys
import textwrap

import pytest

SETUP = """
import ctypes
import numpy as np
import cg
from cg.frames import Euclidean

library = ctypes.CDLL({library!r})
f = library.announced
f.restype = ctypes.c_int
doubles = ctypes.POINTER(ctypes.c_double)
f.argtypes = [ctypes.c_double, doubles, doubles, ctypes.c_void_p]
options = {{"frame": Euclidean(1)}}
one, many = [0.0], np.zeros((2, 1))
cg.solve_ensemble(f, (0, 1), many, method='CG3', h=1.0, workers=2, **options)  # imports
cg.Stepper(f, 0.0, one, **options).step()
try:
    {call}
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
CALLS = {
    "fixed": "cg.integrate(f, (0, 2e9), one, method='CG3', h=1.0, save_every=10**9, **options)",
    "workers": "cg.solve_ensemble(f, (0, 2e9), many, method='CG3', h=1.0, workers=2, **options)",
    "adaptive": "cg.solve_ivp(f, (0, 1e9), one, max_step=1e-6, max_steps=10**12, t_eval=[], "
    "**options)",
    "ensemble": "cg.solve_ensemble(f, (0, 1e9), many, max_step=1e-6, max_steps=10**12, **options)",
    "stepper": "cg.Stepper(f, 0.0, one, max_step=1e-6, **options).advance(1e9)",
}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", list(CALLS))
def test_an_interrupt_ends_the_call(kind, compiled_library):
    program = textwrap.dedent(SETUP).format(library=compiled_library._name, call=CALLS[kind])
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "running\n"
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=20)
        finally:
            process.kill()
    assert output == "interrupted\n"  # had it ended by itself, it would have said nothing
    assert process.returncode == 0
