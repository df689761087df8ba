"""``show``: all data of one method."""

from dataclasses import asdict
from fractions import Fraction
from typing import Any

import click

from cg.command.arguments import METHOD, as_json, json_option, say
from cg.construction import conditions
from cg.construction.catalogue.summary import MethodSummary, summary_of
from cg.construction.conditions.nystrom import nystrom_trees
from cg.construction.formats import export
from cg.construction.formats.digits import known_digits, numbers_of
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.splitting import Splitting
from cg.construction.plots.text import columns, draw_method
from cg.construction.trees import forest
from cg.construction.trees.rooted import density, node_count, planted, rooted_trees_through
from cg.support.parsing import visible
from cg.support.quads import MAX_WRITTEN


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
        import json

        data = {**asdict(summary), "certificate": certificate, "source": method.source}
        data |= {} if conditions is None else {"conditions": listed}
        as_json(data | {"method": json.loads(export(method, "json"))})
        return
    if digits is not None and digits > (known_digits(method) or digits):
        method = numbers_of(method, digits, None).rounded()
    drawing = draw_method(method, digits=digits or 6)
    say(f"{visible(method.name) or 'a method'}, {summary.kind}\n")
    lines = {
        **_numbers(summary),
        "certificate": certificate or "none",
        "source": visible(method.source),
    }
    width = max(map(len, lines))
    for label, value in lines.items():
        say(f"  {label.ljust(width)}  {value}".rstrip())
    say(f"\n{drawing}")
    if listed:
        rows = [
            [str(one["order"]), one["tree"], one["right_side"], f"{one['residual']:.3g}"]
            for one in listed
        ]
        say("\n" + columns([["order", "tree", "1/γ", "Φ - 1/γ"], *rows]))


def _numbers(summary: MethodSummary) -> dict[str, str]:
    order, flows = str(summary.order), str(summary.flows)
    if summary.embedded_order is not None:
        order += f", of the second result {summary.embedded_order}"
    if summary.pair_flows != summary.flows:
        flows += f", {summary.pair_flows} with the estimate"
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
    from cg.construction.proofs import CertificationError, certificate_of, check
    from cg.construction.proofs.files import certificate_beside

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
        trees = ["sum of drifts"] * splits + [str(planted(tree)) for tree in rooted]
        residuals = list(map(float, method.residuals(order)))
        orders = [1] * splits + list(map(node_count, rooted))
        sides = [Fraction(1)] * splits + [Fraction(1, density(tree)) for tree in rooted]
    else:
        indices = conditions.condition_trees(order)
        ordered = [forest(order + 1).tree(index) for index in indices]
        trees = list(map(str, ordered))
        balls = conditions.residuals(method.tree, order, arithmetic="balls")
        residuals = [0.0 if ball.contains(0) else float(ball.mid()) for ball in balls]
        orders = [tree.nodes - 1 for tree in ordered]
        sides = list(conditions.right_sides(order))
    names = "order", "tree", "right_side", "residual"
    rows = zip(orders, trees, map(str, sides), residuals, strict=True)
    return [dict(zip(names, row, strict=True)) for row in rows]
