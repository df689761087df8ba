"""``python -m tests.model --programs N --seed S`` compares random programs with the model."""

import argparse
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterable

from threadpoolctl import threadpool_limits

from tests.model.compare import check
from tests.model.drawing import program, simplest
from tests.model.programs import Program


def failure(program: Program) -> Exception | None:
    try:
        check(program)
    except Exception as error:
        return error
    return None


def kind_of(error: Exception | None) -> str:
    """Return the kind of a difference, or the name of another exception."""
    return getattr(error, "kind", type(error).__name__)


def report(program: Program, error: Exception, shrink: bool) -> str:
    """Return the script that fails alone, of a simpler program if one fails too."""
    if shrink:
        program = simplest(program, lambda other: kind_of(failure(other)) == kind_of(error))
        error = failure(program) or error
    what = f"{type(error).__name__}: {error}"
    return f"# {program!r}\n# {what}\n{program.script()}\n{getattr(error, 'code', '')}\n"


def run(
    seed: int, indices: Iterable[int], shrink: bool = True
) -> tuple[Counter[str], dict[int, str]]:
    """Compare programs, and print those that fail.

    Return how often there was which other outcome, and the errors of those that fail by number.
    """
    outcomes, failed = Counter[str](), dict[int, str]()
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for index in indices:
            drawn = program(seed, index)
            try:
                outcomes[check(drawn)] += 1
            except Exception as error:
                failed[index] = f"{type(error).__name__}: {error}"
                print(f"# seed {seed}, program {index}\n{report(drawn, error, shrink)}", flush=True)
    return outcomes, failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.model", description=__doc__)
    parser.add_argument("--programs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options, begin = parser.parse_args(), time.perf_counter()
    counts, failures = run(options.seed, range(options.programs))
    print(dict(counts), len(failures), "failed", f"{time.perf_counter() - begin:.0f} s")
    sys.exit(bool(failures))
