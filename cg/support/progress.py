"""Progress bars of tqdm, which is optional."""

import sys
from importlib.util import find_spec
from typing import Any, TextIO

_LOG_SECONDS = 30.0  # between lines in a file


def has_bars() -> bool:
    """Return whether tqdm is installed."""
    return find_spec("tqdm") is not None


def make_bar(file: TextIO | None = None, **options: Any) -> Any:
    """Return a bar of tqdm on a stream, by default standard error; `options` are those of tqdm."""
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError("a progress bar needs tqdm: python -m pip install tqdm") from error
    file = file or sys.stderr
    seconds = 0.1 if file.isatty() else _LOG_SECONDS
    return tqdm(file=file, dynamic_ncols=True, mininterval=seconds, **options)
