"""Number of exact methods of orders four and five found per minute of one core."""

from __future__ import annotations

from pathlib import Path

from .contest import compete, contestants
from .record import Aim, Result, Row

_CASES = ((4, 5, 50.0), (5, 9, 1.0))
"""Order, stages, and the aim in exact methods per second."""

TITLE = "Searches"


def method_text(budget: float, rounds: int) -> str:
    """Return how searches are measured."""
    return (
        f"All solvers run the same random starts, {budget:.0f} s of one core each, in {rounds} "
        "turns. A method is exact if all order conditions hold to 1e-31 in real(16); results of "
        "SciPy, in double precision, are refined by this package."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Run three solvers on the same starts, in turns, each for the same time."""
    budget, rounds = (3.0, 2) if quick else (24.0, 8)
    rows = []
    notes = []
    for order, stages, aim in _CASES:
        contest = contestants(order, stages)
        counts = compete(contest, budget, rounds)
        ours = contest["minimum-norm"]
        for name, against in (
            ("lmdif", '`algorithm="lmdif"`, as in the paper'),
            ("leastsq", "SciPy's leastsq with the compiled residual"),
        ):
            other = contest[name]
            rows.append(Row(
                f"exact methods of order {order}, {stages} stages", ours.per_minute,
                "per core-minute", against, other.per_minute if other.exact else None,
                ours.per_minute / max(other.per_minute, 60.0 / other.seconds),
                ratio_is_bound=not other.exact,
                aim=Aim(60.0 * aim, above=True, of="value") if name == "lmdif" else None,
            ))  # fmt: skip
        notes.append(f"- Order {order}, exact methods of all starts: {counts}.")
    return Result(TITLE, method_text(budget, rounds), tuple(rows), ("\n".join(notes),))
