"""``certify`` proves the orders of methods, ``check`` diagnoses one."""

from collections import Counter
from pathlib import Path

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
from cg.construction.catalogue import is_file, resolve_method
from cg.construction.diagnosis import diagnose, diagnose_file
from cg.construction.proofs import CertificationError, certificate_of, certify, check
from cg.construction.proofs.packed import certificate_names


@click.command("certify", short_help="Prove the orders of methods.")
@click.argument("names", metavar="NAME|FILE ...", nargs=-1)
@click.option(
    "--check", "again", is_flag=True,
    help="Prove stored certificates again: of methods of the catalogue, by default of all of them, "
    "or those beside FILEs.",
)  # fmt: skip
@output_option
@click.option(
    "--complete", is_flag=True,
    help="Demand a complete proof: without it some conditions may only be shown to be small.",
)  # fmt: skip
@json_option
def certify_command(
    names: tuple[str, ...], again: bool, output: Path | None, complete: bool, in_json: bool
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
    if again and (complete or output is not None):
        raise click.UsageError("--check excludes --complete and --output")
    if not again and len(names) != 1:
        raise click.UsageError(f"name one method, or pass --check; got {len(names)} methods")
    check_output(output, *filter(is_file, names))
    entries = []
    for name in names or certificate_names():
        method = resolve_method(name)
        try:
            certificate = certificate_of(method) if again else certify(method, complete=complete)
            if again:
                check(certificate, method)
        except CertificationError as error:
            entries.append({"name": method.name, "proved": "no", "message": str(error)})
            text = f"not proved: {error}"
        else:
            text = str(certificate)
            entries.append({"name": method.name, "proved": certificate.proved, "message": text})
            if output is not None:
                certificate.save(output)
            elif not again:
                text = f"{certificate.dumps()}\n{text}"
        if not in_json:
            print_text(text)
    counts = Counter(entry["proved"] for entry in entries)
    if in_json:
        print_json(entries if again else entries[0])
    elif again:
        print_text(f"{counts['yes']} proved, {counts['in part']} in part, {counts['no']} not")
    return NEGATIVE if counts["no"] else 0


@click.command("check", short_help="Determine the order of a method and recognise mistakes.")
@click.argument("method", metavar="NAME|FILE")
@count_option("--order", "Required order.")
@json_option
def check_command(method: str, order: int | None, in_json: bool) -> int:
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
    diagnosis = diagnose_file(method) if is_file(method) else diagnose(method)
    reached = max(diagnosis.order, diagnosis.method.order)
    too_low = order is not None and reached < order
    if in_json:
        print_json(diagnosis.as_dict())
    else:
        print_text(str(diagnosis))
        if too_low:
            print_text(f"the order is {reached}, less than {order}")
    return NEGATIVE if too_low or diagnosis.mistakes else 0
