"""``python -m tests.model --programs N --seed S`` compares random programs with the model."""

import argparse
import sys
import time
import traceback
import warnings
from collections import Counter

import hypothesis
from hypothesis import HealthCheck, Phase
from threadpoolctl import threadpool_limits

from tests.model.compare import Difference, check
from tests.model.drawing import programs
from tests.model.programs import Program


def report(program: Program, error: BaseException) -> str:
    """Return the program as a script that runs alone, with what is wrong."""
    try:
        script = program.script()
    except Exception:
        script = "# no script"
    line = getattr(error, "line", "")
    return f"# {program!r}\n# {type(error).__name__}: {error}\n{script}\n{line}\n"


def run(number: int, seed: int, shrink: bool = True) -> Counter:
    """Compare programs; raise what the first failure raises, with its script as a note."""
    outcomes: Counter = Counter()

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=number, database=None, deadline=None, derandomize=False,
        phases=[Phase.generate, *([Phase.shrink] if shrink else [])],
        suppress_health_check=list(HealthCheck), report_multiple_bugs=False,
    )  # fmt: skip
    @hypothesis.given(programs())
    def compare(program):
        try:
            outcomes[check(program)] += 1
        except Exception as error:
            error.add_note(report(program, error))
            raise

    with threadpool_limits(1):
        compare()
    return outcomes


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.model", description=__doc__)
    parser.add_argument("--programs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.perf_counter()
    try:
        outcomes = run(options.programs, options.seed)
    except Exception as error:
        if not isinstance(error, Difference):
            traceback.print_exc()
        print("\n".join(getattr(error, "__notes__", [])[:1]))
        return 1
    print(f"{time.perf_counter() - begin:.0f} s", dict(outcomes))
    return 0


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.exit(main())
