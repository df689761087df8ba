"""Proofs that some methods don't exist, which anybody can check in seconds.

`check` multiplies a proof out; ``python -m research.impossibility`` does it for all proofs.
"""

from .proof import Claim, ImpossibilityError, Lemma, Proof, check, proof_names, read_proof
from .shapes import PathShape, PointsShape, TableauShape, point_shapes, read_shape

__all__ = [
    "Claim",
    "ImpossibilityError",
    "Lemma",
    "PathShape",
    "PointsShape",
    "Proof",
    "TableauShape",
    "check",
    "point_shapes",
    "proof_names",
    "read_proof",
    "read_shape",
]
