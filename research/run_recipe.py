"""Run recipes of methods of the catalogue again, and compare the results with the methods.

    python research/run_recipe.py [NAME ...]

The key ``recipe`` in the file of a method says how this project found it: as text, or as a table
with one entry, a function of `cg` with its arguments, such as ``{search = {order = 3, ...}}``. Of
`cg.lift`, the flat tableau is that of the method. The method in the catalogue may have moved on
from there, as its ``source`` says; the result agrees with it if it has the same order, stages and
flows, and a principal error that is at most 1.5 times as large. By default all recipes run, which
takes hours.
"""

import sys
import time
import tomllib
from fractions import Fraction
from importlib.resources import files
from typing import Any

import cg
from cg.construction.methods.method import Method

FOLDER = files("cg.construction.catalogue")
MARGIN = 1.5  # factor of principal errors: minima are local, and goals differ
ROUNDING = Fraction(1, 10**30)  # error of the sums of rows, which are rational


def recipes() -> dict[str, Any]:
    """Return the recipes of the catalogue by the names of methods."""
    entries = {
        file.name.removesuffix(".toml"): tomllib.loads(file.read_text(encoding="utf-8"))
        for file in FOLDER.iterdir()
        if file.name.endswith(".toml")
    }
    return {name: entries[name]["recipe"] for name in cg.methods if "recipe" in entries[name]}


def flat(method: Method) -> cg.Tableau:
    """Return the flat tableau of a lifted method, whose entries are rational."""

    def exact(x: Fraction) -> Fraction:
        near = x.limit_denominator(10**8)
        return near if abs(near - x) < ROUNDING else x

    a, b = method.exact
    second = method.exact_embedded
    return cg.Tableau(
        [list(map(exact, row)) for row in a],
        list(map(exact, b)),
        b_embedded=None if second is None else list(map(exact, second)),
    )


def run(name: str, recipe: dict[str, dict[str, Any]]) -> Method | None:
    """Return the method that a recipe finds, None if it finds none."""
    ((call, arguments),) = recipe.items()
    if call == "search":
        return next(iter(cg.search(**arguments).methods), None)
    if call == "construct":
        return cg.construct(**arguments).method
    if call == "lift":
        return cg.lift(flat(cg.methods[name]), **arguments).method
    raise ValueError(f"the recipe of {name} must be search, construct or lift, got {call!r}")


def facts(method: Method) -> tuple[int, int, int]:
    """Return order, stages that flows use, and flows."""
    used = {stage for point in method.points for stage in point.weights}
    return method.order, len(used), method.exponentials


def agrees(name: str, result: Method | None) -> bool:
    """Print how a result compares with the method of the catalogue; return whether it agrees."""
    method = cg.methods[name]
    if result is None:
        print(f"{name}: nothing found")
        return False
    good = facts(result) == facts(method)
    good &= result.principal_error <= MARGIN * method.principal_error
    print(
        f"{name}: (order, stages, flows) {facts(result)} of {facts(method)}, principal error "
        f"{result.principal_error:.4g} of {method.principal_error:.4g}"
    )
    return good


def main() -> int:
    """Run the recipes named on the command line."""
    known = recipes()
    names = sys.argv[1:] or list(known)
    if unknown := sorted(set(names) - set(known)):
        raise SystemExit(f"no recipe for {', '.join(unknown)}; there are {', '.join(known)}")
    different = []
    for name in names:
        if isinstance(known[name], str):
            print(f"{name}: {known[name]}")
            continue
        begin = time.monotonic()
        if not agrees(name, run(name, known[name])):
            different.append(name)
        print(f"    {time.monotonic() - begin:.0f} s", flush=True)
    if different:
        print(f"different: {', '.join(different)}")
    return bool(different)


if __name__ == "__main__":
    raise SystemExit(main())
