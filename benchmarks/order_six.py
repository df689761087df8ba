"""Time of one core to find an exact method of order six from random starts."""

from __future__ import annotations

import time
from pathlib import Path

from cg.construction import ConstructionSettings, construct, run_attempt

from .contest import Contestant, compete, contestants
from .record import Aim, Result, Row

TITLE = "Order six"
_STAGES = (16, 13, 12)
_SEED = 1


def method_text(budget: float) -> str:
    """Return how the times are measured."""
    return (
        f"All solvers run the same random starts, {budget:.0f} s of one core each. The number is "
        "the time used divided by the number of exact methods found, that is the average cost of "
        "one."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure direct solution with many stages, and construction with few."""
    budget, turns = (15.0, 1) if quick else (40.0, 4)
    rows: list[Row] = []
    notes = []
    for stages in (24, 20):
        contest = contestants(6, stages, most=budget)
        if stages != 24:
            contest = {"minimum-norm": contest["minimum-norm"]}
        counts = compete(contest, budget, turns)
        notes.append(f"- {stages} stages, exact methods of all starts: {counts}.")
        rows += _direct_rows(stages, contest)
    for stages in _STAGES:
        tries, exact, seconds = _construct(stages, 3.0 if quick else 2.0 * budget)
        rows.append(
            Row(
                f"an exact method, {stages} stages, `cg.construct`",
                seconds / exact if exact else float("nan"),
                "core-seconds",
                aim=Aim(60.0, above=False, of="value") if stages == 16 else None,
            )
        )
        notes.append(
            f"- `cg.construct(order=6, stages={stages}, seed={_SEED})`: {exact} of {tries} tries "
            f"in {seconds:.0f} s. The other solvers find no such method."
        )
    return Result(TITLE, method_text(budget), tuple(rows), ("\n".join(notes),))


def _direct_rows(stages: int, contest: dict[str, Contestant]) -> list[Row]:
    """Compare the solver of this package with the others, if there are any."""
    quantity = f"an exact method, {stages} stages, directly"
    ours = contest["minimum-norm"]
    each = ours.seconds / len(ours.exact) if ours.exact else float("nan")
    rows = []
    for name, against in (
        ("lmdif", '`algorithm="lmdif"`, as in the paper'),
        ("leastsq", "SciPy's leastsq with the compiled residual"),
    ):
        if name in contest:
            other = contest[name]
            theirs = other.seconds / max(len(other.exact), 1)
            rows.append(
                Row(
                    quantity, each, "core-seconds", against, theirs if other.exact else None,
                    theirs / each, ratio_is_bound=not other.exact,
                )
            )  # fmt: skip
    return rows or [Row(quantity, each, "core-seconds")]


def _construct(stages: int, budget: float) -> tuple[int, int, float]:
    """Return the tries, exact methods and seconds of constructions within about a budget."""
    settings: ConstructionSettings = construct(6, stages, _SEED, tries=1, workers=1).settings
    tries = exact = 0
    begin = time.process_time()
    while time.process_time() - begin < budget:
        attempt = run_attempt(settings, tries)
        tries += 1
        exact += attempt.solved and attempt.stages == stages
    return tries, exact, time.process_time() - begin
