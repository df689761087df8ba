"""Plant errors in the compiled core, one at a time, and see whether tests fail.

Usage: ``python tools/plant_errors.py --output FILE [NUMBER ...]``

The tree is copied, compiled without optimisation, and each error of `ERRORS` is put into the copy,
compiled, tested and taken out again. None of the tests needs libminpack. One line of JSON an error
goes to FILE; errors that are there already aren't planted again.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from cg.reproduce.kept import Kept

ROOT = Path(__file__).parents[1]


class Planted(NamedTuple):
    """A wrong line, and which files of tests should see it."""

    what: str
    file: str
    right: str
    wrong: str
    tests: str


ERRORS = [
    Planted(
        "words are cut in two, and the parts exchanged",
        "weights",
        "self%left(begin:last, self%head(i))*self%e(begin:last, self%tail(i))",
        "self%left(begin:last, self%tail(i))*self%e(begin:last, self%head(i))",
        "conditions",
    ),
    Planted(
        "n! of words of three letters and more",
        "weights",
        "first(t))/real(children, wp)",
        "first(t))/real(children - 1, wp)",
        "conditions",
    ),
    Planted(
        "of several weights a point the last counts",
        "weights",
        "letter(m) = letter(m) + x(k)*chi(at(k))",
        "letter(m) = x(k)*chi(at(k))",
        "differential",
    ),
    Planted(
        "the share that a letter has of an exponential's derivative",
        "gradient",
        "share = share*real(i, wp)/real(p + 1 + i, wp)",
        "share = share*real(i, wp)/real(p + i, wp)",
        "conditions",
    ),
    Planted(
        "derivatives by flows before a segment",
        "gradient",
        "+ whole(s, weights%tail(i))*adjoint(c0:, t, s)",
        "+ whole(s, weights%head(i))*adjoint(c0:, t, s)",
        "point_conditions points",
    ),
    Planted(
        "derivatives of assumptions on stages",
        "gradient",
        "- real(k, wp)*weights%chi(r, abscissa)**(k - 1)",
        "- weights%chi(r, abscissa)**(k - 1)",
        "structure",
    ),
    Planted(
        "a flow on SO(3) turns by ten decimals",
        "frames",
        "e(1:3) = (sinc / 2) * v",
        "e(1:3) = (sinc / 2) * v * (1 + 1e-10_wp)",
        "flows frame_facts",
    ),
    Planted(
        "the translation of a rigid motion",
        "frames",
        "b = half * sinc**2",
        "b = half * sinc",
        "flows frame_facts",
    ),
    Planted(
        "the step towards the nearest rotation",
        "frames",
        "zx = -0.5_wp * dot_product(z, x)",
        "zx = -0.5_wp * dot_product(z, y)",
        "flows compiled",
    ),
    Planted(
        "the exponent of the controller",
        "controller",
        "factor = min(largest_factor, max(smallest_factor, safety * factor**exponent))",
        "factor = min(largest_factor, max(smallest_factor, safety * factor))",
        "adaptive",
    ),
    Planted(
        "steps grow after a rejection",
        "controller",
        "if (after_rejection) factor = min(factor, 1.0_wp)",
        "if (after_rejection) factor = min(factor, largest_factor)",
        "adaptive",
    ),
    Planted(
        "the size of the first step",
        "controller",
        "first_size = (first_error * rate / slope)**exponent / rate",
        "first_size = (first_error * rate / slope)**exponent",
        "adaptive",
    ),
    Planted(
        "differences of points, which interpolation is made of",
        "coordinates",
        "v = (2 * (atan2(sine, q(4)) / sine)) * q(1:3)",
        "v = (2 * (sine / sine)) * q(1:3)",
        "flows dense",
    ),
    Planted(
        "coordinates of a rigid motion, which interpolation is made of",
        "coordinates",
        "dot_product(n, u) * n - b * cross(n, u)",
        "dot_product(n, u) * n + b * cross(n, u)",
        "flows dense",
    ),
    Planted(
        "slopes that interpolation uses are those at the other end",
        "interpolant",
        "interpolant%field(:, 1) = first",
        "interpolant%field(:, 1) = last",
        "dense integration_loop",
    ),
    Planted(
        "one node of the interpolant is left out",
        "interpolant",
        "interpolant%field(:, 2:n) = interpolant%next(:, 2:n)",
        "interpolant%field(:, 2:n) = interpolant%next(:, 1:n - 1)",
        "dense integration_loop",
    ),
    Planted(
        "zeros of events are found to three digits",
        "root",
        "tolerance = 4 * epsilon(1.0_wp)",
        "tolerance = 1.0e-3_wp",
        "events dense",
    ),
    Planted(
        "the second derivative along steps of least norm",
        "minimum_norm",
        "step = step + 0.5_wp*acceleration",
        "step = step - 0.5_wp*acceleration",
        "least_norm",
    ),
    Planted(
        "the gain of a step of least norm",
        "minimum_norm",
        "predicted = f - sum((damping*y)**2)",
        "predicted = f + sum((damping*y)**2)",
        "least_norm",
    ),
    Planted(
        "steps of lmdif's differences",
        "levenberg_marquardt",
        "step = sqrt(max(solver%epsfcn, eps)) * abs(held)",
        "step = sqrt(solver%epsfcn) * abs(held)",
        "lmdif_tolerances",
    ),
    Planted(
        "lmdif's trust region",
        "levenberg_marquardt",
        "else if (.not. par > 0 .or. ratio >= 0.75_wp) then",
        "else if (.not. par > 0 .or. ratio >= 0.5_wp) then",
        "lmdif",
    ),
    Planted(
        "lmdif's test of convergence in x",
        "levenberg_marquardt",
        "if (delta <= solver%xtol * xnorm) info = small_step",
        "if (0.5_wp * delta <= solver%xtol * xnorm) info = small_step",
        "lmdif_tolerances",
    ),
    Planted(
        "the derivative of rotations' coordinates",
        "algebra",
        "factor = (1 - half * cos(half) / sin(half)) / (4 * half**2)",
        "factor = (1 - half * cos(half) / sin(half)) / (2 * half**2)",
        "munthe_kaas_compiled munthe_kaas",
    ),
    Planted(
        "the derivative of rigid motions' coordinates, at small angles",
        "algebra",
        "a = (real(1 - k, wp) * b23(k + 1) + a) * square",
        "a = (real(2 - k, wp) * b23(k + 1) + a) * square",
        "munthe_kaas_compiled munthe_kaas brackets",
    ),
    Planted(
        "coefficients of skew matrices",
        "orthogonal",
        "v(k) = merge(x(j, i), -x(j, i), modulo(i + j, 2) == 1)",
        "v(k) = merge(x(j, i), -x(j, i), modulo(i + j, 2) == 0)",
        "flows munthe_kaas_compiled",
    ),
    Planted(
        "the step towards determinant 1",
        "unitary",
        "times_real(-1 / real(n, wp), excess)",
        "times_real(1 / real(n, wp), excess)",
        "flows compiled",
    ),
    Planted(
        "the polynomials of coordinates within a step",
        "interpolant",
        "* merge(theta, 1 - theta, modulo(d, 2) == 1)",
        "* merge(theta, 1 - theta, modulo(d, 2) == 0)",
        "dense events",
    ),
    Planted(
        "derivatives of coordinates at the end of a step",
        "interpolant",
        "call dexpinv(frame, scheme%series, h * k(:, 2), k(:, final), exists)",
        "call dexpinv(frame, scheme%series, k(:, 2), k(:, final), exists)",
        "dense integration_loop",
    ),
    Planted(
        "the time of an event",
        "step_events",
        "if (theta(i) < 1) t = x%t + theta(i) * (x%t_end - x%t)",
        "if (theta(i) < 1) t = x%t + theta(i)**2 * (x%t_end - x%t)",
        "events jumps",
    ),
    Planted(
        "a step up to a breakpoint sees what comes after it",
        "trajectory",
        "trajectory%request_t = nearest(stop, -trajectory%h)",
        "trajectory%request_t = stop",
        "breakpoints",
    ),
    Planted(
        "jumps that make progress count as if they made none",
        "record",
        "if (abs(t - x%t) > 10 * smallest_size(t)) x%jumps_in_place = 0",
        "if (abs(t - x%t) > huge(t)) x%jumps_in_place = 0",
        "jumps",
    ),
    Planted(
        "points at wanted times are those of the end of the step",
        "record",
        "call point_at(problem, trajectory, (time - x%t) / (x%t_end - x%t), &",
        "call point_at(problem, trajectory, 1.0_wp, &",
        "compiled_output dense",
    ),
    Planted(
        "common steps are those of the member with the smallest error",
        "run",
        "shared = max(shared, run%lanes(i)%shared)",
        "shared = min(shared, run%lanes(i)%shared)",
        "solve_ensemble",
    ),
    Planted(
        "a restarted trajectory keeps the error of its last step",
        "trajectory",
        "trajectory%last_error = 1.0_wp\n    trajectory%after_rejection = .false.",
        "trajectory%after_rejection = .false.",
        "stepper",
    ),
    Planted(
        "the time of a stage",
        "step",
        "x%t + method%c(x%stage) * x%h, x%y(:, path), &",
        "x%t + method%c(x%stage - 1) * x%h, x%y(:, path), &",
        "integrate registers low_storage",
    ),
    Planted(
        "what a register keeps",
        "step",
        "x%f(:, 1) = method%a(x%stage) * x%f(:, 1) + x%received",
        "x%f(:, 1) = method%a(2) * x%f(:, 1) + x%received",
        "registers low_storage",
    ),
]


def run(folder: Path, *command: str) -> None:
    """Run a command of the build."""
    bin_folder = Path(sys.executable).parent
    variables = {**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}"}
    done = subprocess.run(
        command, cwd=folder, env=variables, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(done.stdout[-2000:] + done.stderr)


def compile_core(folder: Path) -> None:
    """Compile what has changed in a copy, and put it beside its Python modules."""
    if not (folder / "build").exists():
        options = ["-Doptimization=0", "-Dbuildtype=plain"]
        run(folder, "meson", "setup", "build", *options)
    run(folder, "ninja", "-C", "build")
    for file in (folder / "build" / "fortran").glob("*.so"):
        shutil.copy(file, folder / "cg" / file.name)


def tests_pass(folder: Path, names: str) -> tuple[bool, str]:
    """Run tests on a copy; return whether they pass, and the first that fails."""
    files = [
        str(next((ROOT / "tests").glob(f"*/test_{name}.py")).relative_to(ROOT))
        for name in names.split()
    ]
    files = [file for file in files if (folder / file).exists()]
    # without `site`, which would find the editable install first
    command = [sys.executable, "-S", "-P", "-m", "pytest", "-x", "-q", "-n", "0", "-m", "not slow"]
    options = ["-p", "no:cacheprovider", "-k", "not bit_for_bit"]
    variables = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), sysconfig.get_path("purelib")]),
    }
    done = subprocess.run(
        [*command, *options, *files],
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
        timeout=1800,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout[-3000:] + done.stderr)
    first = lines[0].split()[1].removeprefix("tests/") if lines else ""
    return done.returncode == 0, first


def plant(folder: Path, error: Planted) -> tuple[str, str]:
    """Put an error in, test, and take it out; return what became of it, and which test saw it."""
    path = folder / "fortran" / f"{error.file}.f90"
    text = path.read_text("utf-8")
    if text.count(error.right) != 1:
        raise SystemExit(f"{path.name} must have once: {error.right}")
    try:
        path.write_text(text.replace(error.right, error.wrong), "utf-8")
        compile_core(folder)
        passed, first = tests_pass(folder, error.tests)
    finally:
        path.write_text(text, "utf-8")
    return ("survived" if passed else "caught"), first


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("numbers", nargs="*", type=int, help="from 1; by default all")
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    wanted = [ERRORS[k - 1] for k in options.numbers] or ERRORS
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    with tempfile.TemporaryDirectory() as name, closing(Kept(options.output)) as kept:
        known = {record["what"] for record in kept.records}
        folder = Path(name)
        for path in filter(lambda path: (ROOT / path).exists(), listed.stdout.splitlines()):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, folder / path)
        (folder / "cg" / "reproduce").symlink_to(folder / "reproduce")  # as it is installed
        compile_core(folder)
        for error in wanted:
            if error.what in known:
                continue
            begin = time.monotonic()
            result, first = plant(folder, error)
            record = {
                "what": error.what,
                "file": error.file,
                "outcome": result,
                "by": first,
                "seconds": round(time.monotonic() - begin, 1),
            }
            kept.append(record)
            print(f"{error.file}: {error.what}: {result} {first}", flush=True)


if __name__ == "__main__":
    main()
