"""Searches on processes and on Dask: a worker or the scheduler killed at random moments.

Nothing that was recorded is lost or run again, and the result is that of a run by itself to the
last bit. The environment's ``CG_KILLS`` is how many of each kind are killed.
"""

import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from test_kills import KILLS, recorded, report

import cg

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc"),
]

SEARCH = {"order": 5, "stages": 9, "starts": 60, "seed": 1, "maxfev": 60}
LONGEST = 120.0  # seconds between kills, at most
SETTLED = 0.3  # seconds after a kill in which what had ended is recorded


@pytest.fixture(scope="module")
def whole():
    return cg.search(**SEARCH)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs.db"


def children(pid):
    """Return the workers of a pool that a process has."""
    workers = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes()
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:  # it has ended
            continue
        if parent == pid and b"spawn_main" in words:
            workers.append(int(entry.name))
    return workers


def wait_for_more(path, before, rng, running):
    """Wait until something was recorded, and then for a random time; False if the run ended."""
    ends = time.monotonic() + LONGEST
    while len(recorded(path)) <= before and time.monotonic() < ends:
        if not running():
            return False
        time.sleep(0.01)
    time.sleep(rng.uniform(0.0, 0.4))
    return bool(running())


class Killer(threading.Thread):
    """Kills something at random moments of a run, each time after something new was recorded."""

    def __init__(self, path, kill, kills, seed):
        super().__init__()
        self.path, self._kill, self._left, self._rng = path, kill, kills, random.Random(seed)
        self.kills = 0
        self.lost = False  # something that was recorded
        self._ended = threading.Event()

    def run(self):
        while self.kills < self._left:
            # what had ended before the last kill is recorded by now; a start whose worker is killed
            # twice while it is alone is given up, as it should be
            time.sleep(SETTLED)
            before = recorded(self.path)
            if not wait_for_more(
                self.path, len(before), self._rng, lambda: not self._ended.is_set()
            ):
                return
            self.kills += self._kill(self._rng)
            self.lost |= not before <= recorded(self.path)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self.join()


def until_killed(kind, path, whole, kill, run):
    """Repeat searches until enough workers were killed."""
    kills = ended = 0
    while kills < KILLS:
        for file in path.parent.glob("runs.db*"):
            file.unlink()
        with Killer(path, kill, KILLS - kills, kills) as killer:
            result = run()
        assert result == whole
        assert not result.failures
        assert not killer.lost
        kills += killer.kills
        ended += 1
    report(kind, kills, kills, ended)


def kill_a_worker(rng):
    workers = children(os.getpid())
    if workers:
        os.kill(rng.choice(workers), signal.SIGKILL)
    return bool(workers)


def test_killed_workers_of_pool(path, whole):
    until_killed(
        "workers", path, whole, kill_a_worker,
        lambda: cg.search(**SEARCH, executor="processes", workers=2, store=path),
    )  # fmt: skip


class Cluster:
    """A scheduler of Dask, and workers of one thread each, all of which may be killed."""

    def __init__(self, folder):
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            self._port = listener.getsockname()[1]
        self._folder = folder
        self.address = f"tcp://127.0.0.1:{self._port}"
        listen = ["--host", "127.0.0.1", "--port", str(self._port)]
        self.scheduler = self._begin("scheduler", *listen)
        self.workers = [self._worker(), self._worker()]

    def _begin(self, what, *words):
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *words, "--no-dashboard"]
        return subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=self._folder)

    def _worker(self):
        return self._begin("worker", self.address, "--nthreads", "1", "--no-nanny")

    def kill_a_worker(self, rng):
        place = rng.randrange(2)
        self.workers[place].kill()
        self.workers[place].wait()
        self.workers[place] = self._worker()
        return True

    def kill_the_scheduler(self, _):
        self.scheduler.kill()
        self.scheduler.wait()
        return True

    @contextmanager
    def executor(self):
        from distributed import Client

        with ExitStack() as stack:
            client = stack.enter_context(Client(self.address, timeout="60s"))
            client.wait_for_workers(2, timeout=60)
            yield stack.enter_context(client.get_executor())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def dask():
    pytest.importorskip("distributed")


@pytest.mark.usefixtures("dask")
def test_killed_workers_of_dask(path, whole, tmp_path):
    with Cluster(tmp_path) as cluster, cluster.executor() as pool:
        until_killed(
            "Dask's workers", path, whole, cluster.kill_a_worker,
            lambda: cg.search(**SEARCH, executor=pool, store=path),
        )  # fmt: skip


@pytest.mark.usefixtures("dask")
def test_killed_scheduler_of_dask(path, whole, tmp_path):
    kills = ended = useful = 0
    while kills < KILLS:
        before = recorded(path)
        with Cluster(tmp_path) as cluster, cluster.executor() as pool:
            killer = Killer(path, cluster.kill_the_scheduler, 1, kills)
            lost = None
            try:
                with killer:
                    cg.search(**SEARCH, executor=pool, store=path)
            except BrokenExecutor as error:
                lost = error
        assert (lost is not None) == bool(killer.kills)
        if lost is not None:
            assert "its scheduler has ended" in str(lost)
            assert f"finished results are in {path}; run the same search" in lost.__notes__[0]
        kills += killer.kills
        after = recorded(path)
        assert before <= after
        assert not killer.lost
        useful += killer.kills and before < after
        if len(after) > SEARCH["starts"] - 20:  # the rest on another executor
            assert cg.search(**SEARCH, store=path) == whole
            ended += 1
            for file in path.parent.glob("runs.db*"):
                file.unlink()
    assert cg.search(**SEARCH, store=path) == whole
    report("Dask's scheduler", kills, useful, ended + 1)
