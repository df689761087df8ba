"""Proofs of the order of methods, in ball arithmetic.

`certify` finds a proof and returns a `Certificate`; `check` repeats one from scratch.
"""

from cg.construction.proofs.certificate import (
    Box,
    Certificate,
    CertificationError,
    ViolatedCondition,
)
from cg.construction.proofs.digits import refined_digits
from cg.construction.proofs.packed import certificate_of, proved
from cg.construction.proofs.prove import certify, check

__all__ = [
    "Box",
    "Certificate",
    "CertificationError",
    "ViolatedCondition",
    "certificate_of",
    "certify",
    "check",
    "proved",
    "refined_digits",
]
