"""``plot``: plots of a method."""

from io import BytesIO
from pathlib import Path

import click

from cg.command.arguments import METHOD, check_output, output_option
from cg.construction.methods.method import Method
from cg.support.parsing import write_file


@click.command("plot", short_help="Plot a method.")
@click.argument("method", metavar="NAME|FILE", type=METHOD)
@click.argument("what", metavar="WHAT", type=click.Choice(["points", "tableau", "stability"]))
@output_option("Output file: .svg, .png, .pdf, ….", required=True)
def plot_command(method: Method, what: str, output: Path) -> None:
    """Plot the points, the tableau or the stability region of a method.

    \b
    Examples:
      crouch-grossman plot CF5a points -o cf5a.svg
      crouch-grossman plot "DP5(4)" stability -o stability.png
    """
    check_output(output)
    import matplotlib as mpl

    mpl.use("Agg")  # no window is opened
    from cg import plot

    draw = {"points": plot.points, "tableau": plot.tableau, "stability": plot.stability_region}
    picture = BytesIO()
    kind = output.suffix[1:] or None
    draw[what](method).figure.savefig(picture, format=kind, bbox_inches="tight")
    write_file(output, picture.getvalue())
