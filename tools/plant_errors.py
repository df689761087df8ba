"""Plant errors one at a time, and say which of them the tests see.

``python tools/plant_errors.py --number N --seed S`` changes one operator, constant, condition or
statement in a copy of the tree, in Python and Fortran, builds it, and runs the tests until the
first failure: those of random programs, then those of the file's folder, then all. Results are
appended to ``build/planted.jsonl``, so that an interrupted run goes on. An error without effect
counts as unseen; read those.
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
ROOMS = {  # folders, and the tests that are run before the others
    "fortran/steps": "tests/integration",
    "fortran/frames": "tests/frames",
    "fortran/interface": "tests/integration",
    "cg/integration": "tests/integration",
    "cg/frames": "tests/frames",
    "cg/tables": "tests/tables",
    "cg/construction/methods": "tests/method",
    "cg/jax": "tests/jax",
}
CHANGES = [  # what is changed to what
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" < ", " <= "), (r" <= ", " < "),
    (r" > ", " >= "), (r" >= ", " > "), (r" == ", " != "), (r"\.and\.", ".or."), (r" and ", " or "),
    (r"\.not\. ", ""), (r"\bnot ", ""), (r"\bmin\(", "max("), (r"\bmax\(", "min("),
    (r"\b0\.5\b", "0.4"), (r"\b1\b", "2"), (r"\b2\b", "3"), (r"\babs\(", "("), (r"\b0\b", "1"),
]  # fmt: skip
_SECONDS = 1800.0  # limit of a run of tests that doesn't end
_FORTRAN_ONLY = {" == ": " /= "}
_PLAIN = re.compile(r"\s*(#|!|\"|'|from |import |use |@|def |class |raise|[\w, ]+::)")


def candidates(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a file that can be changed, with the changed line."""
    found, in_text = [], False
    for number, line in enumerate(path.read_text("utf-8").splitlines()):
        quotes = line.count('"""')
        if in_text or quotes:
            in_text ^= quotes % 2 == 1
            continue
        code = line.split("  #")[0].split(" !")[0]
        if _PLAIN.match(line) or not code.strip() or '"' in code:
            continue
        for pattern, change in CHANGES:
            other = _FORTRAN_ONLY.get(pattern, change) if path.suffix == ".f90" else change
            if match := re.search(pattern, code):
                found.append((number, line[: match.start()] + other + line[match.end() :]))
    return found


def plant(tree: Path, chance: random.Random) -> dict[str, object]:
    """Change one line of a file in a random room, and return what was changed."""
    room = chance.choice(list(ROOMS))
    files = sorted((tree / room).rglob("*.f90" if room.startswith("fortran") else "*.py"))
    path = chance.choice([path for path in files if candidates(path)])
    number, changed = chance.choice(candidates(path))
    lines = path.read_text("utf-8").splitlines()
    error = {"file": str(path.relative_to(tree)), "line": number + 1, "was": lines[number].strip(),
             "is": changed.strip(), "tests": ROOMS[room]}  # fmt: skip
    lines[number] = changed
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return error


def seen_by(tree: Path, python: str, first: str) -> str:
    """Return the first test that fails, or how the build fails; an empty text if none does."""
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    for tests in (["tests/model"], [first], ["tests"]):
        command = [python, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow",
                   "--numprocesses", "auto", *tests]  # fmt: skip
        try:
            run = subprocess.run(
                command, cwd=tree, env=environment, capture_output=True, text=True, check=False,
                timeout=_SECONDS,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "the time"
        if run.returncode:
            failed = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
            return failed[1] if failed else "the build, or the end of the process"
    return ""


def main() -> int:
    """Plant errors, and print how many were seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tree", type=Path, required=True, help="a built clone, which is changed")
    options = parser.parse_args()
    results = ROOT / "build" / "planted.jsonl"
    results.parent.mkdir(exist_ok=True)
    done = len(results.read_text().splitlines()) if results.exists() else 0
    tree = options.tree.resolve()
    for k in range(done, options.number):
        error = plant(tree, random.Random(f"{options.seed} {k}"))
        path = tree / str(error["file"])
        try:
            error["seen"] = seen_by(tree, str(tree / ".venv/bin/python"), str(error["tests"]))
        finally:
            shutil.copy(ROOT / str(error["file"]), path)
        with results.open("a") as file:
            file.write(json.dumps(error) + "\n")
        print(json.dumps(error), flush=True)
    errors = [json.loads(line) for line in results.read_text().splitlines()]
    print(
        f"{sum(bool(error['seen']) for error in errors)} of {len(errors)} planted errors were seen"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
