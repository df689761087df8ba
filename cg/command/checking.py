"""``check``: diagnosis of a method."""

import click

from cg.command.arguments import MethodArgument, as_json, count_option, json_option, say
from cg.command.main import NO
from cg.construction.diagnosis import Diagnosis, diagnose, diagnose_file


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
