"""Check proofs from the command line: ``python -m research.impossibility [NAME ...]``."""

import argparse
import sys
import time
from collections.abc import Sequence

from .proof import ImpossibilityError, check, proof_names


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 if all was proved, 1 if not."""
    parser = argparse.ArgumentParser(
        prog="python -m research.impossibility",
        description="Prove that methods don't exist, by multiplying out stored polynomials.",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="by default all proofs")
    names = parser.parse_args(arguments).names or proof_names()
    failed = 0
    for name in names:
        begin = time.perf_counter()
        try:
            said = check(name)
        except (ImpossibilityError, KeyError) as error:
            failed += 1
            print(f"FAILED {name}: {error.args[0]}")
            continue
        for sentence in said:
            print(f"proved: {sentence} [{name}, {time.perf_counter() - begin:.1f} s]")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
