"""What takes long to run of `reliability.py`: the commands, their figures, and survivors."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple


class Command(NamedTuple):
    """Words of a command and variables of its environment; {folder} is where it writes."""

    words: tuple[str, ...]
    variables: tuple[tuple[str, str], ...] = ()


def _tests(*words: str, **variables: str) -> Command:
    fixed = ("{python}", "-m", "pytest", "-q", "--junitxml={folder}/report.xml")
    return Command((*fixed, *words), tuple(variables.items()))


FUZZ, KILLS, ENGINE_KILLS = 20, 67, 50
LONG: dict[str, tuple[str, str, Command]] = {
    "differential": (
        "Random tableaux and trees of points, explicit and implicit, orders 1 to 7: the compiled "
        "core in both kinds against exact arithmetic",
        "`test_differential.py`",
        _tests("-m", "slow", "tests/conditions/test_differential.py"),
    ),
    "fuzz": (
        "Spoilt files of methods, certificates and stores; functions that raise or return "
        "something else at any call; hostile arguments of everything public",
        "`test_fuzz_*.py`",
        _tests(
            "tests/package/test_fuzz_readers.py",
            "tests/package/test_fuzz_callbacks.py",
            "tests/package/test_fuzz_arguments.py",
            "--hypothesis-profile=nightly",
            CG_FUZZ=str(FUZZ),
        ),
    ),
    "kills": (
        "Searches, constructions and reproductions killed at random moments",
        "`test_kills.py`",
        _tests(
            "tests/runs/test_kills.py", CG_KILLS=str(KILLS), CG_KILLS_REPORT="{folder}/kills.jsonl"
        ),
    ),
    "engines": (
        "Searches in processes and on Dask: the run, a worker or the scheduler killed at random "
        "moments",
        "`test_kills_engines.py`",
        _tests("tests/runs/test_kills_engines.py", CG_KILLS=str(ENGINE_KILLS)),
    ),
    "together": (
        "Eight threads, and eight processes by fork, spawn and forkserver",
        "`test_together.py`",
        _tests("tests/package/test_together.py"),
    ),
    "sanitizers": (
        "The compiled core with the sanitizers of addresses and undefined behaviour",
        "`make test-sanitize`",
        Command(("make", "test-sanitize", "ARGS=--junitxml={folder}/report.xml")),
    ),
    "checks": (
        "The compiled core with run-time checks and floating-point traps",
        "`make test-checks`",
        Command(("make", "test-checks", "ARGS=--junitxml={folder}/report.xml")),
    ),
    "oldest": (
        "The suite with the oldest versions of packages that are admitted",
        "`make test-oldest`",
        Command(("make", "test-oldest", "ARGS=--junitxml={folder}/report.xml")),
    ),
    "planted": (
        "Errors in Fortran",
        "`tools/plant_errors.py`",
        Command(("{python}", "tools/plant_errors.py", "--output", "{folder}/planted.jsonl")),
    ),
    "mutants": (
        "Mutants of Python modules",
        "`tools/mutate.py`",
        Command(
            ("{python}", "tools/mutate.py", "--sample", "12", "--output", "{folder}/mutants.jsonl")
        ),
    ),
}

# How many cases a test stands for
PER_TEST = {"differential": 1000, "kills": KILLS, "engines": ENGINE_KILLS}
TEXTS = 150 + 80 + 150 + 100 + 40 + 150 + 80 + 30 + 300  # of one round of fuzzing


def figures(name: str, folder: Path) -> dict[str, Any]:
    """Return the figures of what a command has written."""
    if name in ("planted", "mutants"):
        lines = (folder / f"{name}.jsonl").read_text("utf-8").splitlines()
        return {"errors" if name == "planted" else "mutants": list(map(json.loads, lines))}
    every = ET.parse(folder / "report.xml").getroot().iter("testcase")
    found = [case for case in every if not any(part.tag == "skipped" for part in case)]
    failed = sum(any(part.tag in ("failure", "error") for part in case) for case in found)
    number = TEXTS * FUZZ if name == "fuzz" else len(found) * PER_TEST.get(name, 1)
    return {"cases": number, "found": f"{failed} tests fail" if failed else "all as wanted"}


# Mutants that survived, by module, line and change: "since" where a test was written that kills
# them, "same" where nothing is different
EQUALITY = ("same", "the class has its own `__eq__` and `__hash__`")
FROZEN = ("since", "nobody tried to change a value; `test_values.py` does")
EXPLAINED = {
    ("cg.trees.ordered", "@dataclass(frozen=True, eq=False)", "False → True"): EQUALITY,
    ("cg.structure.points", "@dataclass(frozen=True, eq=False)", "False → True"): EQUALITY,
    (
        "cg.method.tableau",
        "@dataclass(frozen=True, init=False, eq=False, repr=False)",
        "False → True",
    ): EQUALITY,
    ("cg.proofs.certificate", "@dataclass(frozen=True)", "True → False"): FROZEN,
    ("cg.proofs.krawczyk", "@dataclass(frozen=True)", "True → False"): FROZEN,
    ("cg.proofs.systems", "@dataclass(frozen=True)", "True → False"): FROZEN,
    (
        "cg.proofs.systems",
        "for value, word in zip(found, words, strict=True)",
        "True → False",
    ): ("same", "both sequences are made of the same words"),
    (
        "cg.conditions.counts",
        "of_size = [0] * (order + 1)  # Σ d t_d over the divisors d of each k",
        "1 → 2",
    ): ("same", "a list is one longer than what is read of it"),
    ("cg.structure.points", "continue", "continue → break"): (
        "same",
        "only the last of two results may be missing",
    ),
    (
        "cg.method.tableau",
        'labels = [f"a_{i}{separator}{j}" for j in range(1, stages + 1)]',
        "1 → 2",
    ): ("same", "of the end of a range: one label more than there are entries"),
}
