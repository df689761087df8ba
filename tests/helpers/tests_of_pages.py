"""Helpers for tests of documentation pages: run their code."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def blocks_of(page):
    """Return pairs (kind, text) of blocks of Python; the kind is the word after the language."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python *(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def source_in(page, language):
    """Return the text of the only block of a page in some other language than Python."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (source,) = re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return source


def compiler_command(page):
    """Return the words of the only line of a page that calls the C compiler."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (command,) = re.findall(r"^    (cc .*)$", text, re.MULTILINE)
    return command.split()


def run(page, kind="", names=None):
    """Run all blocks of a kind in order, and return the names that they define."""
    names = {} if names is None else names
    for number, (this, block) in enumerate(blocks_of(page)):
        if this == kind:
            exec(compile(block, f"{page}, block {number + 1}", "exec"), names)
    return names
