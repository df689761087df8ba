"""``list`` and ``show`` the methods of the catalogue, ``export`` one as data, a table or code."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import (
    METHOD,
    as_json,
    check_output,
    count_option,
    json_option,
    output_option,
    say,
)
from cg.command.main import NO
from cg.construction import conditions
from cg.construction.catalogue import methods
from cg.construction.catalogue.summary import MethodSummary, summary_of
from cg.construction.conditions.linear_equations import nystrom_trees
from cg.construction.formats import FORMATS, export
from cg.construction.formats.digits import known_digits, numbers_of
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.plots import align_columns, draw_method
from cg.construction.proofs import Certificate, CertificationError, certificate_of, check, proved
from cg.construction.proofs.packed import certificate_beside
from cg.construction.trees import density, forest, node_count, planted, rooted_trees_through
from cg.support.parsing import visible, write_file
from cg.support.quads import MAX_WRITTEN

_KINDS = ("Crouch-Grossman", "commutator-free", "implicit", "Munthe-Kaas", "Magnus", "splitting")
_FILTERS: dict[str, Callable[[MethodSummary, Any], bool]] = {
    "order": lambda method, order: method.order == order,
    "min_order": lambda method, order: method.order >= order,
    "pair": lambda method, pair: (method.embedded_order is not None) == pair,
    "kind": lambda method, kind: method.kind == kind,
}


@click.command("list")
@count_option("--order", "Only methods of this order.")
@count_option("--min-order", "Only methods of this order or higher.")
@click.option("--pair/--no-pair", default=None, help="Only pairs, or none.")
@click.option("--proved", "only_proved", is_flag=True, help="Only methods proved in full.")
@click.option("--kind", type=click.Choice(_KINDS, case_sensitive=False), help="Only this kind.")
@click.option(
    "--sort", type=click.Choice(("name", "order", "evaluations", "flows", "error")),
    default="order", show_default=True, help="First sort key; then evaluations, flows and name.",
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
    selected = [
        (summary, proved(method))
        for summary, method in zip(map(summary_of, methods.values()), methods.values(), strict=True)
        if all(_FILTERS[name](summary, x) for name, x in filters.items() if x is not None)
    ]
    if only_proved:
        selected = [(summary, proof) for summary, proof in selected if proof == "yes"]
    selected.sort(key=lambda pair: _sort_key(pair[0], sort))
    if in_json:
        as_json([asdict(summary) | {"proved": proof} for summary, proof in selected])
    elif selected:
        heads = ("name", "kind", "proved", "order", "evaluations", "flows", "error")
        say(align_columns([heads, *(_row(summary, proof) for summary, proof in selected)], left=3))
    else:
        say("no method of the catalogue matches these options")
    return 0 if selected else NO


def _sort_key(summary: MethodSummary, name: str) -> tuple[Any, ...]:
    error = math.inf if summary.principal_error is None else summary.principal_error
    value = error if name == "error" else getattr(summary, name)
    return value, summary.evaluations, summary.flows, summary.name


def _row(summary: MethodSummary, proof: str) -> tuple[str, ...]:
    pair = "" if summary.embedded_order is None else f"({summary.embedded_order})"
    error = "" if summary.principal_error is None else f"{summary.principal_error:.3g}"
    order = f"{'≈' * summary.approximate}{summary.order}{pair}"
    costs = str(summary.evaluations), summary.all_flows
    return visible(summary.name), summary.kind, proof, order, *costs, error


@click.command("show", short_help="Show all data of one method.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@click.option(
    "--digits", type=click.IntRange(1, MAX_WRITTEN), metavar="N",
    help="Significant digits, by default 6; beyond the stored ones they come from the certificate.",
)  # fmt: skip
@click.option(
    "--conditions", type=click.IntRange(1, conditions.MAX_ORDER), metavar="N",
    help="List the order conditions through order N with their trees and residuals.",
)  # fmt: skip
@json_option
def show_command(method: Method, digits: int | None, conditions: int | None, in_json: bool) -> None:
    """Show the tableau or points, order, principal error, stability, proof and source of a method.

    Points are drawn as a tree: a flow leads from each point to those below it. F1 is the field
    frozen at stage 1. Below them is the tableau c, a, b of the method where flows commute. JSON has
    all digits.

    \b
    Examples:
      crouch-grossman show CG4a
      crouch-grossman show CF5a --digits 16
      crouch-grossman show CG3 --conditions 4
      crouch-grossman show my_method.toml --json
    """
    summary, certificate = summary_of(method), _certificate(method)
    listed = [] if conditions is None else _conditions(method, conditions)
    if in_json:
        data = {**asdict(summary), "certificate": certificate, "source": method.source}
        data |= {} if conditions is None else {"conditions": listed}
        as_json(data | {"method": json.loads(export(method, "json"))})
        return
    if digits is not None and digits > (known_digits(method) or digits):
        method = numbers_of(method, digits, None).rounded()
    say(f"{visible(method.name) or 'a method'}, {summary.kind}\n")
    lines = _numbers(summary) | {"certificate": certificate or "none"}
    lines |= {"source": visible(method.source)}
    say(align_columns([("", label, value) for label, value in lines.items()], left=3))
    say(f"\n{draw_method(method, digits=digits or 6)}")
    if listed:
        rows = [
            [str(entry["order"]), entry["tree"], entry["right_side"], f"{entry['residual']:.3g}"]
            for entry in listed
        ]
        say("\n" + align_columns([["order", "tree", "1/γ", "Φ - 1/γ"], *rows]))


def _numbers(summary: MethodSummary) -> dict[str, str]:
    order, flows = str(summary.order), str(summary.flows)
    if summary.embedded_order is not None:
        order += f", of the second result {summary.embedded_order}"
    flows += f", {summary.pair_flows} with the estimate" * (summary.pair_flows != summary.flows)
    lines = {
        "order": order + ", up to a residual that is stored" * summary.approximate,
        "evaluations": str(summary.evaluations),
        "flows": flows,
        "principal error": _number(summary.principal_error, "unknown"),
    }
    if summary.estimate_ratio is not None:
        lines["error / estimate"] = f"at most {summary.estimate_ratio:.4g}"
    if summary.not_computed:
        return lines | {"not computed": summary.not_computed}
    real, imaginary = summary.real_stability, summary.imaginary_stability
    return lines | {
        "stable on the real axis": f"from 0 to -{_number(real, 'infinity')}",
        "stable on the imaginary axis": f"from 0 to {_number(imaginary, 'infinity')}",
    }


def _number(x: float | None, other: str) -> str:
    return other if x is None else f"{x:.4g}"


def _certificate(method: Method) -> str | None:
    try:
        beside = certificate_beside(method)
        if beside is not None:  # nothing of a file of the user's is believed
            check(beside, method)
    except CertificationError as error:
        return f"proves nothing: {error}"
    try:
        return str(beside or certificate_of(method))
    except CertificationError:
        return None


def _conditions(method: Method, order: int) -> list[dict[str, Any]]:
    """Return the order conditions through an order with their trees and residuals."""
    if isinstance(method, MagnusMethod):
        raise click.BadParameter(
            f"{method.name} has conditions of words, not of trees", param_hint="--conditions"
        )
    if isinstance(method, MuntheKaas | Splitting):
        splits = isinstance(method, Splitting)
        rooted = nystrom_trees(order) if splits else rooted_trees_through(order)
        trees: list[Any] = ["sum of drifts"] * splits + list(map(planted, rooted))
        residuals = list(map(float, method.residuals(order)))
        orders = [1] * splits + list(map(node_count, rooted))
        sides = [Fraction(1)] * splits + [Fraction(1, density(tree)) for tree in rooted]
    else:
        trees = list(map(forest(order + 1).tree, conditions.condition_trees(order)))
        balls = conditions.residuals(method.tree, order, arithmetic="balls")
        residuals = [0.0 if ball.contains(0) else float(ball.mid()) for ball in balls]
        orders = [tree.nodes - 1 for tree in trees]
        sides = list(conditions.right_sides(order))
    names = "order", "tree", "right_side", "residual"
    rows = zip(orders, map(str, trees), map(str, sides), residuals, strict=True)
    return [dict(zip(names, row, strict=True)) for row in rows]


@click.command("export", short_help="Write a method as data or code.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@click.argument("format", metavar="FORMAT", type=click.Choice(sorted(FORMATS)))
@click.option(
    "--digits", type=click.IntRange(1, MAX_WRITTEN), metavar="N",
    help="Significant digits; those beyond the stored ones come from the certificate.",
)  # fmt: skip
@click.option(
    "--certificate", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="Certificate of the method; by default that of the catalogue, or the one beside FILE.",
)  # fmt: skip
@output_option("Output file; standard output by default.")
def export_command(
    method: Method, format: str, certificate: Path | None, output: Path | None, **options: Any
) -> None:
    """Write a method as a data file, a LaTeX table, or code for one step.

    The certificate of FILE.toml is the file FILE.certificate.toml in the same folder.

    FORMAT is json, toml, latex, python or c.

    \b
    Examples:
      crouch-grossman export CG4a latex
      crouch-grossman export CF6c c -o cf6c.h
      crouch-grossman export CG5a json --digits 60
      crouch-grossman export mine.toml c --digits 40 --certificate proof.toml
    """
    check_output(output)
    proof = None if certificate is None else Certificate.load(certificate)
    text = export(method, format, certificate=proof, **options)
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        write_file(output, text)
