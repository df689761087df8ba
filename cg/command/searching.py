"""``search`` and ``construct``, whose options are made of the arguments of the functions."""

import inspect
import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import reduce
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args

import click

from cg.command.arguments import F, MethodArgument, as_json, check_output, json_option, say
from cg.command.main import NO
from cg.construction.catalogue import dumps, load, save
from cg.construction.formats import export
from cg.construction.layouts import Layout, Rows
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.points import MethodError
from cg.construction.search.construct import construct
from cg.construction.search.random_search import SearchResult, search
from cg.construction.search.requirements import OBJECTIVES
from cg.construction.search.settings import ALGORITHMS
from cg.construction.search.shapes import layout_of
from cg.construction.solvers.system import Structure
from cg.support.parallel import has_bars


def _shape(method: Method) -> Layout:
    """Return the tree of points of a method."""
    with suppress(MethodError, TypeError):  # the method is implicit
        if not isinstance(method, MuntheKaas):
            return layout_of(method)
    raise ValueError(f"{method!r} isn't an explicit method with a tree of points")


def _held(text: str) -> tuple[str, str]:
    """Return a name and its value."""
    name, equals, number = text.partition("=")
    if not equals:
        raise click.BadParameter(f"{text!r} isn't NAME=VALUE")
    return name, number


def _bound(text: str) -> Any:
    """Return a bound on all magnitudes, or a name and its interval, whose ends may be None."""
    name, equals, interval = text.rpartition("=")
    try:
        ends = [float(end) if end else None for end in interval.split(":")]
    except ValueError:
        ends = []
    if len(ends) != 1 + bool(equals):
        raise click.BadParameter(f"{text!r} isn't a number or NAME=LOWER:UPPER")
    return (name, ends) if equals else ends[0]


_SPECIAL: dict[str, dict[str, Any]] = {
    "abscissae": {"type": float, "nargs": 2, "metavar": "LOWER UPPER"},
    "algorithm": {"type": click.Choice(ALGORITHMS), "help": "How starts are solved."},
    "bound": {"type": _bound, "multiple": True},
    "nonnegative": {"type": str, "multiple": True, "metavar": "NAME"},
    "hold": {"type": _held, "multiple": True, "metavar": "NAME=VALUE",
             "help": "Prescribed coefficient or abscissa, such as a[2,1]=1/2 or c[3]=1."},
    "minimise": {"type": click.Choice(OBJECTIVES)},
    "rows": {"type": click.Choice(Rows, case_sensitive=False), "default": "explicit"},
    "stages": {"type": int, "required": False,
               "help": "Evaluations in a step; required unless --tree is given."},
    "store": {"type": click.Path(dir_okay=False), "metavar": "FILE"},
    "structure": {"type": click.Choice(Structure, case_sensitive=False)},
    "tree": {"type": MethodArgument(_shape, lambda file: _shape(load(file))),
             "metavar": "NAME|FILE", "help": "Methods with the tree of points of a method."},
}  # fmt: skip


def _options_of(function: Callable[..., Any]) -> Callable[[F], F]:
    """Return a decorator that adds an option for each argument of a function, and others."""
    options = [
        _option(parameter, _help(function, name))
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in ("executor", "progress")
    ]
    options += [
        click.option("--processes", is_flag=True, help="Run in processes in place of threads."),
        click.option("--quiet", "-q", is_flag=True, help="Don't show progress."),
        click.option("--output", "-o", type=click.Path(path_type=Path), metavar="PATH",
                     help="Write the methods there: a folder, or a file for one method."),
        json_option,
    ]  # fmt: skip

    return lambda command: reduce(lambda made, option: option(made), options[::-1], command)


def _option(parameter: inspect.Parameter, help: str) -> Callable[[F], F]:
    default, kind = parameter.default, parameter.annotation
    required = default is parameter.empty
    if isinstance(kind, UnionType):
        (kind, *_) = (member for member in get_args(kind) if member is not NoneType)
    facts: dict[str, Any] = {"type": kind, "help": help, "required": required}
    if kind is bool:
        facts = {"is_flag": True, "help": help}
    elif kind in (int, float):
        facts["metavar"] = "N" if kind is int else "X"
    if not required and default is not None and kind is not bool:
        facts |= {"default": default, "show_default": True}
    facts |= _SPECIAL.get(parameter.name, {})
    return click.option(f"--{parameter.name.replace('_', '-')}", **facts)


def _help(function: Callable[..., Any], name: str) -> str:
    """Return the first sentence about an argument in a docstring that doesn't list values."""
    doc = inspect.getdoc(function) or ""
    match = re.search(rf"^(?:\w+, )*{name}(?:, \w+)*\n((?:    .*\n)+)", doc, re.MULTILINE)
    text = " ".join(match.group(1).split()) if match else ""
    sentences = re.split(r"(?<=\.) ", text.replace("`", ""))
    return next((sentence for sentence in sentences if not sentence.startswith("One of ")), "")


def _arguments_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function of options; `stages` are by default those of the tree."""
    stages, tree = options["stages"], options["tree"]
    if stages is None and tree is None:
        raise click.UsageError("Missing option '--stages', or '--tree'.")
    stages = tree.stages if stages is None else stages
    arguments = {**options, "stages": stages, "hold": _named("hold", options["hold"])}
    if "bound" in options:
        numbers = [bound for bound in options["bound"] if isinstance(bound, float)]
        if numbers and len(options["bound"]) > 1:
            raise click.UsageError("--bound: give one number, or intervals by name.")
        arguments["bound"] = numbers[0] if numbers else _named("bound", options["bound"])
    return arguments


def _named(option: str, pairs: Sequence[tuple[str, Any]]) -> dict[str, Any] | None:
    """Return a mapping of names, None without any."""
    named = dict(pairs)
    if any(named[name] != value for name, value in pairs):
        raise click.UsageError(f"--{option} gives two values of one name")
    return named or None


@click.command("search", short_help="Search for methods from random starts.")
@_options_of(search)
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
@_options_of(construct)
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
      crouch-grossman construct --order 5 --tree CF5a --max-coefficient 2
      crouch-grossman construct --order 5 --stages 9 --structure stage_order_two
    """
    return _run(construct, **options)


def _run(
    function: Callable[..., Any], *, processes: bool, quiet: bool, output: Path | None,
    in_json: bool, **options: Any,
) -> int:  # fmt: skip
    """Call a function with the arguments of the command; print and write the methods."""
    arguments = _arguments_of(options)
    check_output(output)
    executor = "processes" if processes else None
    try:
        result = function(**arguments, executor=executor, progress=not quiet and has_bars())
    except ValueError as error:
        name, _, message = str(error).partition(" ")
        option = f"--{name.replace('_', '-')}" if name in arguments else name
        raise click.UsageError(f"{option} {message}") from None
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
        minimise = arguments.get("minimise")
        for method in methods:
            largest = max(abs(float(coefficient.value)) for coefficient in method.coefficients)
            text = f"{method!r}, largest coefficient {largest:.3g}"
            shown = minimise == "principal_error"
            say(text + (f", principal error {method.principal_error:.3g}" if shown else ""))
        if minimise:
            say("each minimum is a local one: more --starts may lead to smaller ones", err=True)
    return 0 if methods else NO
