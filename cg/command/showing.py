"""``show``: all of one method."""

from __future__ import annotations

from typing import Any

import click

from cg.catalogue import packaged
from cg.coefficients import Coefficient
from cg.commutator_free import CommutatorFree
from cg.diagnosis import draw_points
from cg.facts import Facts, facts_of
from cg.formats import export
from cg.method import Method

from .arguments import METHOD, as_json, json_option
from .listing import table

__all__ = ["show_command"]


@click.command("show", short_help="Show all of one method.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@click.option(
    "--digits", type=click.IntRange(1, 36), default=6, show_default=True, metavar="N",
    help="Significant digits of coefficients that are printed.",
)  # fmt: skip
@json_option
def show_command(method: Method, digits: int, in_json: bool) -> None:
    """Show a method: its tableau or its points, order, principal error, stability, proof, source.

    Points are drawn as a tree: below each point are those that flows from it lead to. F1 is the
    field frozen at stage 1. JSON has all digits.

    \b
    Examples:
      crouch-grossman show CG4a
      crouch-grossman show CF5a --digits 16
      crouch-grossman show my_method.toml --json
    """
    facts, certificate = facts_of(method), _certificate(method)
    if in_json:
        import json

        data = {**facts.as_dict(), "certificate": certificate, "source": method.source}
        as_json(data | {"method": json.loads(export(method, "json"))})
        return
    click.echo(f"{method.name or 'a method'}, {facts.kind}\n")
    lines = [*_numbers(facts), ("certificate", certificate or "none"), ("source", method.source)]
    width = max(len(label) for label, _ in lines)
    for label, value in lines:
        click.echo(f"  {label.ljust(width)}  {value}".rstrip())
    drawn = draw_points(method, digits=digits) if _has_points(method) else _tableau(method, digits)
    click.echo("\n" + drawn)


def _has_points(method: Method) -> bool:
    return isinstance(method, CommutatorFree)


def _numbers(facts: Facts) -> list[tuple[str, str]]:
    order = f"{facts.order}" if facts.embedded_order is None else (
        f"{facts.order}, of the second result {facts.embedded_order}"
    )  # fmt: skip
    flows = str(facts.flows)
    if facts.pair_flows != facts.flows:
        flows += f", {facts.pair_flows} with the estimate"
    return [
        ("order", order + (", up to a residual that is stored" if facts.approximate else "")),
        ("evaluations", str(facts.evaluations)),
        ("flows", flows),
        ("principal error", _number(facts.principal_error, "unknown")),
        *_stability(facts),
    ]


def _stability(facts: Facts) -> list[tuple[str, str]]:
    if not facts.stability_known:
        return [("stable", "limits are not computed, the method is too large for that")]
    real = _number(facts.real_stability, "infinity")
    imaginary = _number(facts.imaginary_stability, "infinity")
    return [
        ("stable on the real axis", f"from 0 to -{real}"),
        ("stable on the imaginary axis", f"from 0 to {imaginary}"),
    ]


def _number(x: float | None, other: str) -> str:
    return other if x is None else f"{x:.4g}"


def _certificate(method: Method) -> str | None:
    from cg.certification import CertificationError, certificate_of, check

    try:
        certificate = certificate_of(method)
    except CertificationError:
        return None
    if method.name in packaged:
        return str(certificate)
    try:  # nothing of a file of the user's is believed
        check(certificate, method)
    except CertificationError as error:
        return f"proves nothing: {error}"
    return str(certificate)


def _tableau(method: Any, digits: int) -> str:
    """Return c, a and b in columns; c before the rows of a, ``b^`` before second weights."""
    *rows, last = method.layout.cut(method.coefficients)
    labels = [_text(x, digits) for x in _sums(method)]
    lines = []
    weights = [rows.pop(), last] if method.layout.pair else [last]
    for c, row in zip(labels, rows, strict=True):
        lines.append([c, *(_text(x, digits) for x in row)])
    for label, row in zip(("b", "b^"), weights, strict=False):
        lines.append([label, *(_text(x, digits) for x in row)])
    width = method.stages + 1
    padded = [[*line, *[""] * (width - len(line))] for line in lines]
    text = table([[line[0], "│", *line[1:]] for line in padded], left=2).splitlines()
    rule = "─" * max(map(len, text))
    return "\n".join([*text[: method.stages], rule, *text[method.stages :]])


def _sums(method: Method) -> list[Coefficient]:
    return [Coefficient.read(str(sum(row))) for row in method.exact[0]]


def _text(x: Coefficient, digits: int) -> str:
    text = x.text
    return text if len(text) <= digits + 1 and "x" not in text else f"{float(x.value):.{digits}g}"
