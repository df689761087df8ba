"""Write the table of docs/catalogue.md anew: ``python tools/write_catalogue_table.py [FILE]``."""

from __future__ import annotations

import sys
from pathlib import Path

from cg.reproduce.context import Context, Settings
from cg.reproduce.sections.beyond_catalogue import compute, markdown, table

BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"


def main(path: str = "docs/catalogue.md") -> None:
    """Replace what is between the two marks."""
    page = Path(path)
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    shown = markdown(table(compute(Context(Settings(), Path()))))
    page.write_text(f"{before}{BEGIN}{shown}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
