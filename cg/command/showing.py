"""``show``: all data of one method."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import click

from cg.analysis.diagnosis import draw_points
from cg.catalogue.summary import MethodSummary, summary_of
from cg.formats import export
from cg.formats.digits import MAX_DIGITS, known_digits, numbers_of
from cg.method.coefficients import Coefficient
from cg.method.commutator_free import CommutatorFree
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.support.parsing import visible
from cg.support.quads import to_decimal

from .arguments import METHOD, as_json, json_option, say, table

_DIGITS = 6  # printed by default
_MAX_BITS = 128  # of a denominator; longer fractions are shown as decimals


@click.command("show", short_help="Show all data of one method.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@click.option(
    "--digits", type=click.IntRange(1, MAX_DIGITS), metavar="N",
    help="Significant digits, by default 6; beyond the stored ones they come from the certificate.",
)  # fmt: skip
@json_option
def show_command(method: Method, digits: int | None, in_json: bool) -> None:
    """Show the tableau or points, order, principal error, stability, proof and source of a method.

    Points are drawn as a tree: a flow leads from each point to those below it. F1 is the field
    frozen at stage 1. JSON has all digits.

    \b
    Examples:
      crouch-grossman show CG4a
      crouch-grossman show CF5a --digits 16
      crouch-grossman show my_method.toml --json
    """
    summary, certificate = summary_of(method), _certificate(method)
    if in_json:
        import json

        data = {**summary.as_dict(), "certificate": certificate, "source": method.source}
        as_json(data | {"method": json.loads(export(method, "json"))})
        return
    if digits is not None and digits > (known_digits(method) or digits):
        method = numbers_of(method, digits, None).rounded()
    drawing = _drawing(method, digits or _DIGITS)
    say(f"{visible(method.name) or 'a method'}, {summary.kind}\n")
    lines = [
        *_numbers(summary),
        ("certificate", certificate or "none"),
        ("source", visible(method.source)),
    ]
    width = max(len(label) for label, _ in lines)
    for label, value in lines:
        say(f"  {label.ljust(width)}  {value}".rstrip())
    say("\n" + drawing)


def _drawing(method: Method, digits: int) -> str:
    """Return the coefficients of a method as text: points as a tree, others in columns."""
    if isinstance(method, CommutatorFree):
        return draw_points(method, digits=digits)
    if isinstance(method, MagnusMethod):
        rows = {"nodes": [method.nodes], "flow": method.weights}
        rows |= {"flow of the second result": method.embedded_weights or ()}
        rows |= {"flow of the third": (method.third_weights,) if method.third_weights else ()}
        lines = [
            [label, "│", *(_text(x, digits) for x in row)]
            for label, block in rows.items()
            for row in block
        ]
        return table(lines)
    return _tableau(method, digits)


def _numbers(summary: MethodSummary) -> list[tuple[str, str]]:
    order = f"{summary.order}" if summary.embedded_order is None else (
        f"{summary.order}, of the second result {summary.embedded_order}"
    )  # fmt: skip
    flows = str(summary.flows)
    if summary.pair_flows != summary.flows:
        flows += f", {summary.pair_flows} with the estimate"
    stability = [
        ("stable on the real axis", f"from 0 to -{_number(summary.real_stability, 'infinity')}"),
        (
            "stable on the imaginary axis",
            f"from 0 to {_number(summary.imaginary_stability, 'infinity')}",
        ),
    ]
    return [
        ("order", order + (", up to a residual that is stored" if summary.approximate else "")),
        ("evaluations", str(summary.evaluations)),
        ("flows", flows),
        ("principal error", _number(summary.principal_error, "unknown")),
        *([("not computed", summary.not_computed)] if summary.not_computed else stability),
    ]


def _number(x: float | None, other: str) -> str:
    return other if x is None else f"{x:.4g}"


def _certificate(method: Method) -> str | None:
    from cg.proofs import CertificationError, certificate_of, check
    from cg.proofs.files import certificate_beside

    try:
        beside = None if method.file is None else certificate_beside(method.file, method)
        if beside is not None:  # nothing of a file of the user's is believed
            check(beside, method)
    except CertificationError as error:
        return f"proves nothing: {error}"
    try:
        return str(beside or certificate_of(method))
    except CertificationError:
        return None


def _tableau(method: Any, digits: int) -> str:
    """Return c, a and b in columns; ``b^`` stands before the second weights."""
    *rows, last = method.layout.cut(method.coefficients)
    labels = [_sum(row, digits) for row in method.exact[0]]
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


def _sum(row: Sequence[Fraction], digits: int) -> str:
    total = sum(row, Fraction(0))
    # Python may be unable to write a longer fraction
    text = str(total) if total.denominator.bit_length() <= _MAX_BITS else ""
    return text if 0 < len(text) <= digits + 1 else to_decimal(total, digits)


def _text(x: Coefficient, digits: int) -> str:
    text = x.text
    return text if len(text) <= digits + 1 and "x" not in text else to_decimal(x.value, digits)
