"""Two workers compared with one, on each executor; ensembles of up to a million members."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from importlib.util import find_spec
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

TITLE = "Workers, and ensembles of any size"
METHOD = (
    "Wall-clock times. 100 % means that two workers are twice as fast as one. The first row is the "
    "limit of the machine: two independent processes run the same search, for order five with nine "
    "stages. Runs with one and with two workers alternate; medians of three. The tries of the "
    "construction differ in time by a factor of up to 50; of the ensemble with adaptive steps one "
    "member in 25 takes 40 times as long as the others. Dask's workers are separate process groups "
    "that use TCP. The other ensembles are heavy tops with a compiled right-hand side and 50 steps "
    "of CG4a, in threads. Memory is the peak growth of a process, without files mapped into it: of "
    "searches with a store, and of ensembles whose output goes to a file."
)
WORKERS = 2
_AIM = Aim(90.0, True, "value")


def run(quick: bool, figures: Path | None) -> Result:
    """Measure searches and ensembles; the machine must be idle otherwise."""
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
                        Row(f"{case}, {name}: efficiency of two workers", efficiency, "%", aim=_AIM)
                    )
    rows += _ensembles(quick)
    rows += memory_rows(quick)
    return Result(TITLE, METHOD, tuple(rows))


Call = Callable[[Executor, int], object]


def _cases(quick: bool, folder: Path) -> dict[str, Call]:
    """Return three kinds of work, with pieces of equal and of different lengths."""
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
        f"ensemble of {members}, adaptive steps": ensemble,
    }


def _unrelated(quick: bool, rounds: int) -> Row:
    """Return the efficiency of two independent processes."""
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
        f"search of {starts} starts in each of two independent processes: efficiency",
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
    pools: dict[str, Callable[[], AbstractContextManager[Pools]]] = {
        "threads": _threads,
        "processes": _processes,
    }
    if find_spec("distributed") is not None:
        pools["Dask"] = _dask
    return pools


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
    """Start a scheduler and workers, each in its own process group."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
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
                    f"ensemble of {members}, one worker",
                    1e6 * one,
                    "µs per member",
                    "`solve_ivp`",
                    1e6 * alone,
                    alone / one,
                )
            )
            if members > 1:
                rows.append(
                    Row(f"ensemble of {members}: efficiency of two workers",
                        100 * one / (WORKERS * two), "%",
                        aim=_AIM if members >= 10_000 else None)
                )  # fmt: skip
    return rows
