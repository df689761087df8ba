"""``certify`` proves the orders of methods, ``check`` diagnoses one."""

import time
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import (
    METHOD,
    MethodArgument,
    as_json,
    check_output,
    count_option,
    json_option,
    output_option,
    say,
)
from cg.command.main import NO
from cg.construction.catalogue import methods
from cg.construction.diagnosis import Diagnosis, diagnose, diagnose_file
from cg.construction.methods.method import Method
from cg.construction.proofs import Certificate, CertificationError, certificate_of, certify, check
from cg.construction.proofs.packed import certificate_names


@click.command("certify", short_help="Prove the orders of methods.")
@click.argument("items", metavar="NAME|FILE ...", nargs=-1, type=METHOD)
@click.option(
    "--check", "again", is_flag=True,
    help="Prove stored certificates again: of methods of the catalogue, by default of all of them, "
    "or those beside FILEs.",
)  # fmt: skip
@output_option("Output file of the certificate.")
@click.option(
    "--complete", is_flag=True,
    help="Demand a complete proof: without it some conditions may only be shown to be small.",
)  # fmt: skip
@json_option
def certify_command(
    items: tuple[Method, ...], again: bool, output: Path | None, complete: bool, in_json: bool
) -> int:
    """Prove the order of a method in ball arithmetic.

    Prints the certificate: a box around the coefficients contains exactly one method that has the
    order exactly, or almost for a proof in part.

    Exits with 1 if a proof fails.

    \b
    Examples:
      crouch-grossman certify CG4a
      crouch-grossman certify my_method.toml -o my_method.certificate.toml
      crouch-grossman certify CF5a --complete
      crouch-grossman certify --check
    """
    if again:
        if complete or output is not None:
            raise click.UsageError("--check excludes --complete and --output")
        return _check_stored(items or tuple(map(methods.__getitem__, certificate_names())), in_json)
    if len(items) != 1:
        raise click.UsageError(f"name one method, or pass --check; got {len(items)} methods")
    check_output(output)
    certificate, entry = _prove(items[0], complete=complete)
    if certificate is not None and output is not None:
        certificate.save(output)
    if in_json:
        as_json(entry)
    elif certificate is None:
        say(f"not proved: {entry['message']}")
    else:
        say(f"{certificate}" if output else f"{certificate.dumps()}\n{certificate}")
    return 0 if certificate else NO


def _check_stored(items: tuple[Method, ...], in_json: bool) -> int:
    entries = []
    for method in items:
        begin = time.perf_counter()
        certificate, entry = _prove(method, again=True)
        entries.append(entry)
        if not in_json:
            failed = "" if certificate else f"FAILED {method.name}: "
            say(f"{failed}{entry['message']} [{time.perf_counter() - begin:.1f} s]")
    outcomes = [entry["proved"] for entry in entries]
    if in_json:
        as_json(entries)
    else:
        words = {"in part": "in part", "no": "failed"}
        others = (f", {outcomes.count(k)} {word}" for k, word in words.items() if k in outcomes)
        say(f"{outcomes.count('yes')} proved{''.join(others)}")
    return NO if "no" in outcomes else 0


def _prove(
    method: Method, *, complete: bool = False, again: bool = False
) -> tuple[Certificate | None, dict[str, Any]]:
    """Return a new or a stored certificate, proved, and its summary; None and why if that fails."""
    try:
        certificate = certificate_of(method) if again else certify(method, complete=complete)
        if again:
            check(certificate, method)
    except TypeError as error:
        raise click.BadParameter(str(error), param_hint="NAME|FILE") from None
    except CertificationError as error:
        return None, {"name": method.name, "proved": "no", "message": str(error)}
    bound = certificate.bound
    return certificate, {
        "name": certificate.name,
        "proved": certificate.proved,
        "order": certificate.order,
        "embedded_order": certificate.embedded_order,
        "radius": str(certificate.radius).lower(),
        "left_out": len(certificate.left_out),
        "bound": None if bound is None else str(bound).lower(),
        "fixed": list(certificate.fixed),
        "message": str(certificate),
    }


@click.command("check", short_help="Determine the order of a method and recognise mistakes.")
@click.argument("diagnosis", metavar="NAME|FILE", type=MethodArgument(diagnose, diagnose_file))
@count_option("--order", "Required order.")
@json_option
def check_command(diagnosis: Diagnosis, order: int | None, in_json: bool) -> int:
    """Determine the order of a method and recognise mistakes in its coefficients.

    Prints the order, the first violated order condition with its tree, and mistakes: a wrong
    coefficient with the value that it should have, too few digits, second weights equal to the
    first, rows that don't sum to c, a classical tableau that isn't lifted.

    A file is TOML or JSON with a, b and optionally b_embedded, c, name and source; or with points,
    as in the catalogue. Numbers are strings, which keep all digits. Decimals with eight places or
    more count as rounded, shorter ones and fractions as exact.

    Exits with 1 if a mistake is recognised, or the order is lower than --order.

    \b
    Examples:
      crouch-grossman check CG4a
      crouch-grossman check my_method.toml --order 4
      crouch-grossman check my_method.json --json
    """
    reached = max(diagnosis.order, diagnosis.method.order)
    too_low = order is not None and reached < order
    if in_json:
        as_json(diagnosis.as_dict())
    else:
        say(str(diagnosis))
        if too_low:
            say(f"the order is {reached}, less than {order}")
    return NO if too_low or diagnosis.mistakes else 0
