"""Two workers against one, on each executor; ensembles from one trajectory to a million."""

from __future__ import annotations

import logging
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

from .compiled_top import CompiledTop
from .record import Aim, Result, Row

WORKERS = 2
_AIM = Aim(90.0, True, "value")


def run(quick: bool, figures: Path | None) -> Result:
    """Measure searches and ensembles; by the clock, so on a machine that does nothing else."""
    rounds, starts = (1, 60) if quick else (5, 600)
    rows = []
    for name, pool in _pools().items():
        with pool() as (one, two):
            ratios = []
            for _ in range(rounds):
                alone = _clock(lambda: cg.search(5, 9, starts, 1, executor=one, workers=1))
                both = _clock(lambda: cg.search(5, 9, starts, 1, executor=two, workers=WORKERS))
                ratios.append(alone / (WORKERS * both))
        efficiency = float(np.median(ratios))
        rows.append(
            Row(f"search of {starts} starts, {name}: of twice one worker", 100 * efficiency, "%",
                aim=_AIM)
        )  # fmt: skip
    rows += _ensembles(quick)
    return Result(
        title="Workers, and ensembles of any size",
        method=(
            "By the clock. The search is for order five with nine stages. Dask's two workers are "
            "processes that speak with the scheduler by TCP over the loopback, as two machines "
            "would. Ensembles are heavy tops with a compiled right-hand side, 50 steps of CG4a "
            "each, in threads."
        ),
        rows=tuple(rows),
    )


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
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                    local_directory=folder,
                )
            )
            client = stack.enter_context(distributed.Client(cluster))
            pools.append(stack.enter_context(client.get_executor()))
            cg.search(3, 3, 50, 1, executor=pools[-1])
        yield pools[0], pools[1]


def _ensembles(quick: bool) -> list[Row]:
    sizes = (1, 100) if quick else (1, 100, 10_000, 1_000_000)
    top, steps, h = HeavyTop(), 50, 0.01
    rng = np.random.default_rng(1)
    rows = []
    with TemporaryDirectory() as folder:
        f = CompiledTop(top, Path(folder)).f

        def seconds(members: int, repeat: int, workers: int | None) -> float:
            y0 = top.y0 if workers is None else many[:members]

            def call() -> None:
                for _ in range(repeat):
                    cg.solve_ivp(
                        f, (0.0, steps * h), y0, frame=top.frame, method="CG4a", h=h,
                        t_eval=[steps * h], workers=workers,
                    )  # fmt: skip

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
