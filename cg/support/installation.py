"""Check that no unrelated distribution has installed files into the folder of this package.

An unrelated distribution on the public index is named ``cg`` and installs a package `cg` as well.
If it was installed later, it has replaced ``cg/__init__.py``, and `crouch_grossman` raises the
error.
"""

import os

_REPAIR = (
    "Remove both and install this one again, best in an environment of its own:\n"
    "    python -m pip uninstall --yes cg crouch-grossman\n"
    "    python -m pip install crouch-grossman"
)


def check_folder(folder: str) -> None:
    """Raise ImportError if the unrelated distribution ``cg`` is in the package's folder."""
    folder = os.path.abspath(folder)
    try:
        names = os.listdir(os.path.dirname(folder))
    except OSError:  # for example inside an archive
        return
    for name in names:
        stem, ending = os.path.splitext(name.lower())
        if stem.startswith("cg-") and ending in {".dist-info", ".egg-info"}:
            raise ImportError(
                f"the unrelated distribution cg, version {stem.split('-')[1]}, is installed in "
                f"the folder of crouch-grossman, {folder}. {_REPAIR}",
                name="cg",
            )
