"""``certify``: proof of the order of a method."""

from pathlib import Path

import click

from cg.command.arguments import METHOD, as_json, check_output, json_option, output_option, say
from cg.command.main import NO
from cg.method.method import Method
from cg.proofs import CertificationError, certify


@click.command("certify", short_help="Prove the order of a method.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@output_option("Output file of the certificate.")
@click.option(
    "--complete", is_flag=True,
    help="Demand a complete proof: without it some conditions may only be shown to be small.",
)  # fmt: skip
@json_option
def certify_command(method: Method, output: Path | None, complete: bool, in_json: bool) -> int:
    """Prove the order of a method in ball arithmetic.

    Prints the certificate: a box around the coefficients contains exactly one method that has the
    order exactly, or almost for a proof in part. `python -m cg.proofs --check` proves the
    certificates of the catalogue again.

    Exits with 1 if the proof fails.

    \b
    Examples:
      crouch-grossman certify CG4a
      crouch-grossman certify my_method.toml -o my_method.certificate.toml
      crouch-grossman certify CF5a --complete
    """
    check_output(output)
    try:
        certificate = certify(method, complete=complete)
    except TypeError as error:
        raise click.BadParameter(str(error), param_hint="NAME|FILE") from None
    except CertificationError as error:
        if in_json:
            as_json({"name": method.name, "proved": "no", "message": str(error)})
        else:
            say(f"not proved: {error}")
        return NO
    if output is not None:
        certificate.save(output)
    bound = certificate.box.bound
    if in_json:
        as_json(
            {
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
        )
    else:
        if output is None:
            say(certificate.dumps())
        say(str(certificate))
    return 0
