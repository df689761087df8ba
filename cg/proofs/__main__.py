"""Prove orders from the command line: ``python -m cg.proofs --check [NAME | FILE ...]``."""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from cg.catalogue import load, resolve_method
from cg.method.method import Method
from cg.proofs.certificate import Certificate, CertificationError
from cg.proofs.files import certificate_names, certificate_of, check_file
from cg.proofs.prove import certify, check
from cg.structure.points import MethodError
from cg.support.parsing import file_in, visible_lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 if all was proved, 1 if not."""
    parser = argparse.ArgumentParser(
        prog="python -m cg.proofs",
        description="Prove the order of methods in ball arithmetic, and check certificates.",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="prove again what certificates say: those of methods of the catalogue, or files; "
        "without arguments all of the catalogue",
    )
    parser.add_argument("--method", metavar="FILE", help="catalogue file of the method, if new")
    parser.add_argument("--output", metavar="FOLDER", help="write new certificates there")
    parser.add_argument("items", nargs="*", metavar="NAME|FILE")
    chosen = parser.parse_args(arguments)
    if chosen.check:
        items = chosen.items or certificate_names()
        return _run(items, lambda item: _check(item, chosen.method))
    if not chosen.items:
        parser.error("name a method, or pass --check")
    return _run(chosen.items, lambda item: _certify(item, chosen.output))


def _run(items: Sequence[str], prove: Callable[[str], Certificate]) -> int:
    counts = {"yes": 0, "in part": 0, "failed": 0}
    for item in items:
        begin = time.perf_counter()
        try:
            certificate = prove(item)
        except (CertificationError, MethodError, OSError, KeyError, ValueError) as error:
            counts["failed"] += 1
            message = f"FAILED {item}: {error}"
        else:
            counts[certificate.proved] += 1
            message = str(certificate)
        print(f"{visible_lines(message)} [{time.perf_counter() - begin:.1f} s]", flush=True)
    others = (f", {count} {how}" for how, count in counts.items() if count and how != "yes")
    print(f"{counts['yes']} proved{''.join(others)}")
    return 1 if counts["failed"] else 0


def _check(item: str, method_file: str | None) -> Certificate:
    method: Method | None = load(method_file) if method_file else None
    if Path(item).suffix == ".toml":
        return check_file(item, method)
    stored = resolve_method(item)
    certificate = certificate_of(stored)
    check(certificate, stored if method is None else method)
    return certificate


def _certify(item: str, output: str | None) -> Certificate:
    method = resolve_method(item)
    certificate = certify(method)
    if output is None:
        print(visible_lines(f"{certificate.dumps()}\n"), end="")
    else:
        certificate.save(file_in(output, method.name))
    return certificate


if __name__ == "__main__":
    sys.exit(main())
