"""Eight threads or processes at once give the results of one thread."""

import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from parallel_work import TASKS, task


@pytest.fixture(scope="module")
def alone():
    return [task(k) for k in range(TASKS)]


def test_eight_threads(alone):
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(task, range(TASKS))) == alone
        assert list(pool.map(task, reversed(range(TASKS)))) == alone[::-1]


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
def test_eight_processes(alone, way):
    assert worked(way, 8, TASKS, False) == alone


@pytest.mark.skipif(sys.platform == "win32", reason="processes can't fork")
def test_two_forks_of_a_used_process(alone):
    assert worked("fork", 2, 4, True) == alone[:4]


PROPERTY = """
from pathlib import Path
from hypothesis import given, settings, strategies as st

@settings(max_examples=20)
@given(st.integers(0, 2**64))
def test_property(number):
    with Path("drawn").open("a") as file:
        file.write(f"{number}\\n")
    assert number < 1000
"""


def drawn(folder, *options):
    """Run a property that fails below this suite's settings; return what it drew and printed."""
    folder.mkdir()
    (folder / "test_property.py").write_text(PROPERTY)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "conftest", "-p", "no:cacheprovider", *options],
        cwd=folder,
        # where CI is set, the settings of hypothesis have other defaults
        env={**os.environ, "CI": "true", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    return (folder / "drawn").read_text(), done.stdout
