"""Runs that are killed at random moments lose nothing that they had recorded, and go on.

The processes are forks of this one, which has the package loaded, so that moments fall into the
work and not into imports. The environment's ``CG_KILLS`` is how many runs of each kind are killed.
"""

import contextlib
import json
import os
import random
import signal
import sys
import time

import pytest

import cg
from cg.construction.runs import StoreError, read_store
from cg.reproduce.main import main

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL"),
]

KILLS = int(os.environ.get("CG_KILLS", "8"))
SEARCH = {"order": 4, "stages": 5, "starts": 150, "seed": 1, "workers": 2}
CONSTRUCT = {"order": 5, "stages": 9, "seed": 1, "tries": 8, "workers": 2}


def recorded(path):
    """Return all lines about starts that a store has."""
    try:
        lines = [line for line in read_store(path) if "index" in line]
    except (FileNotFoundError, StoreError):  # not yet made, or killed within the first line
        return set()
    return set(map(json.dumps, lines))


def child(work):
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            with open(os.devnull, "w") as nothing, contextlib.redirect_stderr(nothing):
                work()
            code = 0
        finally:
            os._exit(code)
    return pid


def killed_at_random(work, stores, restart, seed):
    """Kill runs at random moments until enough were killed; yield how many when one has ended."""
    rng = random.Random(seed)
    begin = time.monotonic()
    pid = child(work)
    assert os.waitpid(pid, 0)[1] == 0
    duration = time.monotonic() - begin
    restart()
    kills = 0
    while kills < KILLS:
        before = set().union(*map(recorded, stores()))
        pid = child(work)
        time.sleep(rng.uniform(0, 0.6 * duration))
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            assert status == 0
            yield kills
            restart()
            continue
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        kills += 1
        assert before <= set().union(*map(recorded, stores()))
    pid = child(work)
    assert os.waitpid(pid, 0)[1] == 0
    yield kills


@pytest.mark.parametrize("kind", ["search", "construct"])
def test_searches_and_constructions(kind, tmp_path, store_path):
    function = cg.search if kind == "search" else cg.construct
    settings = SEARCH if kind == "search" else CONSTRUCT
    whole = function(**settings)

    def restart():
        store_path.unlink()

    kills = 0
    run = killed_at_random(
        lambda: function(**settings, store=store_path), lambda: [store_path], restart, 7
    )
    for kills in run:  # noqa: B007
        assert function(**settings, store=store_path) == whole
    assert kills == KILLS


def test_reproduce(tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "out"

    def run(folder):
        assert main(["--only", "search4", "--out", str(folder)]) == 0

    assert os.waitpid(child(lambda: run(whole)), 0)[1] == 0
    expected = json.loads((whole / "results.json").read_text("utf-8"))["items"]

    def restart():
        for file in sorted(out.rglob("*"), reverse=True):
            if file.is_dir():
                file.rmdir()
            else:
                file.unlink()

    kills = 0
    stores = lambda: list(out.glob("checkpoints/*.jsonl"))
    for kills in killed_at_random(lambda: run(out), stores, restart, 8):  # noqa: B007
        item = json.loads((out / "results.json").read_text("utf-8"))["items"]
        assert item == expected
    assert kills == KILLS
