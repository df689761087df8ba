"""Export of methods: data files, LaTeX tables, and one step in Python or C."""

from cg.construction.formats.digits import known_digits
from cg.construction.formats.exporting import FORMATS, export

__all__ = ["FORMATS", "export", "known_digits"]
