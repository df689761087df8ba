"""``runs``: results of long runs, from their store."""

from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from functools import wraps
from pathlib import Path
from typing import Any

import click

from cg.command.arguments import as_json, check_output, count_option, json_option, say, table
from cg.command.main import NO
from cg.construction.conditions import Rows
from cg.construction.results import StoredSolution, best, families, publish, solutions
from cg.construction.results.solutions import OBJECTIVES
from cg.construction.runs import RunSummary, Store, StoredRun

_FILE = click.argument("file", metavar="FILE", type=click.Path(exists=True, dir_okay=False))
_NUMBER = click.argument("number", metavar="RUN", type=click.IntRange(1))
_SETTINGS = ("order", "stages", "flows", "seed")
_MAX_FOR_FAMILIES = 200  # solutions; the time grows with their number


@click.group("runs", short_help="Show results of long runs, and make methods of them.")
def runs_command() -> None:
    """Show results of long runs, and make methods of them.

    FILE is the file of --store.

    \b
    Examples:
      crouch-grossman runs list runs.db
      crouch-grossman runs best runs.db 1 --objective principal_error
      crouch-grossman runs publish runs.db 1 Mine
    """


def _of_run(function: Callable[..., int]) -> Callable[..., int]:
    """Pass the store and the run that the arguments name to a function."""

    @wraps(function)
    def call(file: str, number: int, **options: Any) -> int:
        with Store(file, read=True) as store:
            try:
                run = store.run(number)
            except KeyError as problem:
                raise click.BadParameter(str(problem.args[0]), param_hint="RUN") from None
            return function(store, run, **options)

    return call


@runs_command.command("list", short_help="List the runs in a file.")
@_FILE
@json_option
def list_runs(file: str, in_json: bool) -> int:
    """List the runs in a file: settings, numbers of starts, smallest f."""
    with Store(file, read=True) as store:
        runs = store.runs()
    if in_json:
        as_json([_data(run) for run in runs])
        return 0
    heads = ("run", "kind", *_SETTINGS, "starts", "solved", "failed", "smallest f", "")
    say(table([heads, *map(_row, runs)]))
    return 0


def _row(run: RunSummary) -> tuple[str, ...]:
    settings = ("-" if (value := run.settings.get(k)) is None else str(value) for k in _SETTINGS)
    counts = (str(count) for count in (run.starts, run.solved, run.failed))
    smallest = "-" if run.best is None else f"{run.best:.1e}"
    return str(run.number), run.kind, *settings, *counts, smallest, "running" * run.running


@runs_command.command("show", short_help="Show one run.")
@_FILE
@_NUMBER
@json_option
@_of_run
def show_run(store: Store, run: StoredRun, in_json: bool) -> int:
    """Show one run: settings, rate, distribution of residuals, number of distinct solutions."""
    (summary,) = (each for each in store.runs() if each.number == run.number)
    distinct = list(solutions(run))
    groups = families(distinct[:_MAX_FOR_FAMILIES])
    data = {
        **_data(summary),
        "decades": {str(decade): count for decade, count in run.decades().items()},
        "distinct": len(distinct),
        "families_at_most": len(groups) + max(0, len(distinct) - _MAX_FOR_FAMILIES),
        "failures": [[failure.index, failure.message] for failure in run.failures()],
    }
    if in_json:
        as_json(data)
        return 0
    settings = {key: value for key, value in summary.settings.items() if value is not None}
    if "rows" in settings:
        settings["rows"] = Rows(settings["rows"]).name.lower()
    say(f"run {run.number}, {summary.kind}, begun {_time(summary.created)}")
    say(", ".join(f"{key} {value}" for key, value in settings.items() if key != "tree"))
    rate = summary.starts / summary.seconds if summary.seconds else 0.0
    say(
        f"{summary.starts} starts in {summary.seconds:.0f} s of one core ({rate:.3g} a second), "
        f"{summary.solved} solved, {summary.failed} failed"
    )
    say(f"{len(distinct)} distinct solutions in at most {data['families_at_most']} families")
    for index, message in data["failures"]:
        say(f"start {index} failed: {message}")
    say("\nnumber of starts by final f")
    most = max(run.decades().values(), default=1)
    for decade, count in run.decades().items():
        say(f"  1e{decade:<4} {count:>7}  {'#' * max(1, round(40 * count / most))}")
    return 0


@runs_command.command("best", short_help="List the best solutions of a run.")
@_FILE
@_NUMBER
@click.option("--objective", type=click.Choice(OBJECTIVES), default=OBJECTIVES[0],
              show_default=True, help="What to minimise.")  # fmt: skip
@count_option("--count", "Solutions at most.", default=10, show_default=True)
@json_option
@_of_run
def best_of_run(_: Store, run: StoredRun, objective: str, count: int, in_json: bool) -> int:
    """List the best distinct solutions of a run as the solver left them.

    --abscissae, --bound and --minimise of a search aren't stored, and don't apply here. Exits with
    1 if there are no solutions.
    """
    chosen = [_solution_data(solution) for solution in best(run, objective, count)]
    if in_json:
        as_json(chosen)
    elif chosen:
        keys = ("start", "stages", "flows", "rank", "largest_coefficient", "principal_error")
        rows = [
            [f"{x:.3g}" if isinstance(x, float) else str(x) for x in map(data.__getitem__, keys)]
            for data in chosen
        ]
        say(table([[key.replace("_", " ") for key in keys], *rows], left=0))
    else:
        say("no start led to a method")
    return 0 if chosen else NO


@runs_command.command("publish", short_help="Make a method of a solution.")
@_FILE
@_NUMBER
@click.argument("name", metavar="NAME")
@count_option("--start", "The start; by default that of the smallest principal error.", least=0)
@click.option("--folder", type=click.Path(file_okay=False, exists=True, path_type=Path),
              default=Path(), show_default=True, help="Folder for the files.")  # fmt: skip
@count_option("--steps", "Steps of the optimisation of the principal error.", least=0,
              default=60, show_default=True)  # fmt: skip
@_of_run
def publish_start(
    _: Store, run: StoredRun, name: str, start: int | None, folder: Path, steps: int
) -> int:
    """Make a method of a solution: optimise, refine and certify it, and write NAME.toml.

    The certificate is NAME.certificate.toml. Exits with 1 if the order isn't proved, or only in
    part; the method is written nevertheless.
    """
    check_output(folder / name, "--folder")
    made = publish(run, name, folder, number=start, max_iterations=steps)
    say(f"{made.method!r}")
    say(f"principal error {made.initial_principal_error:.3g}, now {made.principal_error:.3g}")
    if made.reason:
        say(f"not proved{'' if made.certificate is None else ' in full'}: {made.reason}")
    if made.certificate is not None:
        say(str(made.certificate))
    for file in made.files:
        say(f"wrote {file}")
    return NO if made.reason else 0


def _solution_data(solution: StoredSolution) -> dict[str, Any]:
    layout = solution.candidate.system.layout
    return {
        "start": solution.start.number,
        "stages": layout.stages,
        "flows": int(solution.objective("flows")),
        "rank": solution.candidate.rank,
        "largest_coefficient": solution.candidate.largest,
        "principal_error": solution.principal_error,
        "largest_residual": solution.start.largest_residual,
        "seconds": solution.start.seconds,
    }


def _data(run: RunSummary) -> dict[str, Any]:
    data = asdict(run) | {"created": _time(run.created), "changed": _time(run.changed)}
    return {"run": data.pop("number"), "smallest_f": data.pop("best"), **data}


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
