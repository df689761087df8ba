"""``search`` and ``construct``: new methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from cg.catalogue import dumps, save
from cg.construction import construct
from cg.method import Method
from cg.random_search import search

from .arguments import F, as_json, json_option, say, workers_option
from .engines import engine, engine_options
from .main import NO
from .progress import Counter

__all__ = ["construct_command", "search_command"]


def _shape(function: F) -> F:
    """Add the options that both commands have."""
    for option in (
        json_option,
        click.option(
            "--output", "-o", type=click.Path(path_type=Path), metavar="PATH",
            help="Write the methods there: a folder, or a file for one method.",
        ),
        click.option(
            "--store", type=click.Path(dir_okay=False), metavar="FILE",
            help="Keep what is finished there; an interrupted run goes on from it.",
        ),
        engine_options,
        workers_option,
        click.option(
            "--force", is_flag=True, help="Try even with fewer unknowns than conditions."
        ),
        click.option("--embedded", is_flag=True, help="With --flows: pairs."),
        click.option(
            "--flows", type=click.IntRange(1), metavar="N",
            help="Commutator-free methods with so many flows.",
        ),
        click.option("--seed", type=click.IntRange(0), default=0, show_default=True),
        click.option("--stages", type=click.IntRange(1), required=True, metavar="N",
                     help="Evaluations a step."),
        click.option("--order", type=click.IntRange(1), required=True, metavar="N",
                     help="Order wanted."),
    ):  # fmt: skip
        function = option(function)
    return function


def _naming_options(function: Callable[..., int]) -> Callable[..., int]:
    """Turn what the solver refuses into errors of the command."""

    @wraps(function)
    def call(**options: Any) -> int:
        try:
            return function(**options)
        except ValueError as problem:
            message = str(problem).replace("pass force=True", "pass --force")
            raise click.UsageError(message) from None

    return call


@click.command("search", short_help="Search for methods from random starts.")
@_shape
@click.option("--starts", type=click.IntRange(1), default=100, show_default=True, metavar="N",
              help="Random starts.")  # fmt: skip
@_naming_options
def search_command(
    order: int,
    stages: int,
    starts: int,
    seed: int,
    flows: int | None,
    embedded: bool,
    force: bool,
    workers: int | None,
    processes: bool,
    dask: str | None,
    mpi: bool,
    store: str | None,
    output: Path | None,
    in_json: bool,
) -> int:
    """Search for methods of an order from random starts.

    Prints a line for each method, the one with the smallest coefficients first. The numbers don't
    depend on --workers. Exits with 1 if no start led to a method.

    \b
    Examples:
      crouch-grossman search --order 4 --stages 5 --starts 200 --seed 1
      crouch-grossman search --order 5 --stages 6 --flows 9 --starts 200 -o found
    """
    with engine(processes, dask, mpi) as executor:
        found = search(
            order,
            stages,
            starts,
            seed,
            flows=flows,
            embedded=embedded,
            force=force,
            workers=workers,
            executor=executor,
            store=store,
            progress=Counter("starts"),
        )
    for failure in found.failures:
        click.echo(f"start {failure.index} of seed {seed}: {failure.message}", err=True)
    say("")
    return _give(list(found.methods), output, in_json)


@click.command("construct", short_help="Construct one method of an order.")
@_shape
@click.option("--tries", type=click.IntRange(1), default=400, show_default=True, metavar="N",
              help="Random starts at most.")  # fmt: skip
@_naming_options
def construct_command(
    order: int,
    stages: int,
    tries: int,
    seed: int,
    flows: int | None,
    embedded: bool,
    force: bool,
    workers: int | None,
    processes: bool,
    dask: str | None,
    mpi: bool,
    store: str | None,
    output: Path | None,
    in_json: bool,
) -> int:
    """Construct one method, leaving stages or flows out along the way.

    Prints it as a file of a method. Exits with 1 if no try succeeded.

    \b
    Examples:
      crouch-grossman construct --order 5 --stages 9
      crouch-grossman construct --order 6 --stages 13 --seed 1 -o six.toml
    """
    counter = Counter("tries")
    with engine(processes, dask, mpi) as executor:
        found = construct(
            order,
            stages,
            seed,
            tries=tries,
            flows=flows,
            embedded=embedded,
            force=force,
            workers=workers,
            executor=executor,
            store=store,
            progress=counter.one_of(tries),
        )
    method = found.method
    for failure in found.failures:
        click.echo(f"try {failure.index} of seed {seed}: {failure.message}", err=True)
    say("")
    if method is None:
        return _give([], output, in_json)
    if output is None and not in_json:
        click.echo(dumps(method), nl=False)
        return 0
    return _give([method], output, in_json)


def _give(methods: list[Method], output: Path | None, in_json: bool) -> int:
    methods.sort(key=_largest)
    if output is not None:
        if len(methods) > 1 and not output.is_dir():
            output.mkdir(parents=True)
        for method in methods:
            save(method, output)
    if in_json:
        import json

        from cg.formats import export

        as_json([json.loads(export(method, "json")) for method in methods])
    else:
        for method in methods:
            click.echo(f"{method!r}, largest coefficient {_largest(method):.3g}")
        if not methods:
            click.echo("no method found")
    return 0 if methods else NO


def _largest(method: Method) -> float:
    return max(abs(float(coefficient.value)) for coefficient in method.coefficients)
