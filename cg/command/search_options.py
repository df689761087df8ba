"""Options of ``search`` and ``construct``, made of the arguments of the functions."""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args

import click

from cg.command.arguments import F, MethodArgument, json_option
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
        if value in self._members.values():
            return value
        return self._members[super().convert(value, param, ctx)]


class _Value(click.ParamType):  # type: ignore[type-arg]
    """A name and its value."""

    name = "NAME=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        name, equals, number = value.partition("=")
        return (name, number) if equals else self.fail(f"{value!r} isn't NAME=VALUE", param)


class _Bound(click.ParamType):  # type: ignore[type-arg]
    """A bound on all magnitudes, or a name and its interval, of which an end may be left out."""

    name = "X|NAME=LOWER:UPPER"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        name, equals, interval = value.rpartition("=")
        try:
            ends = [float(end) if end else None for end in interval.split(":")]
        except ValueError:
            ends = []
        if len(ends) != 1 + bool(equals):
            self.fail(f"{value!r} isn't a number or NAME=LOWER:UPPER", param)
        return (name, ends) if equals else ends[0]


_SPECIAL: dict[str, dict[str, Any]] = {
    "abscissae": {"type": float, "nargs": 2, "metavar": "LOWER UPPER"},
    "algorithm": {"type": click.Choice(ALGORITHMS), "help": "How starts are solved."},
    "bound": {"type": _Bound(), "multiple": True},
    "nonnegative": {"type": str, "multiple": True, "metavar": "NAME"},
    "hold": {"type": _Value(), "multiple": True,
             "help": "Prescribed coefficient or abscissa, such as a[2,1]=1/2 or c[3]=1."},
    "minimise": {"type": click.Choice(OBJECTIVES)},
    "rows": {"type": _Member(Rows)},
    "stages": {"type": int, "required": False,
               "help": "Evaluations in a step; required unless --tree is given."},
    "store": {"type": click.Path(dir_okay=False), "metavar": "FILE"},
    "structure": {"type": _Member(Structure)},
    "tree": {"type": MethodArgument(_shape), "metavar": "NAME|FILE",
             "help": "Methods with the tree of points of a method."},
}  # fmt: skip


def options_of(function: Callable[..., Any]) -> Callable[[F], F]:
    """Return a decorator that adds an option for each argument of a function, and others."""
    options = [
        _option(parameter, _help(function, name))
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in ("executor", "progress")
    ]
    path = click.Path(path_type=Path)
    options += [
        click.option("--processes", is_flag=True, help="Run in processes in place of threads."),
        click.option("--quiet", "-q", is_flag=True, help="Don't show progress."),
        click.option("--output", "-o", type=path, metavar="PATH",
                     help="Write the methods there: a folder, or a file for one method."),
        json_option,
    ]  # fmt: skip

    def decorate(command: F) -> F:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def _option(parameter: inspect.Parameter, help: str) -> Callable[[F], F]:
    default, kind = parameter.default, parameter.annotation
    required = default is parameter.empty
    if isinstance(kind, UnionType):
        (kind, *_) = (one for one in get_args(kind) if one is not NoneType)
    facts: dict[str, Any] = {"type": kind, "help": help, "required": required}
    if kind is bool:
        facts = {"is_flag": True, "help": help}
    elif kind in (int, float):
        facts["metavar"] = "N" if kind is int else "X"
    if not required and default is not None and kind is not bool:
        facts |= {"default": default, "show_default": True}
    facts |= _SPECIAL.get(parameter.name, {})
    if isinstance(default, Rows):
        facts["default"] = default.name.lower()
    return click.option(f"--{parameter.name.replace('_', '-')}", **facts)


def _help(function: Callable[..., Any], name: str) -> str:
    """Return the first sentence about an argument in a docstring that doesn't list values."""
    doc = inspect.getdoc(function) or ""
    found = re.search(rf"^(?:\w+, )*{name}(?:, \w+)*\n((?:    .*\n)+)", doc, re.MULTILINE)
    text = " ".join(found.group(1).split()) if found else ""
    sentences = re.split(r"(?<=\.) ", text.replace("`", ""))
    return next((one for one in sentences if not one.startswith("One of ")), "")


def arguments_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function for options; `stages` is by default that of the tree."""
    stages, tree = options["stages"], options["tree"]
    if stages is None:
        if tree is None:
            raise click.UsageError("Missing option '--stages', or '--tree'.")
        stages = tree.stages
    arguments = {**options, "stages": stages, "hold": _named("hold", options["hold"])}
    if "bound" in options:
        numbers = [one for one in options["bound"] if isinstance(one, float)]
        if numbers and len(options["bound"]) > 1:
            raise click.UsageError("--bound: give one number, or intervals by name.")
        arguments["bound"] = numbers[0] if numbers else _named("bound", options["bound"])
    return arguments


def _named(option: str, given: Sequence[tuple[str, Any]]) -> dict[str, Any] | None:
    """Return a mapping of names, None without any."""
    named = dict(given)
    if any(named[name] != value for name, value in given):
        raise click.UsageError(f"--{option} gives two values of one name")
    return named or None
