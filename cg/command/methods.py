"""``list`` and ``show`` the methods of the catalogue, ``export`` one as data, a table or code."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import (
    NEGATIVE,
    check_output,
    count_option,
    json_option,
    output_option,
    print_json,
    print_text,
)
from cg.construction.catalogue import is_file, methods, resolve_method
from cg.construction.catalogue.summary import MethodSummary, summary_of
from cg.construction.drawings import align_columns, draw_method
from cg.construction.formats import FORMATS, export
from cg.construction.methods.method import Method
from cg.construction.proofs import Certificate, CertificationError, certificate_of, check, proved
from cg.construction.proofs.packed import certificate_beside
from cg.support.parsing import visible, write_file

_KINDS = ("Crouch-Grossman", "commutator-free", "implicit", "Munthe-Kaas", "Magnus", "splitting")


@click.command("list", short_help="List the methods of the catalogue.")
@count_option("--order", "Only methods of this order.")
@count_option("--min-order", "Only methods of this order or higher.")
@click.option("--pair", is_flag=True, help="Only pairs.")
@click.option("--proved", "only_proved", is_flag=True, help="Only methods proved in full.")
@click.option("--kind", type=click.Choice(_KINDS, case_sensitive=False), help="Only this kind.")
@json_option
def list_command(
    order: int | None, min_order: int | None, pair: bool, only_proved: bool, kind: str | None,
    in_json: bool,
) -> int:  # fmt: skip
    """List the methods of the catalogue, sorted by order, evaluations and flows.

    Numbers in brackets are the order of the second result of a pair, and the flows with the error
    estimate. The error is the principal error, the norm of the residuals of the next order.
    "proved" says whether a certificate proves the order: "yes", "in part" or "no"; "classical"
    methods have the order of their tableau.

    Exits with 1 if no method matches.

    \b
    Examples:
      crouch-grossman list
      crouch-grossman list --min-order 5 --pair
      crouch-grossman list --order 6 --proved
      crouch-grossman list --kind implicit --json
    """
    selected = [
        (summary, proof)
        for summary, proof in ((summary_of(each), proved(each)) for each in methods.values())
        if (order is None or summary.order == order)
        and (min_order is None or summary.order >= min_order)
        and (not pair or summary.embedded_order is not None)
        and (not only_proved or proof == "yes")
        and (kind is None or summary.kind == kind)
    ]
    selected.sort(key=lambda each: (each[0].order, each[0].evaluations, each[0].flows))
    if in_json:
        print_json([{**asdict(summary), "proved": proof} for summary, proof in selected])
    elif selected:
        heads = ("name", "kind", "proved", "order", "evaluations", "flows", "error")
        print_text(align_columns([heads, *(_row(*each) for each in selected)], left=3))
    else:
        print_text("no method of the catalogue matches these options")
    return 0 if selected else NEGATIVE


def _row(summary: MethodSummary, proof: str) -> tuple[str, ...]:
    pair = "" if summary.embedded_order is None else f"({summary.embedded_order})"
    error = "" if summary.principal_error is None else f"{summary.principal_error:.3g}"
    order = f"{'≈' * summary.approximate}{summary.order}{pair}"
    return (
        summary.name, summary.kind, proof, order, str(summary.evaluations), summary.all_flows, error
    )  # fmt: skip


@click.command("show", short_help="Show all data of one method.")
@click.argument("method", metavar="NAME|FILE")
@json_option
def show_command(method: str, in_json: bool) -> None:
    """Show the order, cost, principal error, stability, proof, source and coefficients of a method.

    Numbers that are infinite or unknown are left out. Points are drawn as a tree: a flow leads from
    each point to those below it. F1 is the field frozen at stage 1. Below them is the tableau c, a,
    b of the method where flows commute. JSON has all digits.

    \b
    Examples:
      crouch-grossman show CG4a
      crouch-grossman show my_method.toml --json
    """
    shown = resolve_method(method)
    facts: dict[str, Any] = {
        **asdict(summary_of(shown)),
        "certificate": _certificate(shown),
        "source": shown.source,
    }
    if in_json:
        print_json({**facts, "method": json.loads(export(shown, "json"))})
        return
    rows = [
        (key.replace("_", " "), visible(str(fact)))
        for key, fact in facts.items()
        if fact is not None
    ]
    print_text(f"{align_columns(rows)}\n\n{draw_method(shown)}")


def _certificate(method: Method) -> str | None:
    try:
        beside = certificate_beside(method)
        if beside is not None:  # a certificate of the user is proved before it is shown
            check(beside, method)
    except CertificationError as error:
        return f"proves nothing: {error}"
    try:
        return str(beside or certificate_of(method))
    except CertificationError:
        return None


@click.command("export", short_help="Write a method as data or code.")
@click.argument("method", metavar="NAME|FILE")
@click.argument("format", type=click.Choice(sorted(FORMATS)))
@count_option(
    "--digits", "Significant digits; those beyond the stored ones come from the certificate."
)
@click.option(
    "--certificate", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Certificate; by default that of the catalogue, or M.certificate.toml beside M.toml.",
)  # fmt: skip
@output_option
def export_command(
    method: str, format: str, digits: int | None, certificate: Path | None, output: Path | None
) -> None:
    """Write a method as a data file, a LaTeX table, or code for one step.

    \b
    Examples:
      crouch-grossman export CG4a latex
      crouch-grossman export CF6c c -o cf6c.h
      crouch-grossman export CG5a json --digits 60
      crouch-grossman export mine.toml c --digits 40 --certificate proof.toml
    """
    check_output(output, method if is_file(method) else None, certificate)
    proof = None if certificate is None else Certificate.load(certificate)
    text = export(method, format, digits=digits, certificate=proof)
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        write_file(output, text)
