"""Runge–Kutta methods on manifolds: construct them, prove them, integrate with them.

The public names are listed in ``__init__.pyi``, and imported at their first use.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import lazy_loader

if find_spec(f"{__name__}._core_r64") is None:
    raise ImportError(
        f"{__path__[0]} is not built: its compiled modules are missing. Run `make build` or "
        "`python -m pip install .` in the source tree, or start Python in another folder."
    )

_listed, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if name != "jax"]  # `from cg import *` would import JAX
__version__ = "1.0.0rc1"
__distribution__ = "crouch-grossman"


def __getattr__(name: str) -> Any:
    """Import a public name, or otherwise a module of the package."""
    if name in __all__:
        return _listed(name)
    if name.startswith("__") or find_spec(f"{__name__}.{name}") is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")


def __dir__() -> list[str]:
    """Return the public names only, for completion."""
    return [*__all__, "jax", "__version__"]
