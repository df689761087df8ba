"""``export``: a method as data, a table or code."""

from pathlib import Path

import click

from cg.command.arguments import METHOD, check_output, output_option
from cg.construction.formats import FORMATS, export
from cg.construction.methods.method import Method
from cg.support.parsing import write_file
from cg.support.quads import MAX_WRITTEN


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
    method: Method, format: str, digits: int | None, certificate: Path | None, output: Path | None
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
    from cg.construction.proofs import Certificate

    check_output(output)
    proof = None if certificate is None else Certificate.load(certificate)
    text = export(method, format, digits=digits, certificate=proof)
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        write_file(output, text)
