"""Searches on executors: equal results, dead workers, interrupts."""

import contextlib
import logging
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import ClassVar

import pytest

import cg
from cg.construction.runs import Store
from cg.executors import completed, execution
from cg.executors.chunks import Chunks

SEARCH = {"order": 3, "stages": 3, "seed": 5, "starts": 30}
CONSTRUCT = {"order": 5, "stages": 6, "flows": 9, "first_flows": 10, "seed": 1}
FOREVER = """
import sys
import cg
def begun(done, total):
    if done == 3:
        print("begun", flush=True)
if __name__ == "__main__":
    cg.search(5, 9, 10**6, 1, maxfev=60, workers=2, executor="processes", store=sys.argv[1],
              progress=begun)
"""


def processes(workers=2):
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def double(index):
    return 2 * index


def fail_at_five(index):
    if index == 5:
        raise ArithmeticError("five")
    return index


def collect(seen, run):
    for finished in run:
        seen.append(finished.index)


def die_at_seven(index):
    if index == 7:
        os.kill(os.getpid(), signal.SIGSEGV)
    return index


def die_twice(folder, index):
    if index == 7 and len(list(folder.iterdir())) < 2:
        (folder / str(os.getpid())).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return index


class Losing(ThreadPoolExecutor):
    """An executor that loses its pending work after a number of pieces."""

    def __init__(self, pieces, moment):
        super().__init__(1)
        self._left, self._moment = pieces, moment

    def submit(self, function, /, *args, **kwargs):
        self._left -= 1
        if self._left >= 0:
            return super().submit(function, *args, **kwargs)
        if self._moment == "handed out":
            raise BrokenExecutor("it has ended")
        future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


@pytest.mark.parametrize("executor", [None, "threads", ThreadPoolExecutor])
@pytest.mark.parametrize("workers", [None, 1, 3])
def test_same_result_on_any_executor(executor, workers, path):
    whole = cg.search(**SEARCH, workers=1)
    make = partial(executor) if isinstance(executor, type) else executor
    assert cg.search(**SEARCH, executor=make, workers=workers) == whole
    assert cg.search(**SEARCH, executor=make, workers=workers, store=path) == whole


def test_same_result_in_processes(tmp_path):
    whole = cg.search(**SEARCH)
    construction = cg.construct(**CONSTRUCT)
    with processes() as pool:
        assert cg.search(**SEARCH, executor=pool, store=tmp_path / "runs.db") == whole
        assert cg.construct(**CONSTRUCT, executor=pool) == construction
        assert pool.submit(double, 3).result() == 6  # it is left as it was
    assert construction.method is not None


def test_lmdif_is_the_same_on_other_processors(tmp_path):
    """Other processors are simulated by kernels of OpenBLAS, which the environment selects."""
    script = "import cg, sys; cg.search(3, 3, 12, 5, algorithm='lmdif', store=sys.argv[1])"
    stored = []
    for kernel in ({}, {"OPENBLAS_CORETYPE": "Prescott"}):
        path = tmp_path / f"{len(stored)}.db"
        command = [sys.executable, "-c", script, str(path)]
        subprocess.run(command, env={**os.environ, **kernel}, check=True)
        with Store(path, read=True) as opened:
            stored.append([replace(one, seconds=0.0) for one in opened.run(1).entries()])
    assert stored[0] == stored[1]


def sizes_of_chunks(seconds, total):
    """Return how many pieces each chunk for two workers has, if a piece takes `seconds` of it."""
    queue, sizes = Chunks(range(total), total, 2), []
    while chunk := queue.next():
        sizes.append(len(chunk))
        for index in chunk:
            queue.learn(1, seconds(index))
    assert sum(sizes) == total
    return sizes


def test_chunks_have_equal_duration():
    sizes = sizes_of_chunks(lambda index: 0.002, 600)
    assert sizes[0] == 1  # nothing is known yet
    assert 20 < max(sizes) < 600 * 0.25
    assert sizes[-1] < 20  # the last ones are small
    assert sizes_of_chunks(lambda index: 0.05, 30)[-1] == 1


def test_chunks_grow_after_slow_first_pieces():
    sizes = sizes_of_chunks(lambda index: 0.2 if index < 2 else 0.0001, 2000)
    assert len(sizes) < 40
    assert min(sizes[-4:-1]) > 4  # handing out takes longer than a piece


def test_indices_are_read_lazily():
    read = []

    def indices():
        for index in range(10**9):
            read.append(index)
            yield index

    with closing(completed(double, indices(), 10**9, 2)) as running:
        assert {next(running).result for _ in range(5)} <= {0, 2, 4, 6, 8, 10, 12, 14, 16}
        assert len(read) < 20


def test_exception_comes_after_earlier_results():
    seen = []
    with ThreadPoolExecutor(1) as pool, pytest.raises(ArithmeticError, match="five"):
        collect(seen, completed(fail_at_five, range(9), 9, None, pool))
    assert seen == [0, 1, 2, 3, 4]


class TestDeath:
    def test_dead_worker_is_reported_and_run_continues(self):
        ended = list(completed(die_at_seven, range(12), 12, 2, "processes"))
        assert sorted(f.index for f in ended) == list(range(12))
        assert sorted(f.index for f in ended if f.result is not None) == [
            index for index in range(12) if index != 7
        ]
        (failed,) = [f for f in ended if f.failure]
        assert failed.index == 7
        assert "BrokenProcessPool" in str(failed.failure)

    def test_a_piece_runs_again_after_the_death_of_its_worker(self, tmp_path):
        """Workers are killed from outside too: once in a chunk, and once alone."""
        ended = list(completed(partial(die_twice, tmp_path), range(12), 12, 2, "processes"))
        assert sorted(finished.result for finished in ended) == list(range(12))

    def test_error_if_executor_cannot_be_replaced(self):
        with (
            processes() as pool,
            pytest.raises(BrokenProcessPool, match=r"pieces \[.*7.*\] were running; if `executor`"),
        ):
            list(completed(die_at_seven, range(12), 12, 2, pool))

    def test_search_reports_failed_start(self, path, monkeypatch):
        def ended(*_, **__):
            yield execution.Finished(0, None, failure="Killed")
            yield from (execution.Finished(k, run(k), 0.1) for k in (2, 1))

        result = cg.search(3, 3, 3, 5)
        run = result.starts.__getitem__
        monkeypatch.setattr(cg.construction.runs.long_run, "completed", ended)
        for store in (None, path):
            again = cg.search(3, 3, 3, 5, store=store)
            assert list(again.starts) == list(result.starts[1:])
            assert [(f.index, f.message) for f in again.failures] == [(0, "Killed")]
        monkeypatch.undo()
        # it would die again
        assert cg.search(3, 3, 3, 5, store=path).failures == again.failures
        with Store(path) as opened:
            assert [(run.starts, run.failed) for run in opened.runs()] == [(2, 1)]

    @pytest.mark.parametrize("ready", [False, True])
    def test_worker_dies_while_another_starts(self, ready):
        # in a process of its own, since what it is about is that the run never ended
        words = [sys.executable, __file__, "ready" if ready else "not yet"]
        ended = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
        assert ended.stdout.split() == [str(index) for index in range(6)], ended.stderr

    @pytest.mark.parametrize("moment", ["at work", "handed out"])
    def test_executor_that_loses_work(self, moment):
        """Dask's executor loses work when its scheduler is killed."""
        made = []

        def make():
            made.append(Losing(3 if not made else 1000, moment))
            return made[-1]

        ended = {
            finished.index: finished.result
            for finished in completed(double, range(40), 40, 2, make)
        }
        assert ended == {index: 2 * index for index in range(40)}
        assert len(made) == 2
        with (
            Losing(3, moment) as pool,
            pytest.raises(BrokenExecutor, match=r"pieces \[.*\] (that )?were running"),
        ):
            list(completed(double, range(40), 40, 2, pool))

    def test_search_resumes_with_another_executor(self, path, monkeypatch):
        for duration in ("_CHUNK_SECONDS", "_MIN_SECONDS"):
            monkeypatch.setattr(cg.executors.chunks, duration, 0.0)  # chunks of one start
        with Losing(3, "at work") as pool, pytest.raises(BrokenExecutor) as lost:
            cg.search(**SEARCH, executor=pool, store=path)
        (note,) = lost.value.__notes__
        assert note.startswith(f"finished results are in {path}; run the same search again")
        with Store(path) as opened:
            (run,) = opened.runs()
            before = set(opened.run(1).entries())
            assert 0 < len(before) == run.starts < 30
            assert not run.running
        assert cg.search(**SEARCH, store=path) == cg.search(**SEARCH)
        with Store(path) as opened:
            assert before <= set(opened.run(1).entries())

    @pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
    def test_workers_end_with_a_run_that_is_killed(self, tmp_path, path):
        script = tmp_path / "run.py"
        script.write_text(FOREVER)
        running = subprocess.Popen(
            [sys.executable, script, path], stdout=subprocess.PIPE, start_new_session=True
        )
        assert running.stdout is not None
        try:
            assert running.stdout.readline() == b"begun\n"
            running.kill()
            # the other end of the pipe is closed when the last worker has ended
            assert running.communicate(timeout=60) == (b"", None)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)
        with Store(path) as opened:
            (run,) = opened.runs()
            starts = run.starts + 3
        assert cg.search(5, 9, starts, 1, maxfev=60, store=path) == cg.search(
            5, 9, starts, 1, maxfev=60
        )


class StartedLate(SpawnProcess):
    """A worker that starts only after the death of the one before it was noticed."""

    before: ClassVar[list[SpawnProcess]] = []
    ready = False

    def start(self):
        self.before.append(self)
        if len(self.before) != 2:
            return super().start()
        if self.ready:
            super().start()
        self.before[0].kill()
        self.before[0].join()
        time.sleep(0.5)
        return None if self.ready else super().start()


class LateContext(SpawnContext):
    Process = StartedLate


def late_processes():
    return ProcessPoolExecutor(2, mp_context=LateContext())


def slow_double(index):
    time.sleep(0.02)
    return 2 * index


class TestInterrupt:
    def test_first_interrupt_finishes_starts_and_second_discards_them(self, caplog, monkeypatch):
        waits = iter([KeyboardInterrupt, None, None])
        wait = execution.wait

        def interrupted(*args, **options):
            problem = next(waits, None)
            if problem:
                raise problem
            return wait(*args, **options)

        monkeypatch.setattr(execution, "wait", interrupted)
        seen = []
        run = completed(slow_double, range(100), 100, 2, finish_on_interrupt=True)
        with caplog.at_level(logging.WARNING, "cg"), pytest.raises(KeyboardInterrupt):
            collect(seen, run)
        assert set(seen) <= {0, 1, 2, 3}
        assert "interrupt again to discard them" in caplog.text
        waits = iter([KeyboardInterrupt, KeyboardInterrupt])
        dropped = []
        run = completed(slow_double, range(100), 100, 2, finish_on_interrupt=True)
        with pytest.raises(KeyboardInterrupt):
            collect(dropped, run)
        assert not dropped


if __name__ == "__main__":
    StartedLate.ready = sys.argv[1] == "ready"
    print(*sorted(done.index for done in completed(slow_double, range(6), 6, 2, late_processes)))
