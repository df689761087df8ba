"""Prove the catalogue's new methods and write its table: ``python tools/update_catalogue.py``.

A method whose certificate is missing or isn't its own any more is proved, and its certificate
written; then the table of docs/catalogue.md and what `cg list` prints are written anew.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cg.catalogue import packaged
from cg.certification import Certificate, CertificationError, certificate_of, certify
from cg.certification.statement import fitting
from cg.facts import write_facts
from cg.method import Method
from cg.reproduce.context import Context, Settings
from cg.reproduce.sections.beyond_catalogue import compute, markdown, table

ROOT = Path(__file__).parent.parent
CERTIFICATES = ROOT / "cg" / "catalogue" / "certificates"
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"


def main() -> int:
    """Return the number of methods that could not be proved."""
    failed = 0
    for method in packaged.values():
        if method.approximate or _has_certificate(method):
            continue
        try:
            certificate = _prove(method)
        except CertificationError as error:
            failed += 1
            print(f"FAILED {method.name}: {error}")
            continue
        certificate.save(CERTIFICATES / f"{method.name}.toml")
        print(f"proved {certificate}")
    write_table(ROOT / "docs" / "catalogue.md")
    write_facts(ROOT / "cg" / "catalogue" / "facts.json")
    return failed


def _prove(method: Method) -> Certificate:
    """Return a proof, or else one of independent conditions, the others being small."""
    try:
        return certify(method)
    except CertificationError as error:
        print(f"not all of {method.name}: {error}")
        return certify(method, small=True)


def _has_certificate(method: Method) -> bool:
    try:
        fitting(certificate_of(method), method)
    except CertificationError:
        return False
    return True


def write_table(page: Path) -> None:
    """Replace what is between the two marks."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    shown = markdown(table(compute(Context(Settings(), Path()))))
    page.write_text(f"{before}{BEGIN}{shown}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
