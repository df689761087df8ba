"""The command ``reproduce-paper``."""

import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import click

from cg.command.arguments import count_option
from cg.command.main import main as run_command
from cg.construction.runs import StoreError
from cg.support.parallel import available_cores

from .blocks import Settings
from .report import ITEMS, select
from .run import Display, check_output, run

FOLDER = Path("reproduce/out")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``reproduce-paper``; arguments and exit codes are those of `cg.command.main`."""
    return run_command(arguments, program="reproduce-paper", command=reproduce_command)


def _read_items(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> list[str]:
    """Return the names of items in lists separated by commas."""
    if not values:
        return []
    names = [name.strip() for value in values for name in value.split(",")]
    unknown = [name for name in names if name not in ITEMS]
    if unknown:
        raise click.BadParameter(f"{', '.join(map(repr, unknown))}: items are {', '.join(ITEMS)}")
    return names


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR",
    help="Folder for report.html, results.json, figures and stored searches; by default "
    f"{FOLDER}, with --full {FOLDER / 'full'}.",
)  # fmt: skip
@click.option(
    "--full",
    is_flag=True,
    help="The extensive search, 20 times as many starts: about an hour of one core.",
)
@click.option(
    "--only", multiple=True, callback=_read_items, metavar="ITEM[,ITEM...]",
    help="Run these items and what they need; may be given several times.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of random starts."
)
@count_option("--workers", "Threads; all cores by default.")
@click.option("--list", "listing", is_flag=True, help="List the items and exit.")
def reproduce_command(
    out: Path | None,
    full: bool,
    only: list[str],
    seed: int,
    workers: int | None,
    listing: bool,
) -> int:
    """Reproduce the figures, tables and claims of the paper, and more, as one report.

    The numbers do not depend on the number of workers.

    \b
    Examples:
      reproduce-paper --list
      reproduce-paper --only fig4.1 --out report
    """
    if listing:
        for item in ITEMS.values():
            click.echo(f"{item.name:16} {item.title}")
        return 0
    settings = Settings(seed, full)
    out = out or (FOLDER / "full" if full else FOLDER)
    check_output(out)
    items = select(only or ITEMS)
    display = Display(sys.stderr, items)
    begun = time.perf_counter()
    try:
        with closing(display):
            run(items, out, settings, workers or available_cores(), display)
    except StoreError as error:
        error.add_note("if you delete that file, its content is computed again")
        raise
    except (OSError, KeyboardInterrupt) as error:
        error.add_note(f"finished items and searches are kept in {out}")
        raise
    seconds = time.perf_counter() - begun
    click.echo(f"{out / 'report.html'} written in {seconds:.0f} s", err=True)
    return 0
