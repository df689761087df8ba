"""Plant errors in a copy of the tree, and say which of them the tests see.

``python tools/plant_errors.py plant`` changes operators, constants and conditions in
``build/planted``, a clone, in Python and Fortran. All errors are planted at once, each behind a
switch, so that one build serves all. ``see`` collects tests, and runs each of them in a child of
its own, which notes the errors that it passes; then again with each of these that no test has seen
yet, until it fails. Results are appended to ``build/planted/seen.jsonl``, so that it may be stopped
at any time; ``show`` prints them. An error without effect counts as unseen; read those.
"""

import argparse
import ast
import ctypes
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing import Pipe
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from _pytest.warnings import catch_warnings_for_item

ROOT = Path(__file__).parent.parent
TREE = ROOT / "build" / "planted"
ROOMS = (
    "cg/integration", "cg/integration", "cg/frames", "cg/jax", "cg/tables",
    "cg/construction/methods", "cg/construction/conditions", "cg/construction/lifting",
    "cg/construction/proofs", "cg/construction/search", "cg/construction/solvers",
    "cg/construction",
    "fortran/steps", "fortran/steps", "fortran/steps", "fortran/steps", "fortran/frames",
    "fortran/frames", "fortran/frames", "fortran/interface", "fortran/runs",
    "fortran/conditions", "fortran/support",
)  # fmt: skip
_UNSWITCHED = ("__init__", "trees", "wrap", "api")  # the build runs them, or f2py reads them

# Cases of a test that are run, and those that are run with one error
_CASES, _TRIES = 3, 2
_IDLE = 100  # seconds without work of its own after which a child is ended

SWITCH = {
    "cg/_planted.py": '''"""Which errors act."""

ACTIVE, PASSED = set(), set()


def _acts(number):
    """Return whether an error acts, and note that it is passed."""
    PASSED.add(number)
    return number in ACTIVE
''',
    "fortran/support/planting.c": """__attribute__((visibility("default"))) char cg_passed[4096];
__attribute__((visibility("default"))) char cg_active[4096];
int cg_planted(int k)
{
    cg_passed[k] = 1;
    return cg_active[k];
}
""",
    "fortran/support/planting.f90": """module planting
  implicit none
  interface
    pure logical function planted(k) bind(c, name="cg_planted")
      integer, value :: k
    end function planted
  end interface
end module planting
""",
}

BUILD = (
    ("meson.build", "'-frecursive',", "'-frecursive', '-ffree-line-length-none',"),
    ("fortran/meson.build", "sources = files(",
     "sources = files('support/planting.c', 'support/planting.f90',"),
)  # fmt: skip

# What is changed in statements of one line without texts. Compilers refuse other bounds of fixed
# parts of arrays, and another 2 of size(x, 2).
_BOTH = (
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" / ", " * "), (r" < ", " <= "),
    (r" <= ", " < "), (r" > ", " >= "), (r" >= ", " > "), (r"\bmin\(", "max("),
    (r"\bmax\(", "min("), (r"(?<![.\w])abs\(", "("),
)  # fmt: skip
_CHANGES = {
    ".py": (
        (r" == ", " != "), (r" != ", " == "), (r" and ", " or "), (r" or ", " and "),
        (r"\bnot (?!in\b)", ""), (r" is not ", " is "), (r" is (?!not)", " is not "),
        (r" not in ", " in "), (r"\bany\(", "all("), (r"\ball\(", "any("), (r" @ ", " * "),
        (r"\b1\b(?!\.)", "2"), (r"\b2\b(?!\.)", "3"), (r"\bTrue\b", "False"),
        (r"\bFalse\b", "True"), (r"\b0\.5\b", "0.4"),
    ),
    ".f90": (
        (r" == ", " /= "), (r" /= ", " == "), (r"\.and\.", ".or."), (r"\.or\.", ".and."),
        (r"\.not\. ", ""), (r"\b0\.5_wp", "0.4_wp"), (r"\b0\.0_wp", "1.0_wp"),
        (r"(?<!:)\b1\b(?![.:])", "2"), (r"(?<!:)\b2\b(?![.:)])", "3"), (r"\.true\.", ".false."),
        (r"\.false\.", ".true."),
    ),
}  # fmt: skip
_CONDITION = re.compile(r"((?:else ?|el)?if) \(?(.*?)\)?(:| then)$")


@dataclass
class Error:
    """A statement and what it is changed to."""

    file: str
    line: int
    was: str
    changed: str


def statements(path: Path) -> set[int]:
    """Return the lines of a file that are whole statements of procedures."""
    text, found = path.read_text("utf-8"), set[int]()
    if path.suffix == ".py":
        for function in ast.walk(ast.parse(text)):
            if isinstance(function, ast.FunctionDef):
                for node in ast.walk(function):
                    whole = node.test if isinstance(node, ast.If) else node
                    if isinstance(node, (ast.Assign, ast.AugAssign, ast.Return, ast.If)):
                        found |= {node.lineno} & {whole.end_lineno}
        return found
    within, continued, masked = False, False, False
    for number, line in enumerate(text.splitlines(), 1):
        code = re.sub(r"\s*!.*", "", line)
        whole_line, continued = not continued and not code.endswith("&"), code.endswith("&")
        within |= code.strip() == "contains"
        masked = not code.strip().startswith("end where") and (
            masked or bool(re.match(r"\s*(else)?where \(.*\)$", code))
        )
        pattern = r"\s*((else )?if \(.*|[\w%]+(\([^=]*\))? = .*|call .*)$"
        if within and whole_line and not masked and re.match(pattern, code):
            found.add(number)
    return found


def errors_of(path: Path) -> list[Error]:
    """Return the errors that can be planted in a file."""
    found, lines = [], path.read_text("utf-8").splitlines()
    for number in sorted(statements(path)):
        code = re.sub(r"\s*[!#].*" if path.suffix == ".f90" else r"\s*#.*", "", lines[number - 1])
        if "'" in code or '"' in code:
            continue
        for pattern, change in (*_BOTH, *_CHANGES[path.suffix]):
            for match in re.finditer(pattern, code):
                other = code[: match.start()] + change + code[match.end() :]
                found.append(Error(str(path), number, code.strip(), other.strip()))
    return found


def switched(error: Error, k: int, indent: str) -> str:
    """Return the statement with the error and without, and a switch between them."""
    python = error.file.endswith(".py")
    condition = re.compile(r"((?:el)?if) (.*):$" if python else r"((?:else )?if) \((.*)\) then$")
    was, changed = condition.match(error.was), condition.match(error.changed)
    if was and changed and python:
        return f"{was[1]} (({changed[2]}) if _acts({k}) else ({was[2]})):"
    if was and changed:
        planted = f"(planted({k}) .and. ({changed[2]})) .or. (.not. planted({k}) .and. ({was[2]}))"
        return f"{was[1]} ({planted}) then"
    if python:
        return f"if _acts({k}): {error.changed}\n{indent}else: {error.was}"
    return f"if (planted({k})) then; {error.changed}; else; {error.was}; end if"


def drawn(number: int, seed: int, chosen: Path | None) -> list[Error]:
    """Return errors: those of a file of lines ``[file, line, was, changed]``, others by chance."""
    chance, errors = random.Random(seed), dict[tuple[str, int], Error]()
    every = {
        path: errors_of(path)
        for room in ROOMS
        for path in sorted((TREE / room).rglob("*.*"))
        if path.suffix in _CHANGES and not path.name.startswith(_UNSWITCHED)
    }
    for file, *given in json.loads(chosen.read_text()) if chosen else []:
        error = Error(str(TREE / file), *given)
        if error not in every[TREE / file] or (error.file, error.line) in errors:
            raise SystemExit(f"{file} has no {error.was} to change, or another error is there")
        errors[error.file, error.line] = error
    while len(errors) < number:
        room = TREE / chance.choice(ROOMS)
        files = [path for path in every if room in path.parents and every[path]]
        error = chance.choice(every[chance.choice(files)])
        errors.setdefault((error.file, error.line), error)
    return [*errors.values()]


def plant(errors: list[Error]) -> None:
    """Change the files of a copy of the tree, and its build."""
    for file in {error.file for error in errors}:
        lines = Path(file).read_text("utf-8").splitlines()
        for k, error in enumerate(errors):
            if error.file == file:
                old = lines[error.line - 1]
                indent = old[: len(old) - len(old.lstrip())]
                lines[error.line - 1] = indent + switched(error, k, indent)
        if file.endswith(".py"):  # in front of the first import, not of words of a text
            place = r"^(?=from (?!__)[\w.]+ import |import )"
            use = "from cg._planted import _acts\n"
        else:
            place, use = r"^(module \w+)$", r"\1\n  use planting, only: planted"
        text = re.sub(place, use, "\n".join(lines) + "\n", count=1, flags=re.M)
        Path(file).write_text(text, "utf-8")
    for file, text in SWITCH.items():
        (TREE / file).write_text(text)
    for file, was, changed in BUILD:
        text = (TREE / file).read_text()
        (TREE / file).write_text(text.replace(was, changed, 1))
    for error in errors:
        error.file = str(Path(error.file).relative_to(TREE))
    (TREE / "errors.json").write_text(json.dumps([asdict(error) for error in errors], indent=1))


class Watcher:
    """Runs each test alone, then with the errors that it passes and none has seen."""

    def __init__(self, share: int, shares: int) -> None:
        from cg import _core_r64, _planted

        self.share, self.shares, self.python = share, shares, _planted
        library = ctypes.CDLL(_core_r64.__file__)
        numbers = ctypes.c_char * 4096
        self.passed, self.active = (
            numbers.in_dll(library, f"cg_{n}") for n in ("passed", "active")
        )
        self.results, self.tried = TREE / "seen.jsonl", Counter[str]()

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the tests in a mixed order, so that whatever time there is says something."""
        items = [item for item in session.items if not item.get_closest_marker("slow")]
        items = items[self.share :: self.shares]
        random.shuffle(items)
        drawn: Counter[str] = Counter()
        for item in (item for item in items if self.counted(drawn, item) <= _CASES):
            passed, seconds = self.run(item, [], 60.0)
            self.note([item.nodeid, -2 if isinstance(passed, list) else -1, passed, seconds])
            if isinstance(passed, list):
                left = set(passed) - {line[1] for line in self.lines()}
                left = {k for k in left if self.counted(self.tried, item, k) <= _TRIES}
                self.search(item, sorted(left), 5.0 + 8.0 * seconds)
        return True

    def search(self, item: pytest.Item, errors: list[int], limit: float) -> None:
        """Note which of some errors a test sees: all of them act, then halves if it fails."""
        outcome = self.run(item, errors, limit)[0] if errors else []
        if isinstance(outcome, list):
            return
        if len(errors) == 1:
            self.note([item.nodeid, errors[0], outcome, limit])
            return
        for half in (errors[: len(errors) // 2], errors[len(errors) // 2 :]):
            self.search(item, half, limit)

    @staticmethod
    def counted(count: Counter[str], item: pytest.Item, k: int = -1) -> int:
        """Count a case of a test, and return how many there were."""
        key = f"{item.nodeid.split('[')[0]} {k}"
        count[key] += 1
        return count[key]

    def lines(self) -> list[list[object]]:
        """Return what was noted: tests, errors that they see, and how."""
        text = self.results.read_text() if self.results.exists() else ""
        return [json.loads(line) for line in text.splitlines()]

    def note(self, line: list[object]) -> None:
        """Append a result."""
        with self.results.open("a") as file:
            file.write(json.dumps(line) + "\n")

    def run(self, item: pytest.Item, errors: list[int], limit: float) -> tuple[object, float]:
        """Run a test in a child with errors; return what it passes, or how it fails."""
        ahead, behind = Pipe(duplex=False)
        child = os.fork()
        if child == 0:
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2))
            self.python.PASSED.clear()
            ctypes.memset(self.passed, 0, len(self.passed))
            self.python.ACTIVE.update(errors)
            for k in errors:
                self.active[k] = 1
            given = {"config": item.config, "ihook": item.ihook, "when": "runtest", "item": item}
            with catch_warnings_for_item(**given):
                reports = runtestprotocol(item, nextitem=None, log=False)
            failed = [r for r in reports if r.failed]
            passed = self.python.PASSED | {i for i, flag in enumerate(self.passed.raw) if flag}
            result = str(failed[0].longrepr)[-300:] if failed else sorted(passed)
            behind.send((result, time.process_time()))
            os._exit(0)
        behind.close()
        outcome: tuple[object, float] = "the time, or the end of the process", limit
        with ahead, suppress(EOFError):
            used, idle = "", 0
            while idle < _IDLE:  # a child may wait for a thread that wasn't forked
                if ahead.poll(1.0):
                    outcome = ahead.recv()
                    break
                now = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13]
                used, idle = str(now), idle + 1 if str(now) == used else 0
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return outcome


def main() -> int:
    """Run a part of the work."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("plant", "see", "show"))
    parser.add_argument("tests", nargs="*", default=["tests"])
    parser.add_argument("--number", type=int, default=160)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--chosen", type=Path, help="JSON: list of [file, line, text, other text]")
    parser.add_argument("--share", default="0/1", help="1/2 is the second half of the tests")
    options = parser.parse_args()
    if options.part == "plant":
        shutil.rmtree(TREE, ignore_errors=True)
        subprocess.run(["git", "clone", "--quiet", ROOT, TREE], check=True)
        plant(drawn(options.number, options.seed, options.chosen))
    elif options.part == "see":
        watcher = Watcher(*map(int, options.share.split("/")))
        arguments = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", *options.tests]
        arguments += ["--continue-on-collection-errors"]
        return int(pytest.main(arguments, plugins=[watcher]))
    else:
        show()
    return 0


def show() -> None:
    """Print the errors, and which test saw each first."""
    lines = [json.loads(line) for line in (TREE / "seen.jsonl").read_text().splitlines()]
    seen = {k: test for test, k, *_ in reversed(lines) if k >= 0}
    passed = Counter(k for _, mark, errors, _ in lines if mark == -2 for k in errors)
    errors = json.loads((TREE / "errors.json").read_text())
    for k, error in enumerate(errors):
        print(f"{k} {error['file']}:{error['line']}: {' '.join(error['was'].split())} -> "
              f"{' '.join(error['changed'].split())}")  # fmt: skip
        print(f"    {seen.get(k, f'UNSEEN, passed by {passed[k]} tests')}")
    print(f"{len(seen)} of {len(errors)} errors were seen")


if __name__ == "__main__":
    sys.exit(main())
