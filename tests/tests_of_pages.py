"""Blocks of programs in the pages of the documentation, and how they are run."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def blocks_of(page):
    """Return the kind of each block of Python, what follows the language, and its text."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python *(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def run(page, kind="", names=None):
    """Run all blocks of a kind, one after the other, and return the names that they leave."""
    names = {} if names is None else names
    for number, (this, block) in enumerate(blocks_of(page)):
        if this == kind:
            exec(compile(block, f"{page}, block {number + 1}", "exec"), names)
    return names
