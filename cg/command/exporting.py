"""``export``: a method as data, a table or code."""

import ast
from pathlib import Path
from typing import Any

import click

from cg import frames
from cg.command.arguments import METHOD, check_output, output_option
from cg.construction.formats import FORMATS, export
from cg.construction.methods.method import Method
from cg.frames import Frame
from cg.support.parsing import write_file
from cg.support.quads import MAX_WRITTEN


class FrameArgument(click.ParamType):  # type: ignore[type-arg]
    """Type of an option that is a frame, written as in Python."""

    name = "FRAME"

    def convert(self, value: Any, param: Any, ctx: Any) -> Frame:
        """Return the frame; end the command with an error if there is none."""
        try:
            frame = _evaluated(ast.parse(value, mode="eval").body)
        except (SyntaxError, TypeError, ValueError) as error:
            self.fail(f"{value!r} is no frame: {error}", param, ctx)
        if not isinstance(frame, Frame):
            self.fail(f"{value!r} is no frame such as SO3()", param, ctx)
        return frame


def _evaluated(node: ast.expr) -> Any:
    """Return the value of an expression: literals and calls of names in `cg.frames`."""
    if not isinstance(node, ast.Call):
        if isinstance(node, ast.Tuple | ast.List):
            return tuple(map(_evaluated, node.elts))
        try:
            return ast.literal_eval(node)
        except ValueError:  # whose message has an address in memory
            raise ValueError(f"{ast.unparse(node)!r} is no number, text or call") from None
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name not in frames.__all__:
        raise ValueError(f"cg.frames has no {ast.unparse(node.func)!r}")
    named = {str(keyword.arg): _evaluated(keyword.value) for keyword in node.keywords}
    return getattr(frames, name)(*map(_evaluated, node.args), **named)


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
@click.option(
    "--frame", type=FrameArgument(), metavar="FRAME",
    help='A frame whose flow a file in C has, as in Python, such as "SO3()".',
)  # fmt: skip
@output_option("Output file; standard output by default.")
def export_command(
    method: Method,
    format: str,
    digits: int | None,
    certificate: Path | None,
    frame: Frame | None,
    output: Path | None,
) -> None:
    """Write a method as a data file, a LaTeX table, or code for one step.

    The certificate of FILE.toml is the file FILE.certificate.toml in the same folder.

    FORMAT is json, toml, latex, python or c.

    \b
    Examples:
      crouch-grossman export CG4a latex
      crouch-grossman export CF6c c -o cf6c.h
      crouch-grossman export CF4 c --frame "UnitQuaternion(scalar_first=True)"
      crouch-grossman export Leapfrog c --frame "PhaseSpace(UnitQuaternion(), [1, 2, 2.5])"
      crouch-grossman export CG5a json --digits 60
      crouch-grossman export mine.toml c --digits 40 --certificate proof.toml
    """
    from cg.construction.proofs import Certificate

    check_output(output)
    proof = None if certificate is None else Certificate.load(certificate)
    text = export(method, format, digits=digits, certificate=proof, frame=frame)
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        write_file(output, text)
