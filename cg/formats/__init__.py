"""Export of methods: data files, LaTeX tables, and one step in other languages."""

from __future__ import annotations

from .digits import known_digits
from .exporting import FORMATS, export
from .others import to_diffrax, to_nodepy

__all__ = ["FORMATS", "export", "known_digits", "to_diffrax", "to_nodepy"]
