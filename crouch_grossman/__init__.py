"""Another name of the package `cg` and its modules, which no other distribution has.

``import crouch_grossman as cg`` imports the same modules as ``import cg``. If another distribution
has replaced the folder ``cg``, it raises an error that says how to repair the installation.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import TYPE_CHECKING

import cg

if TYPE_CHECKING:
    from cg import *  # noqa: F403

_REPAIR = (
    "Remove both and install this one again, best in an environment of its own:\n"
    "    python -m pip uninstall --yes cg crouch-grossman\n"
    "    python -m pip install crouch-grossman"
)


class _Alias(MetaPathFinder, Loader):
    """Import hook that makes ``crouch_grossman.x`` the module ``cg.x``."""

    def __init__(self, alias: str, name: str) -> None:
        self._alias, self._name = f"{alias}.", f"{name}."

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of an existing submodule of the alias."""
        if not fullname.startswith(self._alias):
            return None
        real = find_spec(self._real(fullname))
        if real is None:
            return None
        package = real.submodule_search_locations is not None
        return ModuleSpec(fullname, self, origin=real.origin, is_package=package)

    def create_module(self, spec: ModuleSpec) -> None:
        """Return None: the import system makes a module, which `exec_module` replaces."""

    def exec_module(self, module: ModuleType) -> None:
        """Replace the new module by the real one."""
        sys.modules[module.__name__] = import_module(self._real(module.__name__))

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the real module, for ``python -m``."""
        real = find_spec(self._real(fullname))
        code: CodeType | None = real.loader.get_code(real.name)  # type: ignore[union-attr]
        return code

    def _real(self, fullname: str) -> str:
        return self._name + fullname.removeprefix(self._alias)


def _check_module(module: ModuleType) -> None:
    """Raise ImportError if a module isn't this package."""
    if getattr(module, "__distribution__", None) != "crouch-grossman":
        where = getattr(module, "__file__", None) or list(getattr(module, "__path__", []))
        raise ImportError(
            f"the module cg at {where} isn't that of crouch-grossman: the unrelated distribution "
            f"cg has replaced it, or took it along when it was removed. {_REPAIR}",
            name="cg",
        )


_check_module(cg)
sys.meta_path.insert(0, _Alias(__name__, "cg"))
sys.modules[__name__] = cg
