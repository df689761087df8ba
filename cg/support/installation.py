"""Whether this package has its folder to itself: an unrelated distribution installs a `cg` as well.

That distribution, on the public index under the name ``cg``, puts its files into the same folder.
Where it came after this one, ``cg/__init__.py`` is its own, and `crouch_grossman` finds that out.
"""

from __future__ import annotations

import os

__all__ = ["check_folder"]

_REPAIR = (
    "Remove both and install this one again, best in an environment of its own:\n"
    "    python -m pip uninstall --yes cg crouch-grossman\n"
    "    python -m pip install crouch-grossman"
)


def check_folder(folder: str) -> None:
    """Refuse a folder that an unrelated distribution named ``cg`` is installed in.

    Parameters
    ----------
    folder : str
        Of the package. Only the names of its neighbours are read.

    Raises
    ------
    ImportError
        If the other distribution is there; it says how to put things right.
    """
    folder = os.path.abspath(folder)
    try:
        names = os.listdir(os.path.dirname(folder))
    except OSError:  # an archive, for one
        return
    for name in names:
        stem, ending = os.path.splitext(name.lower())
        if stem.startswith("cg-") and ending in {".dist-info", ".egg-info"}:
            raise ImportError(
                f"the unrelated distribution cg, version {stem.split('-')[1]}, is installed in "
                f"the folder of crouch-grossman, {folder}. {_REPAIR}",
                name="cg",
            )
