"""Frames: manifolds with vector fields whose flows can be computed.

The public names are listed in ``__init__.pyi``, and imported at their first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
