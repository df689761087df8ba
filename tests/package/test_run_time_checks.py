"""The compiled core under run-time checks and floating-point traps, with warnings as errors."""

import shutil
import subprocess
from pathlib import Path

import pytest

from cg.construction.trees import forest, fortran_tables
from cg.support.shared_numbers import fortran_module

TESTS = Path(__file__).parents[1]
SOURCES = TESTS.parent / "fortran"
FLAGS = [
    "-O1", "-g", "-frecursive", "-fimplicit-none", "-Wall", "-Wextra", "-Wconversion-extra",
    "-Wno-compare-reals", "-Wno-c-binding-type", "-Wno-unused-dummy-argument", "-Werror",
    "-fcheck=all", "-ffpe-trap=invalid,zero,overflow",
]  # fmt: skip
CONDITIONS = (
    "support/linalg",
    *(f"conditions/{name}" for name in ("levenberg_marquardt", "weights", "conditions")),
)
STEPS = ("support/vectors", *(f"steps/{name}" for name in ("controller", "inputs", "zero_finding")))


@pytest.mark.skipif(shutil.which("gfortran") is None, reason="gfortran is not installed")
@pytest.mark.parametrize(("name", "kind", "modules"), [
    ("core_checks", "real64", CONDITIONS),
    ("core_checks", "real128", CONDITIONS),
    ("step_checks", "real64", STEPS),
])  # fmt: skip
def test_core_passes_with_checks_and_traps(tmp_path, name, kind, modules):
    kinds = tmp_path / "kinds.f90"
    kinds.write_text((SOURCES / "support" / "kinds.f90.in").read_text().replace("@KIND@", kind))
    tables = tmp_path / "tree_tables.f90"
    tables.write_text(fortran_tables(forest(7)))
    shared = tmp_path / "shared_numbers.f90"
    shared.write_text(fortran_module())
    sources = [kinds, tables, shared, *(SOURCES / f"{module}.f90" for module in modules)]
    program = tmp_path / name
    paths = map(str, [*sources, TESTS / "fortran" / f"{name}.f90"])
    command = ["gfortran", *FLAGS, f"-J{tmp_path}", *paths, "-o", str(program)]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    run = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "passed" in run.stdout
