"""Checkpoints are not believed: records are computed again, and a file has one run at a time."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import cg
from cg.checkpoint import Checkpoint

SEARCH: dict[str, Any] = {"order": 3, "stages": 3, "seed": 5, "starts": 6}
CONSTRUCT: dict[str, Any] = {"order": 4, "stages": 4, "seed": 1, "tries": 3, "force": True}
TREES: dict[str, Any] = {"order": 3, "stages": 3, "seed": 2, "flows": 4, "tries": 2}


def _forge(path: Path, change: Callable[[dict[str, Any]], None], line: int = -1) -> None:
    lines = path.read_text("utf-8").splitlines()
    record = json.loads(lines[line])
    change(record)
    lines[line] = json.dumps(record)
    path.write_text("\n".join(lines) + "\n", "utf-8")


FORGERIES: dict[str, Callable[[dict[str, Any]], None]] = {
    "exact": lambda r: r.update(exact=not r["exact"]),
    "exact and small": lambda r: r.update(exact=True, largest_residual=1e-33, x=["0.5"] * 6),
    "a residual": lambda r: r.update(largest_residual=r["largest_residual"] / 2 + 1e-40),
    "a coefficient": lambda r: r["x"].__setitem__(2, "0.123"),
    "one too few": lambda r: r["x"].pop(),
    "one too many": lambda r: r["x"].append("0"),
    "no number": lambda r: r["x"].__setitem__(0, "nan"),
    "a huge number": lambda r: r["x"].__setitem__(0, "1e999999999"),
    "an index": lambda r: r.update(index=-1),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_forged_starts_are_refused(forgery: str, tmp_path: Path) -> None:
    path = tmp_path / "starts.jsonl"
    whole = cg.search(**SEARCH, workers=1, checkpoint=path)
    assert {start.exact for start in whole.starts} == {True, False}
    assert cg.search(**SEARCH, checkpoint=path) == whole
    content = path.read_bytes()
    for line in range(1, 7):
        path.write_bytes(content)
        _forge(path, FORGERIES[forgery], line)
        with pytest.raises(ValueError, match="not the record of a start"):
            cg.search(**SEARCH, checkpoint=path)


@pytest.mark.parametrize("settings", [{"flows": 4}, {"algorithm": "lmdif"}, {"width": 1e200}])
def test_records_of_other_searches_are_borne_out(settings: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "starts.jsonl"
    whole = cg.search(**SEARCH, **settings, checkpoint=path)
    assert cg.search(**SEARCH, **settings, checkpoint=path) == whole


@pytest.mark.parametrize("settings", [CONSTRUCT, TREES])
def test_forged_tries_are_refused(settings: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "tries.jsonl"
    whole = cg.construct(**settings, workers=1, checkpoint=path)
    assert cg.construct(**settings, checkpoint=path) == whole
    content = path.read_bytes()
    changes: list[Callable[[dict[str, Any]], None]] = [
        lambda r: r.update(solved=not r["solved"]),
        lambda r: r.update(f=(float.fromhex(r["f"]) / 2 + 1e-300).hex()),
        lambda r: r["x"].pop(),
        lambda r: r["x"].__setitem__(1, (0.123).hex()),
        lambda r: r.update(index=-5),
        lambda r: r.update(stages=r["stages"] + 1),
    ]
    for change in changes:
        path.write_bytes(content)
        _forge(path, change)
        with pytest.raises(ValueError, match="not the record of an attempt"):
            cg.construct(**settings, checkpoint=path)


_OPEN = """
import sys
from cg.checkpoint import Checkpoint
try:
    Checkpoint.open(sys.argv[1], {"run": 1})
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_second_run_on_the_same_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    first = Checkpoint.open(path, {"run": 1})
    first.append({"k": 1})
    before = path.read_bytes()
    with pytest.raises(BlockingIOError, match="checkpoint is in use by another run"):
        Checkpoint.open(path, {"run": 1})
    command = [sys.executable, "-c", _OPEN, str(path)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "checkpoint is in use by another run" in told
    assert path.read_bytes() == before
    first.close()
    again = Checkpoint.open(path, {"run": 1})
    assert again.records == ({"k": 1},)
    again.close()
