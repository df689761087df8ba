"""Eight threads or processes at once give the results of one thread."""

import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from flint import arb, ctx
from parallel_work import TASKS, task
from threadpoolctl import threadpool_info, threadpool_limits

import cg
from cg.support.parallel import available_cores, single_threads
from cg.support.quads import working_precision


@pytest.fixture(scope="module")
def results_alone():
    return [task(k) for k in range(TASKS)]


def test_eight_threads(results_alone):
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(task, range(TASKS))) == results_alone
        assert list(pool.map(task, reversed(range(TASKS)))) == results_alone[::-1]


def worked(way, processes, tasks, after_work):
    """Return the results of processes that another process starts.

    What other tests have loaded into this one, such as JAX, may have threads and forbid forks.
    """
    code = f"""
import multiprocessing, pickle
from concurrent.futures import ProcessPoolExecutor
from parallel_work import task
if __name__ == "__main__":
    if {after_work}:
        task(0)
    with ProcessPoolExecutor({processes}, multiprocessing.get_context({way!r})) as pool:
        print(pickle.dumps(list(pool.map(task, range({tasks})))).hex())
"""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=Path(__file__).parents[1] / "helpers",
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert run.stderr == ""
    return pickle.loads(bytes.fromhex(run.stdout))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes can't fork")
@pytest.mark.parametrize("way", ["fork", "spawn", "forkserver"])
def test_eight_processes(results_alone, way):
    assert worked(way, 8, TASKS, False) == results_alone


@pytest.mark.skipif(sys.platform == "win32", reason="processes can't fork")
def test_two_forks_of_a_used_process(results_alone):
    assert worked("fork", 2, 4, True) == results_alone[:4]


def _blas_threads():
    return [pool["num_threads"] for pool in threadpool_info()]


def test_the_limit_of_threads_is_lifted_by_the_last_user():
    with threadpool_limits(2):
        before = _blas_threads()
        first, second = single_threads(), single_threads()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        during = _blas_threads()
        second.__exit__(None, None, None)
        after = _blas_threads()
    assert set(before) == {2}
    assert set(during) == {1}
    assert after == before


def test_the_precision_is_one_thread_s_at_a_time():
    before = ctx.prec

    def third(bits):
        with working_precision(bits):
            for _ in range(20):
                ball = arb(1) / 3
                assert ball.rel_accuracy_bits() >= bits - 3
            return str(ball.mid().man_exp())

    expected = {bits: third(bits) for bits in (64, 128, 1000)}
    with ThreadPoolExecutor(8) as pool:
        many = [64, 128, 1000] * 200
        assert list(pool.map(third, many)) == [expected[bits] for bits in many]
    assert ctx.prec == before


def test_cores_are_counted_where_there_are_no_affinities(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert available_cores() == (os.cpu_count() or 1)
    assert len(cg.search(2, 2, 2, seed=0).starts) == 2
    assert cg.construct(2, 2, seed=0).exact
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert available_cores() == 1
