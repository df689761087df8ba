"""``search`` and ``construct``: each argument of the functions is an option."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click import Option

from cg.command.arguments import NEGATIVE, check_output, json_option, print_json, print_text
from cg.construction.catalogue import dumps, resolve_method, save
from cg.construction.formats import export
from cg.construction.layouts import Rows
from cg.construction.methods.method import Method
from cg.construction.search.construct import construct
from cg.construction.search.random_search import search
from cg.construction.search.requirements import OBJECTIVES
from cg.construction.search.settings import ALGORITHMS
from cg.construction.solvers.system import Structure
from cg.support.parallel import has_bars


def _held(
    context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> dict[str, str] | None:
    """Return values by name."""
    held = dict(text.split("=", 1) for text in texts if "=" in text)
    if len(held) < len(texts):
        raise click.BadParameter(f"give NAME=VALUE, once for each name, not {' '.join(texts)}")
    return held or None


def _bound(
    context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> float | dict[str, list[float | None]] | None:
    """Return a bound on all magnitudes, or intervals by name, whose ends may be None."""
    try:
        if len(texts) == 1 and "=" not in texts[0]:
            return float(texts[0])
        intervals = dict(text.split("=", 1) for text in texts)
        ends = {name: interval.split(":") for name, interval in intervals.items()}
        bounds = {name: [float(x) if x else None for x in pair] for name, pair in ends.items()}
    except ValueError:
        bounds = {}
    if len(bounds) < len(texts):
        raise click.BadParameter("give one number, or NAME=LOWER:UPPER, once for each name")
    return bounds or None


_SHARED = (
    Option(["--order"], type=int, required=True, help="Order of the methods."),
    Option(["--stages"], type=int, help="Evaluations in a step; by default those of --tree."),
    Option(["--flows"], type=int, help="Flows of commutator-free methods with random trees."),
    Option(["--tree"], metavar="NAME|FILE", help="Methods with the tree of points of a method."),
    Option(["--embedded"], is_flag=True, help="Pairs, with a second result."),
    Option(["--first-same-as-last"], is_flag=True, help="The last stage is at the result."),
    Option(["--hold"], multiple=True, callback=_held, metavar="NAME=VALUE",
           help="Prescribed coefficient or abscissa, such as a[2,1]=1/2 or c[3]=1."),
    Option(["--abscissae"], type=float, nargs=2, help="Ends of the interval of all abscissae."),
    Option(["--minimise"], type=click.Choice(OBJECTIVES),
           help="What to reduce along solution sets; each minimum is a local one."),
    Option(["--seed"], type=int, default=0, help="Seed of the random numbers."),
    Option(["--width"], type=float, help="Guesses are uniform in [-width, width]."),
    Option(["--force"], is_flag=True, help="Try even with fewer unknowns than conditions."),
    Option(["--workers"], type=int, help="Number of workers; by default one per core."),
    Option(["--processes"], is_flag=True, help="Run in processes in place of threads."),
    Option(["--store"], type=click.Path(dir_okay=False), help="File of runs to continue from."),
    Option(["--quiet", "-q"], is_flag=True, help="Don't show progress."),
)  # fmt: skip
_OF_SEARCH = (
    # no file that exists, in whose place there can't be a folder of several methods
    Option(["--output", "-o"], type=click.Path(file_okay=False, path_type=Path),
           help="Write the methods there: a folder, or a new file for one method."),
    Option(["--starts"], type=int, default=100, help="Number of random starts."),
    Option(["--rows"], type=click.Choice(Rows, case_sensitive=False), default="explicit",
           help="Explicit, diagonally implicit or fully implicit tableaux."),
    Option(["--registers"], is_flag=True, help="Methods with two registers."),
    Option(["--bound"], multiple=True, callback=_bound, metavar="NUMBER|NAME=LOWER:UPPER",
           help="Bound on the magnitudes of the coefficients, or an interval by name."),
    Option(["--nonnegative"], multiple=True, metavar="NAME", help="What must be >= 0."),
    Option(["--algorithm"], type=click.Choice(ALGORITHMS), default=ALGORITHMS[0],
           help="How starts are solved."),
    Option(["--maxfev"], type=int, help="Largest number of evaluations in double."),
    Option(["--refine-below"], type=float, default=1e-15,
           help="Sum of squares from which a start is refined in real(16)."),
    Option(["--refine-maxfev"], type=int, help="Largest number of evaluations in real(16)."),
)  # fmt: skip
_OF_CONSTRUCT = (
    Option(["--tries"], type=int, default=400, help="Largest number of random starts."),
    Option(["--output", "-o"], type=click.Path(path_type=Path), help="Folder, or file."),
    Option(["--max-coefficient"], type=float, default=3.0, help="Bound on magnitudes."),
    Option(["--restarts"], type=int, default=1,
           help="Largest number of walks along the solution set after elimination fails."),
    Option(["--structure"], type=click.Choice(Structure, case_sensitive=False),
           help="Simplifying assumptions."),
    Option(["--first-stages"], type=int, help="Stages of random starts."),
    Option(["--first-flows"], type=int, help="Flows of random starts; by default --flows."),
    Option(["--iterations"], type=int, help="Largest number of steps of the solver."),
)  # fmt: skip


@click.command(
    "search", params=[*_SHARED, *_OF_SEARCH], short_help="Search for methods from random starts."
)
@json_option
def search_command(output: Path | None, in_json: bool, **options: Any) -> int:
    """Search for methods of an order from random starts.

    The methods are tableaux of Crouch-Grossman type, explicit or with --rows implicit. With --flows
    they are commutator-free methods with random trees of points, with --tree those with the tree of
    a method. Prints a line for each method, sorted by the largest coefficient or by what --minimise
    names. Neither --workers nor --processes changes the result.

    Progress is shown on standard error if tqdm is installed. With --store, the same command resumes
    an interrupted search. Exits with 1 if no start led to a method.

    \b
    Examples:
      crouch-grossman search --order 4 --stages 5 --starts 200 --seed 1
      crouch-grossman search --order 5 --stages 6 --flows 9 --starts 200 -o found
      crouch-grossman search --order 4 --tree CF4 --store runs.jsonl
      crouch-grossman search --order 4 --stages 5 --abscissae 0 1 --minimise principal_error
      crouch-grossman search --order 4 --stages 5 --hold "c[2]=1/2" --hold "b[2]=0"
      crouch-grossman search --order 3 --stages 2 --rows diagonal --algorithm lmdif
      crouch-grossman search --order 6 --stages 8 --flows 16 --embedded --first-same-as-last
    """
    check_output(output, options["store"])
    result = search(**_arguments(**options))
    sorted_by = (options["minimise"] or "largest_coefficient").replace("_", " ")
    lines = [
        f"{method!r}, {sorted_by} {result.requirements.key(method):.3g}"
        for method in result.methods
    ]
    return _finish(result.methods, "\n".join(lines) or f"no method: {result!r}", output, in_json)


@click.command(
    "construct", params=[*_SHARED, *_OF_CONSTRUCT], short_help="Construct one method of an order."
)
@json_option
def construct_command(output: Path | None, in_json: bool, **options: Any) -> int:
    """Construct one method by eliminating stages or flows.

    The method is a tableau of Crouch-Grossman type; with --flows or --tree a commutator-free
    method. Prints it in the format of a method file. Progress is shown on standard error; the
    remaining time is that of all tries, of which most may not be needed. With --store, the same
    command resumes an interrupted construction. Exits with 1 if no try succeeded.

    \b
    Examples:
      crouch-grossman construct --order 5 --stages 9
      crouch-grossman construct --order 6 --stages 13 --seed 1 -o six.toml
      crouch-grossman construct --order 5 --stages 6 --flows 9 --first-flows 10
      crouch-grossman construct --order 5 --tree CF5a --max-coefficient 2
      crouch-grossman construct --order 5 --stages 9 --structure stage_order_two
    """
    check_output(output, options["store"])
    result = construct(**_arguments(**options))
    if result.method is None:
        return _finish([], f"no method: {result!r}", output, in_json)
    text = dumps(result.method) if output is None else repr(result.method)
    return _finish([result.method], text.rstrip(), output, in_json)


def _arguments(*, processes: bool, quiet: bool, **options: Any) -> dict[str, Any]:
    """Return the arguments of a function; `stages` are by default those of the tree."""
    if options["tree"] is not None:
        options["tree"] = method = resolve_method(options["tree"])
        if not method.explicit:
            raise click.BadParameter(f"{method!r} isn't explicit", param_hint="--tree")
        if options["stages"] is None:
            options["stages"] = method.stages
    elif options["stages"] is None:
        raise click.UsageError("Missing option '--stages', or '--tree'.")
    executor = "processes" if processes else None
    return {**options, "executor": executor, "progress": not quiet and has_bars()}


def _finish(methods: Sequence[Method], text: str, output: Path | None, in_json: bool) -> int:
    """Write and print the methods; return the exit code."""
    if output is not None:
        if len(methods) > 1:
            output.mkdir(exist_ok=True)
        for method in methods:
            save(method, output)
    if in_json:
        print_json([json.loads(export(method, "json")) for method in methods])
    else:
        print_text(text)
    return 0 if methods else NEGATIVE
