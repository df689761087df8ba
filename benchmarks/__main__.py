"""Run benchmarks: ``python -m benchmarks [NAME …] [--quick]``."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

from threadpoolctl import threadpool_limits

from . import page
from .environment import describe
from .record import Result

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"

NAMES = ("rivals", "calls", "directions", "estimates", "kinks", "search")
"""All benchmarks in the order of the page, each a module with ``run(quick)``."""


def main(arguments: list[str] | None = None) -> int:
    """Run the named benchmarks, and write the page and the numbers."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"one of {', '.join(NAMES)}; all by default"
    )
    parser.add_argument("--quick", action="store_true", help="fewer measurements; writes no files")
    parsed = parser.parse_args(arguments)
    for name in parsed.names:
        if name not in NAMES:
            parser.error(f"NAME must be one of {', '.join(NAMES)}, got {name!r}")
    file = HERE / "results.json"
    results, environments = page.read(file)
    # before threadpool_limits, which affects loaded libraries only
    modules = {
        name: importlib.import_module(f"benchmarks.{name}") for name in parsed.names or NAMES
    }
    with threadpool_limits(1):
        for name, module in modules.items():
            print(f"{name} …", file=sys.stderr, flush=True)
            result: Result = module.run(parsed.quick)
            results[name], environments[name] = result, describe()
            print(page.render({name: result}, environments).split("\n\n", 2)[2])
    if not parsed.quick:
        results = {name: results[name] for name in NAMES if name in results}
        page.write(results, environments, file)
        if "estimates" in modules:
            modules["estimates"].write_table(results["estimates"], DOCS / "catalogue.md")
        (DOCS / "benchmarks.md").write_text(page.render(results, environments), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
