"""Prove new methods of the catalogue and write its table: ``python tools/update_catalogue.py``.

Proves each method whose certificate is missing or out of date, completely or else in part, and
writes the certificate. Then writes the table of docs/catalogue.md, that of the claims in
docs/reproduction.md, and the data that `crouch-grossman list` prints. The last line of output
names the methods that are proved in part, or not at all.
"""

import sys
from pathlib import Path

from cg.construction.catalogue import methods
from cg.construction.catalogue.summary import write_summaries
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.method import Method
from cg.construction.proofs import Certificate, CertificationError, certificate_of, certify
from cg.construction.proofs.packed import certificate_names, fitting
from cg.reproduce.catalogue_table import entries, markdown, table
from cg.reproduce.markdown import replace_between
from cg.reproduce.sections.claims import CLAIMS, VERDICTS

ROOT = Path(__file__).parent.parent
CERTIFICATES = ROOT / "cg" / "construction" / "catalogue" / "certificates"
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"


def main() -> int:
    """Return 1 if an existing certificate is invalid and can't be replaced, else 0."""
    whole, partly, without, failed = [], [], [], 0
    for method in methods.values():
        if isinstance(method, MuntheKaas):
            continue
        known = _certificate(method)
        if known is None and not method.approximate:
            try:
                known = certify(method)
            except CertificationError as error:
                claimed = method.name in certificate_names()
                failed += claimed
                print(f"{'FAILED' if claimed else 'no proof of'} {method.name}: {error}")
            else:
                known.save(CERTIFICATES / f"{method.name}.toml")
                print(known)
        names = without if known is None else whole if known.complete else partly
        names.append(method.name)
    shown = markdown(table(entries()))
    replace_between(ROOT / "docs" / "catalogue.md", BEGIN, END, shown)
    replace_between(ROOT / "docs" / "reproduction.md", BEGIN, END, claims())
    write_summaries(ROOT / "cg" / "construction" / "catalogue" / "summaries.json")
    print(f"{len(whole)} methods are proved; in part {_listed(partly)}; not {_listed(without)}")
    return 1 if failed else 0


def claims() -> str:
    """Return a table of the paper's claims with verdicts and interpretations."""
    lines = ["| section | claim, in our words | verdict |", "|---|---|---|"]
    for claim in CLAIMS:
        verdict = (
            claim.default_verdict
            if claim.default_verdict == VERDICTS[0]
            else f"**{claim.default_verdict}**"
        )
        reading = f" *{claim.interpretation}*" if claim.interpretation else ""
        lines.append(f"| {claim.section} | {claim.text}{reading} | {verdict} |")
    return "\n".join(lines) + "\n"


def _listed(names: list[str]) -> str:
    return f"{len(names)} ({', '.join(names)})" if names else "none"


def _certificate(method: Method) -> Certificate | None:
    """Return the certificate of a method if it is up to date, else None."""
    try:
        certificate = certificate_of(method)
        fitting(certificate, method)
    except CertificationError:
        return None
    return certificate


if __name__ == "__main__":
    sys.exit(main())
