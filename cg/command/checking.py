"""``check``: what a method really is."""

from __future__ import annotations

import click

from cg.analysis.diagnosis import Diagnosis, diagnose, diagnose_file
from cg.structure.points import MethodError

from .arguments import MethodArgument, as_json, is_file, json_option, named, say
from .main import NO

__all__ = ["check_command"]


class _Diagnosed(MethodArgument):
    def convert(
        self, value: str, param: click.Parameter | None, ctx: click.Context | None
    ) -> Diagnosis:
        try:
            return diagnose_file(value) if is_file(value) else diagnose(named(value))
        except (MethodError, OSError, ValueError) as problem:
            raise self._refused(param, problem) from None


@click.command("check", short_help="Find out what a method really is.")
@click.argument("found", metavar="NAME|FILE", type=_Diagnosed())
@click.option("--order", type=click.IntRange(1), help="The order that the method must have.")
@json_option
def check_command(found: Diagnosis, order: int | None, in_json: bool) -> int:
    """Find out which order a method really has, and what is wrong with it.

    Prints the order, the first order condition that fails, drawn as a tree, and known mistakes:
    rows in reverse, a transposed, a coefficient changed, digits cut short, second weights equal
    to the first, rows that don't sum to c, a flat tableau used as it stands.

    A file is TOML or JSON with a, b, and if you like b_embedded, c, name and source; or with
    points, as in the catalogue. Numbers are texts, so that all digits are kept.

    Exits with 1 if a mistake is recognised, or the order is lower than --order.

    \b
    Examples:
      crouch-grossman check CG4a
      crouch-grossman check my_method.toml --order 4
      crouch-grossman check my_method.json --json
    """
    reached = max(found.order, found.method.order)
    too_low = order is not None and reached < order
    if in_json:
        as_json(found.as_dict())
    else:
        say(str(found))
        if too_low:
            say(f"the order is {reached}, less than {order}")
    return NO if too_low or found.mistakes else 0
