"""Two workers against one, on each executor; ensembles from one trajectory to a million."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import cg
from cg.problems import HeavyTop

from .compiled import top_field
from .memory import memory_rows
from .record import Aim, Result, Row

WORKERS = 2
_AIM = Aim(90.0, True, "value")


def run(quick: bool, figures: Path | None) -> Result:
    """Measure searches and ensembles; by the clock, so on a machine that does nothing else."""
    rounds = 1 if quick else 3
    rows = [_unrelated(quick, rounds)]
    with TemporaryDirectory() as folder:
        cases = _cases(quick, Path(folder))
        for name, pool in _pools().items():
            with pool() as (one, two):
                for case, call in cases.items():
                    ratios = []
                    for _ in range(rounds):
                        alone = _clock(lambda: call(one, 1))  # noqa: B023
                        ratios.append(alone / (WORKERS * _clock(lambda: call(two, WORKERS))))  # noqa: B023
                    efficiency = 100 * float(np.median(ratios))
                    rows.append(
                        Row(f"{case}, {name}: of twice one worker", efficiency, "%", aim=_AIM)
                    )
    rows += _ensembles(quick)
    rows += memory_rows(quick)
    return Result(
        title="Workers, and ensembles of any size",
        method=(
            "By the clock. The first row is what the machine gives: the search is for order five "
            "with nine stages, and two processes of which neither knows of the other each make all "
            "its starts. Alone and together take turns; the median of three. Tries of the "
            "construction, for order five with seven stages, which don't exist, take from 1 to 50 "
            "times as long as each other; of the trajectories one in 25 takes 40 times as long as "
            "the others. Dask's workers stand for machines: each is a group of processes of its "
            "own, which speaks with the scheduler by TCP over the loopback. Ensembles are heavy "
            "tops with a compiled right-hand side, 50 steps of CG4a each, in threads. Memory is "
            "the most that a process of its own had above what it had before, files mapped into "
            "it left out: of searches with a store whose starts are copies of the first one, of "
            "trajectories whose last points go to a file."
        ),
        rows=tuple(rows),
    )


Call = Callable[[Executor, int], object]


def _cases(quick: bool, folder: Path) -> dict[str, Call]:
    """Return work of three kinds: pieces that are alike, and pieces of which few take long."""
    starts, tries, members = (60, 8, 100) if quick else (400, 80, 20_000)
    top, rng = HeavyTop(), np.random.default_rng(1)
    f = top_field(top, folder)
    tops = top.frame.random_point(rng, (members,))
    tops[..., -3:] *= np.where(np.arange(members) % 25, 1.0, 40.0)[
        :, None
    ]  # fast spin, small steps

    def search(pool: Executor, workers: int) -> object:
        return cg.search(5, 9, starts, 1, executor=pool, workers=workers)

    def construct(pool: Executor, workers: int) -> object:
        return cg.construct(
            5, 7, 1, tries=tries, first_stages=9, force=True, executor=pool, workers=workers
        )

    def ensemble(pool: Executor, workers: int) -> object:
        return cg.solve_ensemble(
            f, (0.0, 1.0), tops, frame=top.frame, rtol=1e-8, t_eval=[1.0],
            executor=pool, workers=workers,
        )  # fmt: skip

    return {
        f"search of {starts} starts": search,
        f"construction, {tries} tries": construct,
        f"{members} trajectories with steps of their own": ensemble,
    }


def _unrelated(quick: bool, rounds: int) -> Row:
    """Return how two processes fare beside each other that have nothing to do with each other."""
    starts = 60 if quick else 200
    context = get_context("spawn")
    ratios = []
    with (
        ProcessPoolExecutor(1, mp_context=context) as first,
        ProcessPoolExecutor(1, mp_context=context) as second,
    ):

        def seconds(*pools: Executor) -> float:
            def call() -> None:
                for running in [pool.submit(_search, starts) for pool in pools]:
                    running.result()

            return _clock(call)

        for pool in (first, second):
            pool.submit(_search, 1).result()  # imports
        for _ in range(rounds):
            ratios.append(seconds(first) / seconds(first, second))
    return Row(
        f"the same search of {starts} starts twice, in processes of their own: of twice one",
        100 * float(np.median(ratios)),
        "%",
    )


def _search(starts: int) -> None:
    cg.search(5, 9, starts, 1, workers=1)


def _clock(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


Pools = tuple[Executor, Executor]


def _pools() -> dict[str, Callable[[], AbstractContextManager[Pools]]]:
    found: dict[str, Callable[[], AbstractContextManager[Pools]]] = {
        "threads": _threads,
        "processes": _processes,
    }
    try:
        import distributed  # noqa: F401
    except ImportError:
        return found
    return {**found, "Dask": _dask}


@contextmanager
def _threads() -> Iterator[Pools]:
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(WORKERS) as two:
        yield one, two


@contextmanager
def _processes() -> Iterator[Pools]:
    context = get_context("spawn")
    with (
        ProcessPoolExecutor(1, mp_context=context) as one,
        ProcessPoolExecutor(WORKERS, mp_context=context) as two,
    ):
        for pool in (one, two):
            cg.search(3, 3, 50, 1, executor=pool)  # imports
        yield one, two


@contextmanager
def _dask() -> Iterator[Pools]:
    distributed: Any = import_module("distributed")
    with ExitStack() as stack, TemporaryDirectory() as folder:
        pools = []
        for workers in (1, WORKERS):
            address = stack.enter_context(_machines(workers, folder))
            client = stack.enter_context(distributed.Client(address, timeout="60s"))
            client.wait_for_workers(workers, timeout=60)
            pools.append(stack.enter_context(client.get_executor()))
            cg.search(3, 3, 50, 1, executor=pools[-1])
        yield pools[0], pools[1]


@contextmanager
def _machines(workers: int, folder: str) -> Iterator[str]:
    """Start a scheduler and so many workers, each a group of processes of its own."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    commands = [["scheduler", "--host", "127.0.0.1", "--port", str(port)]]
    commands += [["worker", address, "--nthreads", "1"]] * workers
    running = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{what}", *words, "--no-dashboard"],
            stderr=subprocess.DEVNULL, cwd=folder, start_new_session=True,
        )
        for what, *words in commands
    ]  # fmt: skip
    try:
        yield address
    finally:
        for process in reversed(running):
            process.terminate()
            process.wait()


def _ensembles(quick: bool) -> list[Row]:
    sizes = (1, 100) if quick else (1, 100, 10_000, 1_000_000)
    top, steps, h = HeavyTop(), 50, 0.01
    rng = np.random.default_rng(1)
    rows = []
    with TemporaryDirectory() as folder:
        f = top_field(top, Path(folder))

        def seconds(members: int, repeat: int, workers: int | None) -> float:
            settings: dict[str, Any] = {
                "frame": top.frame, "method": "CG4a", "h": h, "t_eval": [steps * h],
            }  # fmt: skip

            def call() -> None:
                for _ in range(repeat):
                    if workers is None:
                        cg.solve_ivp(f, (0.0, steps * h), top.y0, **settings)
                    else:
                        cg.solve_ensemble(
                            f, (0.0, steps * h), many[:members], workers=workers, **settings
                        )

            return _clock(call) / (repeat * members)

        many = top.frame.random_point(rng, (max(sizes),))
        alone = min(seconds(1, 200, None) for _ in range(3))
        for members in sizes:
            repeat = max(1, 100 // members)
            rounds = 1 if members > 100_000 else 3
            one = min(seconds(members, repeat, 1) for _ in range(rounds))
            two = min(seconds(members, repeat, WORKERS) for _ in range(rounds))
            rows.append(
                Row(
                    f"{members} trajectories, one worker",
                    1e6 * one,
                    "µs a trajectory",
                    "one alone",
                    1e6 * alone,
                    alone / one,
                )
            )
            if members > 1:
                rows.append(
                    Row(f"{members} trajectories, two workers: of twice one worker",
                        100 * one / (WORKERS * two), "%",
                        aim=_AIM if members >= 10_000 else None)
                )  # fmt: skip
    return rows
