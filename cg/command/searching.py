"""``search`` and ``construct``: search for new methods."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import as_json, check_output, say
from cg.command.main import NO
from cg.command.search_options import arguments_of, options_of
from cg.construction.catalogue import dumps, save
from cg.construction.construct import construct
from cg.construction.formats import export
from cg.construction.methods.method import Method
from cg.construction.search.random_search import SearchResult, search
from cg.support.progress import has_bars


@click.command("search", short_help="Search for methods from random starts.")
@options_of(search)
def search_command(**options: Any) -> int:
    """Search for methods of an order from random starts.

    The methods are tableaux of Crouch-Grossman type, explicit or with --rows implicit. With --flows
    they are commutator-free methods with random trees of points, with --tree those with the tree of
    a method. Prints a line for each method, sorted by the largest coefficient or by what --minimise
    names. Each minimum is a local one: more starts may lead to smaller ones. Neither --workers nor
    the executor changes the result.

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
    return _run(search, **options)


@click.command("construct", short_help="Construct one method of an order.")
@options_of(construct)
def construct_command(**options: Any) -> int:
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
      crouch-grossman construct --order 5 --tree CF5a --largest 2
      crouch-grossman construct --order 5 --stages 9 --structure stage-order-two
    """
    return _run(construct, **options)


def _run(
    function: Callable[..., Any],
    *,
    processes: bool,
    quiet: bool,
    output: Path | None,
    in_json: bool,
    **options: Any,
) -> int:
    """Call a function with the arguments of the command; print and write the methods."""
    arguments = arguments_of(options)
    check_output(output)
    executor = "processes" if processes else None
    try:
        result = function(**arguments, executor=executor, progress=not quiet and has_bars())
    except ValueError as problem:
        first, _, rest = str(problem).partition(" ")
        option = f"--{first.replace('_', '-')}" if first in arguments else first
        raise click.UsageError(f"{option} {rest}") from None
    except KeyboardInterrupt as interrupt:
        if arguments["store"] is None:
            interrupt.add_note("with --store FILE the same command would continue from here")
        raise
    methods = result.methods if function is search else [m for m in [result.method] if m]
    if output is not None:
        if len(methods) > 1:
            output.mkdir(exist_ok=True)
        for method in methods:
            save(method, output)
    if in_json:
        as_json([json.loads(export(method, "json")) for method in methods])
    elif not methods:
        exact = result.exact_starts if isinstance(result, SearchResult) else 0
        required = f": {exact} found, but none with {result.requirements}" if exact else " found"
        say(f"no method{required}")
    elif function is construct and output is None:
        click.echo(dumps(methods[0]), nl=False)
    else:
        _list(methods, arguments.get("minimise"))
    return 0 if methods else NO


def _list(methods: Sequence[Method], minimise: str | None) -> None:
    """Print a line for each method, with what was minimised."""
    for method in methods:
        largest = max(abs(float(coefficient.value)) for coefficient in method.coefficients)
        text = f"{method!r}, largest coefficient {largest:.3g}"
        if minimise == "principal_error":
            text += f", principal error {method.principal_error:.3g}"
        say(text)
    if minimise:
        say("each minimum is a local one: more --starts may lead to smaller ones", err=True)
