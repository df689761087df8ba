"""``list``: the methods of the catalogue."""

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import click

from cg.command.arguments import as_json, count_option, json_option, say
from cg.command.main import NO
from cg.construction.catalogue import methods
from cg.construction.catalogue.summary import MethodSummary, summary_of
from cg.construction.plots.text import columns
from cg.construction.proofs import proved
from cg.support.parsing import visible

_KEYS = ("name", "order", "evaluations", "flows", "error")
_KINDS = ("Crouch-Grossman", "commutator-free", "implicit", "Munthe-Kaas", "Magnus", "splitting")
_FILTERS: dict[str, Callable[[MethodSummary, Any], bool]] = {
    "order": lambda method, order: method.order == order,
    "min_order": lambda method, order: method.order >= order,
    "max_order": lambda method, order: method.order <= order,
    "max_evaluations": lambda method, count: method.evaluations <= count,
    "max_flows": lambda method, count: method.flows <= count,
    "pair": lambda method, pair: (method.embedded_order is not None) == pair,
    "kind": lambda method, kind: method.kind == kind,
}


@click.command("list")
@count_option("--order", "Only methods of this order.")
@count_option("--min-order", "Only methods of this order or higher.")
@count_option("--max-order", "Only methods of this order or lower.")
@count_option("--max-evaluations", "Only methods with at most N evaluations per step.")
@count_option("--max-flows", "Only methods with at most N flows per step.")
@click.option("--pair/--no-pair", default=None, help="Only pairs, or none.")
@click.option("--proved", "only_proved", is_flag=True, help="Only methods proved in full.")
@click.option("--kind", type=click.Choice(_KINDS, case_sensitive=False), help="Only this kind.")
@click.option(
    "--sort", type=click.Choice(_KEYS), default="order", show_default=True,
    help="First sort key; then evaluations, flows and name.",
)  # fmt: skip
@json_option
def list_command(only_proved: bool, sort: str, in_json: bool, **filters: Any) -> int:
    """List the methods of the catalogue.

    Numbers in brackets are the order of the second result of a pair, and the flows with the error
    estimate. The error is the principal error, the norm of the residuals of the next order.
    "proved" says whether a certificate proves the order: "yes", "in part" or "no"; "classical"
    methods have the order of their tableau.

    Exits with 1 if no method matches.

    \b
    Examples:
      crouch-grossman list
      crouch-grossman list --min-order 5 --pair --sort flows
      crouch-grossman list --order 6 --proved
      crouch-grossman list --kind implicit --json
    """
    given = {name: value for name, value in filters.items() if value is not None}
    selected = [
        facts
        for facts in map(summary_of, methods.values())
        if all(_FILTERS[name](facts, value) for name, value in given.items())
    ]
    selected.sort(key=lambda facts: (_key(facts, sort), facts.evaluations, facts.flows, facts.name))
    proofs = {facts.name: proved(methods[facts.name]) for facts in selected}
    if only_proved:
        selected = [facts for facts in selected if proofs[facts.name] == "yes"]
    if in_json:
        as_json([asdict(facts) | {"proved": proofs[facts.name]} for facts in selected])
    elif selected:
        heads = ("name", "kind", "proved", "order", "evaluations", "flows", "error")
        say(columns([heads, *(_row(facts, proofs[facts.name]) for facts in selected)], left=3))
    else:
        say("no method of the catalogue matches these options")
    return 0 if selected else NO


def _key(summary: MethodSummary, name: str) -> Any:
    if name == "error":
        return math.inf if summary.principal_error is None else summary.principal_error
    return getattr(summary, name)


def _row(summary: MethodSummary, proof: str) -> tuple[str, ...]:
    pair = "" if summary.embedded_order is None else f"({summary.embedded_order})"
    error = "" if summary.principal_error is None else f"{summary.principal_error:.3g}"
    about = "≈" if summary.approximate else ""
    numbers = (f"{about}{summary.order}{pair}", str(summary.evaluations), summary.all_flows, error)
    return visible(summary.name), summary.kind, proof, *numbers
