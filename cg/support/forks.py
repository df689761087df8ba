"""Locks in forked processes, in which the threads that held them don't exist."""

import os
import sys
import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any


def in_children(call: Callable[[], object]) -> None:
    """Register a function to be called in each process forked from this one."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=call)


def at_forks(lock: Any, in_child: Callable[[], object]) -> None:
    """Let this process fork only while no other thread holds a lock; then call `in_child` there.

    The lock must be reentrant, since a signal handler may fork. The child releases it first.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=lock.acquire, after_in_parent=lock.release)
        in_children(lock.release)
        in_children(in_child)


def _free_properties() -> None:
    """Replace the locks of all cached properties of the package."""
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == "cg"]
    kinds = [kind for module in modules for kind in vars(module).values() if isinstance(kind, type)]
    for one in [one for kind in kinds for one in vars(kind).values()]:
        if isinstance(one, cached_property):
            one.lock = threading.RLock()  # type: ignore[attr-defined]


if sys.version_info < (3, 12):
    in_children(_free_properties)
