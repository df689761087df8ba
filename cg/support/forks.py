"""Locks in children that a process forks: the threads that hold them aren't there."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any

__all__ = ["at_forks", "in_children"]


def in_children(call: Callable[[], object]) -> None:
    """Call a function in each process that is forked from this one, where there are forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=call)


def at_forks(lock: Any, in_child: Callable[[], object]) -> None:
    """Fork only while no other thread has a lock, which none may keep for long.

    Parameters
    ----------
    lock : threading.RLock or threading.Condition
        One that a thread may acquire twice: a signal handler may fork.
    in_child : callable
        Called in the child, in which the lock is free.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=lock.acquire, after_in_parent=lock.release)
        in_children(lock.release)
        in_children(in_child)


def _free_properties() -> None:
    """Give cached properties of the package, each of which has a lock, new ones."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "cg":
            for kind in list(vars(module).values()):
                for one in list(vars(kind).values()) if isinstance(kind, type) else ():
                    if isinstance(one, cached_property):
                        one.lock = threading.RLock()  # type: ignore[attr-defined]


if sys.version_info < (3, 12):
    in_children(_free_properties)
