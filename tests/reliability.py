"""Figures of what was tried to make the package fail: ``make reliability`` writes the page.

It runs the tests about that, counts their cases, and writes ``docs/reliability.md``.
"""

import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reliability.md"

ROWS = [  # what is tried, file of tests, which of them
    ("Methods that don't fit into 4 GiB", "test_memory", "4_gib"),
    ("Names that lead out of a folder or are no file names", "test_hostile_text", "names_|folder"),
    ("Numbers beyond reason in arguments and certificates", "test_hostile_text", "numbers"),
    ("Forged certificates, and files that are none", "test_hostile_text", "forged|files|goes_on"),
    ("Searches, proofs and digits in several threads", "test_threads", ""),
    ("Complex numbers where real ones are wanted", "test_limits", "complex"),
    ("`StopIteration` from the user's function", "test_limits", "stop_iteration|generator"),
    (
        "Deep trees, large orders, wide guesses, full disks",
        "test_limits",
        "deep|order|wide|full|soon",
    ),
    ("Forged, damaged, full and foreign stores", "test_store", ""),
    ("Workers that die, and executors of all kinds", "test_executors", "Death|any_executor"),
    ("Systems that a weaker interval test would prove", "test_krawczyk", "contraction|outside"),
    ("Certificates proved a second, independent way", "test_krawczyk", "proved_a_second"),
    ("Wrong certificates given to the second way", "test_krawczyk", "second_way_refuses"),
]


def cases() -> list[tuple[str, str, bool]]:
    """Run the tests; return file, name and whether it passed of each case."""
    modules = sorted({f"tests/{module}.py" for _, module, _ in ROWS})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}", *modules]
        subprocess.run(command, cwd=ROOT, check=False)
        found = ET.parse(report).getroot().iter("testcase")
        return [
            (
                case.attrib["classname"].rpartition(".")[2],
                case.attrib["name"],
                not [part for part in case if part.tag in ("failure", "error", "skipped")],
            )
            for case in found
        ]


def calls_below_limits() -> tuple[int, int, int]:
    """Return how many compiled calls below limits of memory were done, refused, and neither."""
    from test_memory import _INTEGRATIONS, _PREPARED, _run

    found = _run(_PREPARED) + _run(_INTEGRATIONS)
    done = sum(line == "done" for line in found)
    refused = sum(line.startswith("MemoryError") for line in found)
    return done, refused, len(found) - done - refused


def page() -> str:
    """Return the text of the page."""
    done, refused, ended = calls_below_limits()
    lines = [
        "# Reliability",
        "",
        "What was tried to make the package fail, and what became of it. `make reliability` writes",
        "this page; it runs the tests that are named, each of which asks for a clear error or the",
        "right result.",
        "",
        "| tried | tests | cases | not as wanted |",
        "|---|---|---:|---:|",
    ]
    found = cases()
    for heading, module, pattern in ROWS:
        own = [ok for file, name, ok in found if file == module and re.search(pattern, name)]
        lines.append(f"| {heading} | `{module}.py` | {len(own)} | {own.count(False)} |")
    lines += [
        "",
        f"Of {done + refused + ended} compiled calls and integrations below rising limits of",
        f"memory, {done} were done, {refused} were refused with a `MemoryError`, and {ended} ended",
        "the process.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
