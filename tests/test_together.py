"""Eight threads and eight processes at once give what one thread alone does."""

import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from parallel_work import TASKS, task


@pytest.fixture(scope="module")
def alone():
    return [task(k) for k in range(TASKS)]


def test_eight_threads(alone):
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(task, range(TASKS))) == alone
        assert list(pool.map(task, reversed(range(TASKS)))) == alone[::-1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes can't fork")
@pytest.mark.parametrize("way", ["fork", "spawn", "forkserver"])
def test_eight_processes(alone, way):
    with ProcessPoolExecutor(8, mp_context=multiprocessing.get_context(way)) as pool:
        assert list(pool.map(task, range(TASKS))) == alone


@pytest.mark.skipif(sys.platform == "win32", reason="processes can't fork")
def test_two_forks_of_a_process_that_has_worked(alone):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        assert list(pool.map(task, range(4))) == alone[:4]
