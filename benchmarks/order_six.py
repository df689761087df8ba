"""Time of one core to an exact method of order six, from random starts."""

from __future__ import annotations

import time
from pathlib import Path

from cg.construction import ConstructionSettings, construct, run_attempt

from .contest import compete, contestants
from .record import Aim, Result, Row

_STAGES = (16, 13, 12)
_SEED = 1


def run(quick: bool, figures: Path | None) -> Result:
    """Measure direct solution with many stages, and construction with few."""
    budget, turns = (15.0, 1) if quick else (40.0, 4)
    rows = []
    notes = []
    for stages in (24, 20):
        contest = contestants(6, stages, most=budget)
        if stages != 24:
            contest = {"minimum-norm": contest["minimum-norm"]}
        notes.append(f"- {stages} stages, exact methods and starts: ")
        notes[-1] += compete(contest, budget, turns) + "."
        ours = contest["minimum-norm"]
        each = ours.seconds / len(ours.exact) if ours.exact else float("nan")
        for name, against in (
            ("lmdif", '`algorithm="lmdif"`, the paper\'s way'),
            ("leastsq", "SciPy's leastsq with the compiled residual"),
        ):
            if name not in contest:
                continue
            other = contest[name]
            theirs = other.seconds / max(len(other.exact), 1)
            rows.append(
                Row(
                    f"an exact method, {stages} stages, directly",
                    each,
                    "core-seconds",
                    against,
                    theirs if other.exact else None,
                    theirs / each,
                    ratio_is_bound=not other.exact,
                )
            )
        if len(contest) == 1:
            rows.append(Row(f"an exact method, {stages} stages, directly", each, "core-seconds"))

    for stages in _STAGES:
        tries, found, seconds = _construct(stages, 3.0 if quick else 2.0 * budget)
        rows.append(
            Row(
                f"an exact method, {stages} stages, `cg.construct`",
                seconds / found if found else float("nan"),
                "core-seconds",
                aim=Aim(60.0, above=False, of="value") if stages == 16 else None,
            )
        )
        notes.append(
            f"- `cg.construct(order=6, stages={stages}, seed={_SEED})`: {found} of {tries} tries "
            f"in {seconds:.0f} s. The other solvers find no such method."
        )
    return Result(
        "Order six",
        f"The same random starts for all, {budget:.0f} s of one core each; a try of the "
        "construction is run to its end. Times are those used, divided by the number of exact "
        "methods found: what one of them costs on average.",
        tuple(rows),
        ("\n".join(notes),),
    )


def _construct(stages: int, budget: float) -> tuple[int, int, float]:
    """Return tries, exact methods, and seconds of the construction within about a budget."""
    settings: ConstructionSettings = construct(6, stages, _SEED, tries=1, workers=1).settings
    tries = found = 0
    begin = time.process_time()
    while time.process_time() - begin < budget:
        attempt = run_attempt(settings, tries)
        tries += 1
        found += attempt.solved and attempt.stages == stages
    return tries, found, time.process_time() - begin
