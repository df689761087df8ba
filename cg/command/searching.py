"""``search`` and ``construct``: new methods."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from cg.catalogue import dumps, save
from cg.construction import Construction, construct
from cg.construction.search.random_search import SearchResult, search
from cg.formats import export
from cg.method.method import Method

from .arguments import as_json, check_output, say
from .engines import engine
from .main import NO
from .shapes import construction_options, search_options, settled

__all__ = ["construct_command", "search_command"]


@click.command("search", short_help="Search for methods from random starts.")
@search_options
def search_command(**options: Any) -> int:
    """Search for methods of an order from random starts.

    By default for tableaux of Crouch-Grossman type, explicit or with --rows implicit; for
    commutator-free methods with --flows, which draws trees of points, or with --tree, the shape of
    a method. Prints a line for each method, the one with the smallest coefficients first. Neither
    --workers nor where starts run changes the result.

    How far it is, is told on standard error. With --store an interrupted search goes on when the
    same command is given again, and `runs` shows what it found. Exits with 1 if no start led to a
    method.

    \b
    Examples:
      crouch-grossman search --order 4 --stages 5 --starts 200 --seed 1
      crouch-grossman search --order 5 --stages 6 --flows 9 --starts 200 -o found
      crouch-grossman search --order 4 --tree CF4 --store runs.db
      crouch-grossman search --order 3 --stages 2 --rows diagonal --algorithm lmdif
      crouch-grossman search --order 6 --stages 8 --flows 16 --embedded --first-same-as-last
    """

    def found(result: SearchResult, _: bool) -> Sequence[Method]:
        return result.methods

    return _run(search, found, "start", **options)


@click.command("construct", short_help="Construct one method of an order.")
@construction_options
def construct_command(**options: Any) -> int:
    """Construct one method, leaving stages or flows out along the way.

    By default a tableau of Crouch-Grossman type; with --flows or --tree a commutator-free method.
    Prints it as a file of a method. How far it is, is told on standard error; the time left is
    that of all tries, of which most may not be needed. With --store an interrupted construction
    goes on when the same command is given again. Exits with 1 if no try succeeded.

    \b
    Examples:
      crouch-grossman construct --order 5 --stages 9
      crouch-grossman construct --order 6 --stages 13 --seed 1 -o six.toml
      crouch-grossman construct --order 5 --stages 6 --flows 9 --first-flows 10
      crouch-grossman construct --order 5 --tree CF5a --largest 2
      crouch-grossman construct --order 5 --stages 9 --structure stage-order-two
    """

    def found(result: Construction, plain: bool) -> Sequence[Method]:
        if plain and result.method is not None:
            click.echo(dumps(result.method), nl=False)
        return [] if result.method is None else [result.method]

    return _run(construct, found, "try", **options)


def _run(
    function: Callable[..., Any],
    found: Callable[[Any, bool], Sequence[Method]],
    piece: str,
    *,
    processes: bool,
    dask: str | None,
    mpi: bool,
    quiet: bool,
    output: Path | None,
    in_json: bool,
    **options: Any,
) -> int:
    """Call a function with what the command was given; print and write what it found."""
    arguments = settled(options)
    check_output(output)
    with engine(processes, dask, mpi) as executor:
        try:
            result = function(**arguments, executor=executor, progress=not quiet)
        except ValueError as problem:
            raise click.UsageError(_of_options(str(problem), arguments)) from None
        except KeyboardInterrupt as interrupt:
            if arguments["store"] is None:
                interrupt.add_note("with --store FILE the same command would continue from here")
            raise
    for failure in result.failures:
        say(f"{piece} {failure.index} of seed {arguments['seed']}: {failure.message}", err=True)
    plain = function is construct and output is None and not in_json
    methods = sorted(found(result, plain), key=_largest)
    if output is not None:
        folder = output if len(methods) > 1 else output.parent
        folder.mkdir(parents=True, exist_ok=True)
        for method in methods:
            save(method, output)
    if in_json:
        as_json([json.loads(export(method, "json")) for method in methods])
    elif not methods:
        say("no method found")
    elif not plain:
        for method in methods:
            say(f"{method!r}, largest coefficient {_largest(method):.3g}")
    return 0 if methods else NO


def _of_options(message: str, names: Iterable[str]) -> str:
    """Return what a function says of an argument with the name of its option."""
    message = message.replace("pass force=True", "pass --force")
    first, _, rest = message.partition(" ")
    return f"--{first.replace('_', '-')} {rest}" if first in names else message


def _largest(method: Method) -> float:
    return max(abs(float(coefficient.value)) for coefficient in method.coefficients)
