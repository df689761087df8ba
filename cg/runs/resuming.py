"""A run in a store, from its beginning to whatever ends it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager
from typing import Any

from .one_run import StoredRun
from .store import Store

__all__ = ["stored_run"]


_NOUNS = {"search": "search", "construct": "construction"}


@contextmanager
def stored_run(
    path: str | os.PathLike[str], kind: str, settings: Mapping[str, Any]
) -> Iterator[StoredRun]:
    """Begin a run of a store, or go on with it; interrupts and lost workers tell how it goes on."""
    with Store(path) as store, closing(store.begin(kind, settings)) as run:
        try:
            yield run
        except (KeyboardInterrupt, BrokenExecutor, OSError) as end:
            end.add_note(
                f"what had ended is in {os.fspath(path)}, and the same {_NOUNS[kind]} goes on from "
                "there, on any executor"
            )
            raise
