"""Child processes that are forked while other threads work."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")

# the parent has warnings of its own about forks, and a child that hangs must not stay
CHILD = """
import os, signal, sys, threading, time
from contextlib import closing
import cg
from cg.support.parallel import single_threads
from cg.support.quads import working_precision
from flint import ctx
from threadpoolctl import threadpool_info, threadpool_limits

result = cg.search(3, 3, 2, 1, workers=1)  # loads what is loaded when it is used
expected = result.methods
threadpool_limits(2)

def blas():
    return {pool["num_threads"] for pool in threadpool_info()}

def in_child(work):
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    ends = time.monotonic() + 30
    while time.monotonic() < ends:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return sys.exit("a child failed") if status else None
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    sys.exit("a child hangs")

def search_again():
    assert blas() == {2}, blas()
    assert cg.search(3, 3, 2, 1, workers=1).methods == expected
    assert blas() == {2}, blas()
"""

HELD = """
def holding(context):
    with context:
        begun.release()
        assert ended.wait(120)

class Slow(tuple):
    def __iter__(self):
        begun.release()
        assert ended.wait(120)
        return iter(())

def properties():
    type(result)(result.settings, Slow(result.starts)).methods

def used():
    assert ctx.prec == 53
    with working_precision(99):
        assert ctx.prec == 99
    assert ctx.prec == 53
    search_again()

begun, ended = threading.Semaphore(0), threading.Event()
contexts = [single_threads(), working_precision(999)]
threads = [threading.Thread(target=holding, args=[context]) for context in contexts]
threads.append(threading.Thread(target=properties))
for thread in threads:
    thread.start()
for _ in threads:
    assert begun.acquire(timeout=60)
in_child(used)
assert (blas(), ctx.prec) == ({1}, 999)
ended.set()
for thread in threads:
    thread.join()
assert (blas(), ctx.prec) == ({2}, 53)
"""

OWN = """
def used():
    assert blas() == {2}
    assert ctx.prec == 99
    with working_precision(77):
        assert ctx.prec == 77

def whole():
    with single_threads(), working_precision(99):
        in_child(used)
        pid = os.fork()
        if pid:
            _, status = os.waitpid(pid, 0)
            assert not status
    assert ctx.prec == 53
    assert blas() == {2}
    search_again()
    if not pid:
        os._exit(0)

whole()
"""

MANY = """
def work(seed):
    while not ended:
        cg.search(3, 3, 6, seed, workers=2).methods

ended = False
threads = [threading.Thread(target=work, args=[seed]) for seed in (1, 2)]
for thread in threads:
    thread.start()
try:
    for k in range(COUNT):
        time.sleep(0.003 * (k % 7))
        in_child(search_again)
finally:
    ended = True
    for thread in threads:
        thread.join()
assert blas() == {2}
"""


def run(script):
    done = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", CHILD + script],
        capture_output=True, text=True, timeout=500, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_locks_held_by_other_threads():
    run(HELD)


def test_locks_held_by_the_forking_thread():
    run(OWN)


@pytest.mark.parametrize("count", [30, pytest.param(500, marks=pytest.mark.slow)])
def test_many_children_of_a_process_that_searches(count):
    run(MANY.replace("COUNT", str(count)))
