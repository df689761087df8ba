"""The compiled core under run-time checks and floating-point traps, with warnings as errors."""

import subprocess

import pytest
from minpack_libraries import FLAGS, HAS_COMPILER, KINDS, SOURCES, TESTS

from cg.support.shared_numbers import fortran_module
from cg.trees.ordered import forest
from cg.trees.tables import fortran_tables

MODULES = (
    *("kinds", "stop_flag", "least_squares", "linalg", "levenberg_marquardt", "lmdif"),
    *("weights", "gradient", "conditions"),
)


@pytest.mark.skipif(not HAS_COMPILER, reason="gfortran is not installed")
@pytest.mark.parametrize("suffix", KINDS)
def test_core_passes_with_checks_and_traps(tmp_path, suffix):
    tables = tmp_path / "tree_tables.f90"
    tables.write_text(fortran_tables(forest(7)))
    shared = tmp_path / "shared_numbers.f90"
    shared.write_text(fortran_module())
    sources = [str(tables), str(shared)]
    templates = [SOURCES / f"{module}.f90.in" for module in MODULES]
    for template in (*templates, TESTS / "fortran" / "core_checks.f90.in"):
        text = template.read_text().replace("@SFX@", suffix).replace("@KIND@", KINDS[suffix])
        configured = tmp_path / template.name.removesuffix(".in")
        configured.write_text(text)
        sources.append(str(configured))
    program = tmp_path / "core_checks"
    command = ["gfortran", *FLAGS, f"-J{tmp_path}", *sources, "-o", str(program)]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    run = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "passed" in run.stdout
