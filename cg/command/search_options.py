"""Options of ``search`` and ``construct``, named like the arguments of the functions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import (
    MethodArgument,
    Option,
    count_option,
    json_option,
    stacked,
    workers_option,
)
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.layouts.points import MethodError
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.search.requirements import OBJECTIVES
from cg.construction.search.settings import ALGORITHMS
from cg.construction.search.shapes import layout_of
from cg.construction.solvers.system import Structure


def _shape(method: Method) -> Layout:
    """Return the tree of points of a method."""
    try:
        if not isinstance(method, MuntheKaas):
            return layout_of(method)
    except (MethodError, TypeError):  # it is implicit
        pass
    raise ValueError(f"{method!r} isn't an explicit method with a tree of points")


class _Member(click.Choice):  # type: ignore[type-arg]
    """A member of an enumeration, by its name in small letters with hyphens."""

    def __init__(self, kind: type[Rows] | type[Structure]) -> None:
        self._members = {member.name.lower().replace("_", "-"): member for member in kind}
        super().__init__(list(self._members))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self._members.get(value) or self._members[super().convert(value, param, ctx)]


class _Value(click.ParamType):  # type: ignore[type-arg]
    """A name and its value."""

    name = "NAME=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        name, equals, number = value.partition("=")
        return (name, number) if equals else self.fail(f"{value!r} isn't NAME=VALUE", param)


_SIZE_OPTIONS: Sequence[Option[Any]] = (
    count_option("--order", "Order of the methods.", required=True),
    count_option("--stages", "Evaluations in a step; required unless --tree is given."),
)

_POINTS: Sequence[Option[Any]] = (
    count_option("--flows", "Commutator-free methods with this number of flows."),
    click.option(
        "--tree", type=MethodArgument(_shape), metavar="NAME|FILE",
        help="Commutator-free methods with the tree of points of a method, and its nonzero weights "
        "as unknowns.",
    ),
    click.option("--embedded", is_flag=True, help="With --flows: pairs."),
    click.option(
        "--first-same-as-last", is_flag=True,
        help="With --flows: the last stage is at the result, where the next step begins.",
    ),
    click.option(
        "--abscissae", type=float, nargs=2, default=None, metavar="LOWER UPPER",
        help="Interval that all abscissae of the methods must lie in.",
    ),
    click.option(
        "--minimise", type=click.Choice(OBJECTIVES),
        help="Move the methods along their solution sets to reduce this.",
    ),
    click.option(
        "--hold", type=_Value(), multiple=True, metavar="NAME=VALUE",
        help="Prescribed coefficient or abscissa, such as a[2,1]=1/2 or c[3]=1; repeatable.",
    ),
)  # fmt: skip

_RUN: Sequence[Option[Any]] = (
    click.option("--force", is_flag=True, help="Try even with fewer unknowns than conditions."),
    workers_option,
    click.option("--processes", is_flag=True, help="Run in processes in place of threads."),
    click.option(
        "--store", type=click.Path(dir_okay=False), metavar="FILE",
        help="Store finished starts there; the same command resumes an interrupted run.",
    ),
    click.option("--quiet", "-q", is_flag=True, help="Don't show progress."),
    click.option(
        "--output", "-o", type=click.Path(path_type=Path), metavar="PATH",
        help="Write the methods there: a folder, or a file for one method.",
    ),
    json_option,
)  # fmt: skip


def _size(name: str, metavar: str, help: str, **options: Any) -> Option[Any]:
    size = click.FloatRange(0, min_open=True)
    return click.option(name, type=size, metavar=metavar, help=help, **options)


def _random(name: str, default: int, help: str) -> Sequence[Option[Any]]:
    seed = "Seed of all random numbers: the same seed gives the same result."
    width = "Guesses are uniform in [-W, W]; the default depends on the order."
    return (
        count_option(name, help, default=default, show_default=True),
        count_option("--seed", seed, least=0, default=0, show_default=True),
        _size("--width", "W", width),
    )


_SEARCH: Sequence[Option[Any]] = (
    click.option(
        "--rows", type=_Member(Rows), default="explicit", show_default=True,
        help="Explicit, diagonally implicit or fully implicit tableaux.",
    ),
    click.option(
        "--algorithm", type=click.Choice(ALGORITHMS), default=ALGORITHMS[0], show_default=True,
        help="Steps of least norm with the exact Jacobian, or the algorithm of the paper.",
    ),
    count_option(
        "--maxfev",
        "Largest number of evaluations in double precision; the default depends on the order.",
    ),
    click.option(
        "--refine-below", type=click.FloatRange(0), default=1e-15, show_default=True, metavar="F",
        help="A start is refined in quadruple precision if its sum of squares is at most this.",
    ),
    count_option(
        "--refine-maxfev",
        "Largest number of evaluations there; by default 20 (n + 1) for n unknowns.",
    ),
    _size(
        "--bound",
        "X",
        "Bound on the magnitudes of coefficients; methods beyond it are moved to 1 % below.",
    ),
)  # fmt: skip

_CONSTRUCTION: Sequence[Option[Any]] = (
    count_option(
        "--first-flows", "With --flows: number of flows of the random trees to start from."
    ),
    count_option(
        "--first-stages", "Stages of random starts; the default depends on order and structure."
    ),
    click.option(
        "--structure", type=_Member(Structure),
        help="Simplifying assumptions on tableaux; by default middle from order 6 on, and for "
        "fewer stages than a general method needs.",
    ),
    _size("--largest", "X", "Bound on the magnitude of coefficients.", default=3.0,
          show_default=True),
    count_option("--restarts", "Walks along the solution set after elimination fails.", least=0,
                 default=1, show_default=True),
    click.option(
        "--full-rank", is_flag=True,
        help="Only methods at which all conditions are independent, which makes proofs easy.",
    ),
    count_option(
        "--iterations",
        "Largest number of steps of the solver in each run; the default depends on the order.",
    ),
)  # fmt: skip


search_options = stacked(
    *_SIZE_OPTIONS, *_random("--starts", 100, "Random starts."), *_POINTS, *_SEARCH, *_RUN
)
_TRIES = _random("--tries", 400, "Random starts at most.")
construction_options = stacked(*_SIZE_OPTIONS, *_TRIES, *_POINTS, *_CONSTRUCTION, *_RUN)


def arguments_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function for options; `stages` is by default that of the tree."""
    stages, tree = options["stages"], options["tree"]
    if stages is None:
        if tree is None:
            raise click.UsageError("Missing option '--stages', or '--tree'.")
        stages = tree.stages
    return {**options, "stages": stages, "hold": dict(options["hold"]) or None}
