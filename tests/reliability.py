"""Figures of what was tried to make the package fail: ``make reliability`` writes the page.

It runs the tests about that, counts their cases, and writes ``docs/reliability.md``. What takes
longer is in ``docs/reliability.json`` with the day on which it was run; ``python
tests/reliability.py NAME ...`` runs it again, one of the names in `LONG`. With ``NAME=FOLDER`` it
takes the figures of a run that has written into a folder.
"""

import datetime
import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import Any

from long_runs import EXPLAINED, LONG, Command, figures

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reliability.md"
STORED = ROOT / "docs" / "reliability.json"

ROWS = [  # what is tried, file of tests, which of them
    ("Methods that don't fit into 4 GiB", "test_memory", "4_gib"),
    ("Names that lead out of a folder or are no file names", "test_hostile_text", "names_|folder"),
    ("Numbers beyond reason in arguments and certificates", "test_hostile_text", "numbers"),
    ("Forged certificates, and files that are none", "test_hostile_text", "forged|files|goes_on"),
    ("Searches, proofs and digits in several threads", "test_threads", ""),
    ("Eight threads that do all of it at once", "test_together", ""),
    ("Complex numbers where real ones are wanted", "test_limits", "complex"),
    ("`StopIteration` from the user's function", "test_limits", "stop_iteration|generator"),
    (
        "Deep trees, large orders, wide guesses, full disks",
        "test_limits",
        "deep|order|wide|full|soon",
    ),
    ("Forged, damaged, full and foreign stores", "test_store", ""),
    ("Workers that die, and executors of all kinds", "test_executors", ""),
    ("Tolerances and limits of lmdif", "test_lmdif_tolerances", ""),
    ("Steps of least norm, beside NumPy's", "test_least_norm", ""),
    ("Trees, flat orders and steps, beside kauri, NodePy and Lielab", "test_peers", ""),
    ("Systems that a weaker interval test would prove", "test_krawczyk", "contraction|outside"),
    ("Certificates proved a second, independent way", "test_krawczyk", "proved_a_second"),
    ("Wrong certificates given to the second way", "test_krawczyk", "second_way_refuses"),
]


def cases() -> list[tuple[str, str, bool]]:
    """Run the tests; return file, name and whether it passed of each case."""
    modules = sorted(
        str(next((ROOT / "tests").glob(f"*/{module}.py"))) for module in {row[1] for row in ROWS}
    )
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        options = ["-q", "-m", "not slow or not slow", f"--junitxml={report}"]
        subprocess.run([sys.executable, "-m", "pytest", *options, *modules], cwd=ROOT, check=False)
        found = ET.parse(report).getroot().iter("testcase")
        return [
            (
                next(
                    part for part in case.attrib["classname"].split(".") if part.startswith("test_")
                ),
                case.attrib["name"],
                not [part for part in case if part.tag in ("failure", "error", "skipped")],
            )
            for case in found
        ]


def calls_below_limits() -> tuple[int, int, int]:
    """Return how many compiled calls below limits of memory were done, refused, and neither."""
    sys.path.append(str(ROOT / "tests" / "support"))
    from test_memory import _INTEGRATIONS, _PREPARED, _run

    found = _run(_PREPARED) + _run(_INTEGRATIONS)
    done = sum(line == "done" for line in found)
    refused = sum(line.startswith("MemoryError") for line in found)
    return done, refused, len(found) - done - refused


def short_runs() -> list[str]:
    """Return the lines about what is run each time."""
    lines = ["| tried | tests | cases | not as wanted |", "|---|---|---:|---:|"]
    found = cases()
    for heading, module, pattern in ROWS:
        own = [ok for file, name, ok in found if file == module and re.search(pattern, name)]
        lines.append(f"| {heading} | `{module}.py` | {len(own)} | {own.count(False)} |")
    done, refused, ended = calls_below_limits()
    return [
        *lines,
        "",
        f"Of {done + refused + ended} compiled calls and integrations below rising limits of",
        f"memory, {done} were done, {refused} were refused with a `MemoryError`, and {ended} ended",
        "the process.",
    ]


def planted(run: dict[str, Any]) -> list[str]:
    """Return the lines about errors that were planted in the compiled core."""
    caught = sum(error["outcome"] == "caught" for error in run["errors"])
    lines = [
        "## Errors planted in the compiled core",
        "",
        "`tools/plant_errors.py` has a list of wrong lines and puts one at a time into a copy of",
        f"`fortran/`. Of the {len(run['errors'])} that were run ({run['date']}) {caught} were",
        "caught by tests that",
        "`make test` runs, none of which needs libminpack.",
        "",
        "| error | in | caught by |",
        "|---|---|---|",
    ]
    for error in run["errors"]:
        test = f"`{error['by'].partition('[')[0]}`" if error["by"] else error["outcome"]
        lines.append(f"| {error['what']} | `{error['file']}` | {test} |")
    return lines


def explained(mutant: dict[str, str]) -> tuple[str, str]:
    """Return what became of a mutant that survived, and why."""
    key = mutant["module"], mutant["code"], mutant["change"]
    return EXPLAINED.get(key, ("open", "open"))


def mutants(run: dict[str, Any]) -> list[str]:
    """Return the lines about mutants of Python modules."""
    total = Counter(mutant["outcome"] for mutant in run["mutants"])
    killed = sum(count for outcome, count in total.items() if outcome.startswith("killed"))
    lines = [
        "## Mutants of Python modules",
        "",
        "`tools/mutate.py` changes one operator, constant or statement of a module at a time: a",
        f"sample with a fixed seed, of which {sum(total.values())} were run ({run['date']}). "
        f"{killed} were killed,",
        f"{total['killed by the limit of time']} of them by the limit of time.",
        "",
        "| module | mutants | killed | killed by a test since | no difference | open |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    modules: dict[str, list[dict[str, Any]]] = {}
    for mutant in run["mutants"]:
        modules.setdefault(mutant["module"], []).append(mutant)
    notes = []
    for module, own in sorted(modules.items()):
        left = [mutant for mutant in own if mutant["outcome"] == "survived"]
        counts = Counter(explained(mutant)[0] for mutant in left)
        lines.append(
            f"| `{module}` | {len(own)} | {len(own) - len(left)} | {counts['since']} "
            f"| {counts['same']} | {counts['open']} |"
        )
        for mutant in left:
            why = explained(mutant)[1]
            notes.append(f"- `{module}`, `{mutant['change']}` in `{mutant['code']}`: {why}.")
    return [*lines, "", "Those that survived:", "", *notes]


def long_runs(stored: dict[str, Any]) -> list[str]:
    """Return the lines about what was run once."""
    lines = ["| tried | by | cases | what was found | run on |", "|---|---|---:|---|---|"]
    for name, (heading, tests, _) in LONG.items():
        run = stored.get(name, {"cases": "", "found": "not run yet", "date": ""})
        if "cases" in run:
            row = (heading, tests, run["cases"], run["found"], run["date"])
            lines.append(f"| {' | '.join(map(str, row))} |")
    return lines


def page() -> str:
    """Return the text of the page."""
    stored = json.loads(STORED.read_text("utf-8"))
    lines = [
        "# Reliability",
        "",
        "What was tried to make the package fail, and what became of it. `make reliability` writes",
        "this page; it runs the tests that are named, each of which asks for a clear error or the",
        "right result.",
        "",
        *short_runs(),
        "",
        "## What takes longer",
        "",
        "`python tests/reliability.py NAME` runs these again, each with its own name: "
        + ", ".join(f"`{name}`" for name in LONG)
        + ".",
        "",
        *long_runs(stored),
    ]
    if "planted" in stored:
        lines += ["", *planted(stored["planted"])]
    if "mutants" in stored:
        lines += ["", *mutants(stored["mutants"])]
    return "\n".join(lines) + "\n"


def run(command: Command, folder: str) -> None:
    """Run one of the commands that take long; it writes into a folder."""
    values = {"folder": folder, "python": sys.executable}
    variables = {name: value.format(**values) for name, value in command.variables}
    arguments = [word.format(**values) for word in command.words]
    subprocess.run(arguments, cwd=ROOT, env={**os.environ, **variables}, check=False)


def run_again(names: list[str]) -> None:
    """Run what takes long, or take what was written into a folder; keep its figures."""
    stored = json.loads(STORED.read_text("utf-8")) if STORED.exists() else {}
    for argument in names:
        name, _, written = argument.partition("=")
        with tempfile.TemporaryDirectory() as made:
            folder = written or made
            if not written:
                run(LONG[name][2], folder)
            stored[name] = {
                "date": datetime.date.today().isoformat(),
                **figures(name, Path(folder)),
            }
        STORED.write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    if sys.argv[1:]:
        run_again(sys.argv[1:])
    PAGE.write_text(page(), encoding="utf-8")
