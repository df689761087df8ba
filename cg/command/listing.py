"""``list``: the methods there are."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import click

from cg.catalogue import methods, munthe_kaas
from cg.catalogue.summary import MethodSummary, summary_of
from cg.method.method import Method
from cg.support.parsing import visible

from .arguments import as_json, json_option, say

__all__ = ["list_command", "table"]

_KEYS: dict[str, Callable[[MethodSummary], Any]] = {
    "name": lambda summary: summary.name,
    "order": lambda summary: summary.order,
    "evaluations": lambda summary: summary.evaluations,
    "flows": lambda summary: summary.flows,
    "error": lambda summary: (
        math.inf if summary.principal_error is None else summary.principal_error
    ),
}
_KINDS = ("Crouch-Grossman", "commutator-free", "implicit", "Munthe-Kaas")


@click.command("list")
@click.option("--order", type=click.IntRange(1), help="Only of this order.")
@click.option("--min-order", type=click.IntRange(1), help="Only of this order or a higher one.")
@click.option(
    "--max-evaluations", type=click.IntRange(1), metavar="N",
    help="Only with so many evaluations a step at most.",
)  # fmt: skip
@click.option(
    "--max-flows", type=click.IntRange(1), metavar="N",
    help="Only with so many flows a step at most.",
)  # fmt: skip
@click.option("--pair/--no-pair", default=None, help="Only pairs, or none.")
@click.option("--kind", type=click.Choice(_KINDS, case_sensitive=False), help="Only of this kind.")
@click.option(
    "--sort", type=click.Choice(list(_KEYS)), default="order", show_default=True,
    help="Sort by; then by evaluations, flows and name.",
)  # fmt: skip
@json_option
def list_command(
    order: int | None,
    min_order: int | None,
    max_evaluations: int | None,
    max_flows: int | None,
    pair: bool | None,
    kind: str | None,
    sort: str,
    in_json: bool,
) -> None:
    """List the methods of the catalogue.

    Flows of pairs include those of the estimate; error is the principal error, the size of the
    residuals of the next order. JSON says too whether a certificate proves the order: "proved" is
    "whole", "partly" or "no".

    \b
    Examples:
      crouch-grossman list
      crouch-grossman list --min-order 5 --pair --sort flows
      crouch-grossman list --kind implicit --json
    """
    every: dict[str, Method] = {**methods, **munthe_kaas}
    wanted = [
        summary
        for summary in (summary_of(method) for method in every.values())
        if (order is None or summary.order == order)
        and (min_order is None or summary.order >= min_order)
        and (max_evaluations is None or summary.evaluations <= max_evaluations)
        and (max_flows is None or summary.flows <= max_flows)
        and (pair is None or (summary.embedded_order is not None) == pair)
        and (kind is None or summary.kind == kind)
    ]
    wanted.sort(key=lambda f: (_KEYS[sort](f), f.evaluations, f.flows, f.name))
    if in_json:
        from cg.proofs import proved

        as_json([summary.as_dict() | {"proved": proved(every[summary.name])} for summary in wanted])
        return
    heads = ("name", "kind", "order", "evaluations", "flows", "error")
    say(table([heads, *map(_row, wanted)]))


def _row(summary: MethodSummary) -> tuple[str, ...]:
    pair = "" if summary.embedded_order is None else f"({summary.embedded_order})"
    error = "" if summary.principal_error is None else f"{summary.principal_error:.3g}"
    about = "≈" if summary.approximate else ""
    numbers = (
        f"{about}{summary.order}{pair}",
        str(summary.evaluations),
        str(summary.pair_flows),
        error,
    )
    return visible(summary.name), summary.kind, *numbers


def table(rows: Sequence[Sequence[str]], *, left: int = 2) -> str:
    """Return rows as lines of text in columns, the first so many of them flush left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
