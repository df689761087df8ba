"""Another name of the package `cg` and its modules, which no other distribution has.

``import crouch_grossman as cg`` imports the same modules as ``import cg``. If another distribution
has replaced the folder ``cg``, it raises an error that says how to repair the installation.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

import cg

if TYPE_CHECKING:
    from cg import *  # noqa: F403

if getattr(cg, "__distribution__", None) != "crouch-grossman":
    raise ImportError(
        f"the module cg at {getattr(cg, '__file__', None) or list(cg.__path__)} isn't that of "
        "crouch-grossman: the unrelated distribution cg has replaced it, or took it along when it "
        "was removed. Remove both and install this one again, best in an environment of its own:\n"
        "    python -m pip uninstall --yes cg crouch-grossman\n"
        "    python -m pip install crouch-grossman",
        name="cg",
    )


class _Alias(MetaPathFinder, Loader):
    """Import hook that makes ``crouch_grossman.x`` the module ``cg.x``."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.startswith("crouch_grossman.") and find_spec(_real(fullname)):
            return ModuleSpec(fullname, self, is_package=True)
        return None

    def exec_module(self, module: ModuleType) -> None:
        # the import system returns what is in sys.modules, here with the specification of cg.x
        sys.modules[module.__name__] = import_module(_real(module.__name__))


def _real(fullname: str) -> str:
    return "cg." + fullname.removeprefix("crouch_grossman.")


sys.meta_path.insert(0, _Alias())
sys.modules[__name__] = cg
