"""What a diagnosis finds."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """Something that is known of a method.

    Attributes
    ----------
    kind : str
        One word for it: ``"reversed"``, ``"transposed"``, ``"slip"``, ``"changed"``, ``"digits"``,
        ``"equal weights"``, ``"flat"``, ``"abscissae"``; ``"known"`` isn't a mistake.
    message : str
        A sentence.
    """

    kind: str
    message: str

    @property
    def mistake(self) -> bool:
        """Whether it is a mistake, and not only a fact."""
        return self.kind != "known"

    def __str__(self) -> str:
        return self.message
