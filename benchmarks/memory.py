"""The memory of searches and ensembles with a thousand to a million pieces."""

from __future__ import annotations

import json
import subprocess
import sys

from .record import Row

SIZES = (1_000, 10_000, 100_000, 1_000_000)

_MEASURE = """
import json, sys, threading, time
from pathlib import Path

def megabytes():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(l.split()[1] for l in lines if l.startswith("RssAnon"))) / 1024

class Peak:
    def __enter__(self):
        self.before = self.peak = megabytes()
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self
    def watch(self):
        while not self.ended.wait(0.01):
            self.peak = max(self.peak, megabytes())
    def __exit__(self, *_):
        self.ended.set()
        self.thread.join()
        self.peak = max(self.peak, megabytes())
"""

_SEARCH = """
from dataclasses import replace
from tempfile import TemporaryDirectory
import cg, cg.construction.search.random_search as module

size = int(sys.argv[1])
first = module.run_start(cg.search(4, 5, 1, 1).settings, 0)
module.run_start = lambda settings, index: replace(first, index=index)
with TemporaryDirectory() as folder:
    cg.search(4, 5, 100, 1, workers=2, store=folder + "/before.db")
    with Peak() as peak:
        result = cg.search(4, 5, size, 1, workers=2, store=folder + "/runs.db")
        assert len(result.starts) == size
print(json.dumps(peak.most - peak.before))
"""

_ENSEMBLE = """
from tempfile import TemporaryDirectory
import numpy as np
import cg
from benchmarks.compiled import top_field

size = int(sys.argv[1])
top = cg.problems.HeavyTop()
with TemporaryDirectory() as folder:
    f = top_field(top, Path(folder))
    def run(members, name):
        shape = (1, members, *top.frame.point_shape)
        out = np.lib.format.open_memmap(f"{folder}/{name}.npy", "w+", shape=shape)
        y0 = np.broadcast_to(top.y0, (members, *top.frame.point_shape))
        return lambda: cg.solve_ensemble(
            f, (0.0, 0.1), y0, frame=top.frame, method="CG4a", h=0.02, t_eval=[0.1],
            workers=2, out=out,
        )
    run(100, "before")()
    call = run(size, "members")
    with Peak() as peak:
        call()
print(json.dumps(peak.most - peak.before))
"""


def memory_rows(quick: bool) -> list[Row]:
    """Measure each size in its own process; returns nothing on systems without /proc."""
    if sys.platform != "linux":
        return []
    rows = []
    for what, script in (
        ("starts with a store", _SEARCH),
        ("members of an ensemble into a file", _ENSEMBLE),
    ):
        for size in SIZES[:2] if quick else SIZES:
            command = [sys.executable, "-c", _MEASURE + script, str(size)]
            process = subprocess.run(command, capture_output=True, text=True, check=True)
            megabytes = float(json.loads(process.stdout))
            rows.append(Row(f"memory of {size} {what}", megabytes, "MB"))
    return rows
