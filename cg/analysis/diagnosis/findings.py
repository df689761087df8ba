"""Findings of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A recognised mistake, or a known property of a method, as a sentence.

    `kind` is ``"reversed"``, ``"transposed"``, ``"slip"``, ``"changed"``, ``"digits"``,
    ``"fractions"``, ``"equal weights"``, ``"flat"``, ``"abscissae"``; ``"known"`` is no mistake.
    """

    kind: str
    message: str

    @property
    def mistake(self) -> bool:
        """Whether the finding is a mistake."""
        return self.kind != "known"

    def __str__(self) -> str:
        return self.message
