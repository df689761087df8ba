"""Pieces of work on executors: equal results, errors, dead workers, interrupts, clusters."""

import contextlib
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import closing
from multiprocessing import get_context

import pytest

import cg
from cg.construction.runs import read_store
from cg.support import parallel
from cg.support.parallel import completed, count_workers

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
MPI = """
import sys
from mpi4py.futures import MPIPoolExecutor
import cg
if __name__ == "__main__":
    with MPIPoolExecutor() as pool:
        result = cg.search(3, 3, 30, 5, executor=pool, store=sys.argv[1])
        assert result == cg.search(3, 3, 30, 5), "other results"
        print("equal,", pool.num_workers, "workers")
"""


def double(index):
    time.sleep(0.002)
    return 2 * index


def fail_at_five(index):
    if index == 5:
        raise ArithmeticError("five")
    return index


def die_at_seven(index):
    if index == 7:
        os.kill(os.getpid(), signal.SIGSEGV)
    return index


class Losing(ThreadPoolExecutor):
    """An executor that breaks after a number of pieces."""

    def __init__(self, pieces, moment):
        super().__init__(1)
        self._left, self._moment, self._handed = pieces, moment, []

    def submit(self, function, /, *args, **kwargs):
        self._left -= 1
        if self._left >= 0:
            self._handed.append(super().submit(function, *args, **kwargs))
            return self._handed[-1]
        wait(self._handed)
        if self._moment == "handed out":
            raise BrokenExecutor("it has ended")
        future = Future()
        future.set_exception(BrokenExecutor("it has ended"))
        return future


@pytest.mark.parametrize("workers", [None, 1, 3])
def test_same_result_for_any_number_of_workers(workers, store_path):
    whole = cg.search(**SEARCH, workers=1)
    for executor in (None, ThreadPoolExecutor(2)):
        assert cg.search(**SEARCH, executor=executor, workers=workers) == whole
        assert cg.search(**SEARCH, executor=executor, workers=workers, store=store_path) == whole


def test_same_result_in_processes(store_path):
    construction = cg.construct(**CONSTRUCT)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert cg.search(**SEARCH, executor=pool, store=store_path) == cg.search(**SEARCH)
        assert cg.construct(**CONSTRUCT, executor=pool) == construction
        assert pool.submit(double, 3).result() == 6  # it is left as it was
    assert construction.method is not None


def test_lmdif_is_the_same_on_other_processors(tmp_path):
    """Other processors are simulated by kernels of OpenBLAS, which the environment selects."""
    script = "import cg, sys; cg.search(3, 3, 12, 5, algorithm='lmdif', store=sys.argv[1])"
    stored = []
    for kernel in ({}, {"OPENBLAS_CORETYPE": "Prescott"}):
        path = tmp_path / f"{len(stored)}.jsonl"
        command = [sys.executable, "-c", script, str(path)]
        subprocess.run(command, env={**os.environ, **kernel}, check=True)
        stored.append(sorted(path.read_text().splitlines()))
    assert stored[0] == stored[1]
    assert len(stored[0]) == 13


def _threads(_item: int) -> set[int]:
    """Return the numbers of threads of the libraries of linear algebra."""
    import scipy.linalg  # noqa: F401  # in a new process
    from threadpoolctl import threadpool_info

    return {library["num_threads"] for library in threadpool_info()}


def test_linear_algebra_has_one_thread_in_every_process():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert next(completed(_threads, [0], pool))[1] == {1}


def test_items_are_read_lazily():
    read = []

    def items():
        for index in range(10**9):
            read.append(index)
            yield index

    with closing(completed(double, items(), workers=2)) as running:
        assert all(result == 2 * item for item, result in (next(running) for _ in range(5)))
    assert len(read) < 20


def test_error_comes_after_earlier_results():
    seen = []
    with (
        ThreadPoolExecutor(1) as pool,
        closing(completed(fail_at_five, range(9), pool)) as running,
        pytest.raises(ArithmeticError, match="five"),
    ):
        seen.extend(item for item, _ in running)
    assert seen == [] or seen == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("moment", ["at work", "handed out"])
def test_executor_that_breaks_loses_nothing_that_was_finished(moment, store_path):
    whole = cg.search(**SEARCH)
    with Losing(3, moment) as pool, pytest.raises(BrokenExecutor, match="it has ended") as lost:
        cg.search(**SEARCH, executor=pool, workers=1, store=store_path)
    (note,) = lost.value.__notes__
    assert note.startswith(f"finished results are in {store_path}; run the same search again")
    before = [line for line in read_store(store_path) if "index" in line]
    assert {line["index"] for line in before} == {0, 1, 2}
    shown: list[tuple[int, ...]] = []
    assert cg.search(**SEARCH, store=store_path, progress=lambda *now: shown.append(now)) == whole
    assert shown[:2] == [(3, 30), (4, 30)]


def test_dead_worker_ends_the_run():
    with pytest.raises(BrokenExecutor):
        list(completed(die_at_seven, range(12), "processes", 2))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_workers_end_with_a_run_that_is_killed(tmp_path, store_path):
    script = tmp_path / "run.py"
    script.write_text(FOREVER)
    running = subprocess.Popen(
        [sys.executable, script, store_path], stdout=subprocess.PIPE, start_new_session=True
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
    starts = sum("index" in line for line in read_store(store_path)) + 3
    stored = cg.search(5, 9, starts, 1, maxfev=60, store=store_path)
    assert stored == cg.search(5, 9, starts, 1, maxfev=60)


def test_first_interrupt_finishes_pieces_and_second_discards_them(caplog, monkeypatch):
    waits = iter([KeyboardInterrupt, None, None])
    wait = parallel.wait

    def interrupted(*args, **options):
        problem = next(waits, None)
        if problem:
            raise problem
        return wait(*args, **options)

    monkeypatch.setattr(parallel, "wait", interrupted)
    seen = []
    with caplog.at_level(logging.WARNING, "cg"), pytest.raises(KeyboardInterrupt):
        seen.extend(item for item, _ in completed(double, range(100), workers=2, finish=True))
    assert "interrupted: finishing" in caplog.text
    waits = iter([KeyboardInterrupt, KeyboardInterrupt])
    with pytest.raises(KeyboardInterrupt):
        next(completed(double, range(100), workers=2, finish=True))


def interrupt_itself(item):
    os.kill(os.getpid(), signal.SIGINT)
    return item


def test_processes_ignore_interrupts_which_terminals_send_to_all():
    assert dict(completed(interrupt_itself, range(4), "processes", 2)) == {k: k for k in range(4)}


class TestClusters:
    def test_dask(self, tmp_path, store_path):
        distributed = pytest.importorskip("distributed")
        with (
            distributed.LocalCluster(
                n_workers=2,
                threads_per_worker=1,
                dashboard_address=":0",  # any port: another cluster may have the usual one
                local_directory=tmp_path,
            ) as cluster,
            distributed.Client(cluster) as client,
            client.get_executor() as pool,
        ):
            assert cg.search(**SEARCH, executor=pool, store=store_path) == cg.search(**SEARCH)
            assert count_workers(pool, None) == 2

    def test_loky(self):
        loky = pytest.importorskip("loky")
        pool = loky.get_reusable_executor(2)
        assert cg.search(**SEARCH, executor=pool) == cg.search(**SEARCH)

    def test_mpi(self, tmp_path, store_path):
        pytest.importorskip("mpi4py")
        if not shutil.which("mpiexec"):
            pytest.skip("mpiexec isn't installed")
        script = tmp_path / "run.py"
        script.write_text(MPI)
        command = ["mpiexec", "--oversubscribe", "--allow-run-as-root", "-n", "3", sys.executable]
        process = subprocess.run(
            [*command, "-m", "mpi4py.futures", str(script), str(store_path)],
            capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert process.stdout == "equal, 2 workers\n", process.stderr
