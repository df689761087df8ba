"""Findings of a diagnosis."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A recognised mistake, or a known property of a method, as a sentence."""

    kind: str  # such as "reversed", "slip" or "digits"; "known" and "close" are no mistakes
    message: str

    @property
    def mistake(self) -> bool:
        """Whether the finding is a mistake."""
        return self.kind not in ("known", "close")

    def __str__(self) -> str:
        return self.message
