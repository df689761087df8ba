"""Proofs of the order of methods, in ball arithmetic.

`certify` finds a proof and returns a `Certificate`; `check` repeats one from scratch, as
``python -m cg.proofs --check`` does for the files of the catalogue.
"""

from cg.proofs.certificate import Box, Certificate, CertificationError, ViolatedCondition
from cg.proofs.digits import refined_digits
from cg.proofs.files import certificate_of, check_file, proved
from cg.proofs.prove import certify, check

__all__ = [
    "Box",
    "Certificate",
    "CertificationError",
    "ViolatedCondition",
    "certificate_of",
    "certify",
    "check",
    "check_file",
    "proved",
    "refined_digits",
]
