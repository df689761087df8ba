"""Run benchmarks: ``python -m benchmarks [NAME …] [--quick] [--case NAME]``."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

from threadpoolctl import threadpool_limits

from . import page
from .cases import NAMES as CASES
from .environment import describe
from .record import Result

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"

NAMES = (
    "rivals", "bodies", "jax", "steps", "calls", "ensemble", "large", "variational", "stiff",
    "estimates", "search", "linear", "long_times",
)  # fmt: skip
"""All benchmarks in the order of the page, each a module with ``run(quick, figures)``."""


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    """Return the checked arguments of the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"one of {', '.join(NAMES)}; all by default"
    )
    parser.add_argument("--quick", action="store_true", help="fewer measurements; writes no files")
    parser.add_argument(
        "--case", action="append", choices=CASES, default=[],
        help="run rivals on this problem only (may be repeated); writes no files",
    )  # fmt: skip
    parsed = parser.parse_args(arguments)
    if parsed.case and parsed.names != ["rivals"]:
        parser.error(f"--case needs the benchmark rivals alone, got {parsed.names}")
    for name in parsed.names:
        if name not in NAMES:
            parser.error(f"NAME must be one of {', '.join(NAMES)}, got {name!r}")
    return parsed


def main(arguments: list[str] | None = None) -> int:
    """Run the named benchmarks, and write the pages and the numbers."""
    parsed = _parse(arguments)
    file = HERE / "results.json"
    storing = not parsed.quick and not parsed.case
    results = page.read(file) if storing else {}
    environments = page.read_environments(file) if storing else {}
    environment = describe()
    names = parsed.names or NAMES
    # before threadpool_limits, which affects loaded libraries only
    modules = {name: importlib.import_module(f"benchmarks.{name}") for name in names}
    with threadpool_limits(1):
        for name, module in modules.items():
            print(f"{name} …", file=sys.stderr, flush=True)
            options = {"only": parsed.case} if parsed.case else {}
            result: Result = module.run(parsed.quick, DOCS if storing else None, **options)
            results[name] = result
            environments[name] = environment
            shown = page.render({name: result}, {name: environment})
            print(shown.split("\n\n", 2)[2])
            if result.details is not None:
                print(page.render_details({name: result}))
    ordered = {name: results[name] for name in NAMES if name in results}
    if storing:
        page.write(ordered, environments, file)
        for name, place in (("estimates", "catalogue.md"), ("long_times", "howto/long_times.md")):
            if name in modules:
                modules[name].write_table(results[name], DOCS / place)
        page.write_pages(ordered, environments, DOCS)
    return 0


if __name__ == "__main__":
    sys.exit(main())
