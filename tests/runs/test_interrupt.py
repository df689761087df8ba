"""Interrupted runs: unfinished starts leave no trace, finished ones stay."""

import signal
import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from refusals import refuses
from slow_cases import slow

from cg import _core_r64, _core_r128
from cg.construction.conditions import table_rows
from cg.construction.layouts import Layout
from cg.construction.runs import read_store
from cg.construction.search.construct import construct
from cg.construction.search.random_search import search
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import parallel, quads
from cg.support.parallel import Stopped, completed, stoppable
from cg.support.shared_numbers import LmdifStatus, MinimumNormStatus

FOREVER = 10**9  # iterations; no run of the tests waits for them
ORDER, STAGES = 7, 36  # one iteration of the fast solver takes some 50 ms here
TOO_FEW = 27  # no start of order 7 converges with so few stages, so that runs don't end either
LAYOUT = Layout.tableau(TOO_FEW)
PATIENCE = 60  # seconds after which a run that should have ended is taken to hang


def guess(stages=STAGES):
    return np.random.default_rng(1).uniform(-0.5, 0.5, ConditionSystem.tableau(ORDER, stages).size)


def fit_fast(stop_flag):
    x0 = guess(TOO_FEW)
    trees, owner = ConditionSystem.tableau(ORDER, TOO_FEW).conditions(independent=True)
    movable = np.arange(1, x0.size + 1, dtype=np.intc)
    return _core_r64.fit_minimum_norm(
        ORDER, LAYOUT.code, x0, trees, owner, movable, 0.0, 1e-2, FOREVER, stop_flag
    )


def fit_lmdif(stop_flag, quadruple=False):
    x0 = guess(TOO_FEW)
    trees = np.array(table_rows(ORDER), dtype=np.intc)
    if not quadruple:
        return _core_r64.fit_lmdif(ORDER, LAYOUT.code, x0, trees, [0], [0], FOREVER, stop_flag)
    bits, zero = quads.from_float(x0).T, quads.from_float([0.0]).T
    return _core_r128.fit_lmdif(ORDER, LAYOUT.code, bits, trees, zero, zero, FOREVER, stop_flag)


ENTRIES = {
    "fast": fit_fast, "lmdif": fit_lmdif,
    "lmdif in real(16)": lambda stop_flag: fit_lmdif(stop_flag, quadruple=True),
}  # fmt: skip


def run_all(work, items, workers):
    for _, result in completed(work, items, workers=workers):
        yield result


def called_in_thread(call, *arguments):
    results = []
    thread = threading.Thread(target=lambda: results.append(call(*arguments)), daemon=True)
    thread.start()
    return thread, results


class TestFlag:
    @pytest.mark.parametrize("entry", ENTRIES)
    def test_flag_set_during_call_stops_it(self, entry):
        flag = np.zeros(1, dtype=np.intc)
        thread, results = called_in_thread(ENTRIES[entry], flag)
        time.sleep(0.2)
        assert thread.is_alive()
        flag[0] = 1
        thread.join(PATIENCE)
        assert not thread.is_alive()
        status = results[0][-1] if entry == "fast" else results[0][-2]
        stopped = MinimumNormStatus.STOPPED if entry == "fast" else LmdifStatus.STOPPED_BY_USER
        assert status == stopped

    @pytest.mark.parametrize("entry", ENTRIES)
    def test_flag_set_before_call_stops_it(self, entry):
        result = ENTRIES[entry](np.ones(1, dtype=np.intc))
        x = result[0] if entry != "lmdif in real(16)" else quads.to_float(result[0].T.copy())
        np.testing.assert_array_equal(x, guess(TOO_FEW))


class TestThreads:
    def test_closing_run_stops_workers(self):
        work = lambda index: index if index == 0 else stoppable(fit_fast)
        with closing(run_all(work, range(10), 2)) as running:
            assert next(running) == 0
        assert not workers()

    def test_exception_stops_other_workers(self):
        begun = threading.Event()

        def work(index):
            if index == 0:
                begun.wait()
                raise ArithmeticError("index 0")
            return stoppable(lambda flag: (begun.set(), fit_fast(flag)))

        refuses(ArithmeticError, "index 0", list, run_all(work, range(2), 2))
        assert not workers()

    def test_stopped_pieces_give_no_results(self, monkeypatch):
        ends, begun = [], threading.Event()

        def work(index):
            try:
                return stoppable(lambda flag: (begun.set(), fit_fast(flag)))
            except Stopped:
                ends.append("stopped")
                raise

        def interrupted(_, **__):
            begun.wait()
            raise KeyboardInterrupt

        monkeypatch.setattr(parallel, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            list(run_all(work, range(1), 1))
        assert ends == ["stopped"]

    def test_refinement_stops(self):
        x = quads.from_float(guess())

        def work(_):
            parallel._worker.stop_flag[0] = 1
            return refine(x, ConditionSystem.tableau(ORDER, STAGES))

        with pytest.raises(Stopped):
            list(run_all(work, range(1), 1))

    def test_stoppable_in_any_thread(self):
        system = ConditionSystem.tableau(5, 9)
        x0 = np.random.default_rng(9).uniform(-0.5, 0.5, system.size)
        here = fit_conditions(x0, system)
        assert here.status == MinimumNormStatus.SOLVED
        detour = fit_conditions(x0, system, max_iterations=FOREVER)  # too many to stay here
        thread, results = called_in_thread(lambda: fit_conditions(x0, system))
        thread.join(PATIENCE)
        (pooled,) = run_all(lambda _: fit_conditions(x0, system), range(1), 1)
        for other in (*results, pooled, detour):
            np.testing.assert_array_equal(other.x, here.x)
            assert (other.f, other.evaluations) == (here.f, here.evaluations)

    def test_runs_stop_independently(self):
        def work(index):
            for _ in run_all(lambda inner: inner, range(3), 2):
                pass
            return fit_conditions(np.full(3, 0.4), ConditionSystem.tableau(2, 2)).status

        assert list(run_all(work, range(4), 2)) == [MinimumNormStatus.SOLVED] * 4


def workers():
    return [t for t in threading.enumerate() if t.name.startswith("ThreadPoolExecutor")]


SCRIPT = """
import time
import cg
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.system import ConditionSystem
import numpy as np

system = ConditionSystem.tableau(7, 27)

def say_and_wait(*_):
    print("one", flush=True)
    time.sleep(600)  # the interrupt ends it; otherwise the run could end before on a busy machine

print("ready", flush=True)
try:
    {call}
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""
LONG_FIT = "fit_conditions(np.full(378, 0.1), system, ftol=0, max_iterations=10**9)"


def interrupted_after(call, begun):
    """Run the call in a process of its own, interrupt it when `begun`, return its last line."""
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(call=call)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout.readline() == "ready\n"
        begun(process)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    return output.splitlines()[-1]


def numbers(path):
    return sorted(line["index"] for line in read_store(path) if "index" in line)


def after_one(process):
    assert process.stdout.readline() == "one\n"


def after_seconds(process):
    time.sleep(0.5)
    assert process.poll() is None


class TestInterrupt:
    @pytest.mark.parametrize("call", [
        LONG_FIT,
        "cg.search(7, 27, 9, seed=1, maxfev=10**9, workers=2)",
        "cg.search(7, 27, 9, seed=1, maxfev=10**9, workers=2, executor='processes')",
        "cg.search(7, 27, 9, seed=1, algorithm='lmdif', maxfev=10**9, workers=1)",
        "cg.search(7, 27, 9, seed=1, algorithm='lmdif', maxfev=1, refine_below=1e300,"
        " refine_maxfev=10**9, workers=2)",
        "cg.construct(7, 27, seed=1, iterations=10**9, workers=2)",
    ])  # fmt: skip
    def test_interrupt_stops_long_call(self, call):
        assert interrupted_after(call, after_seconds) == "interrupted"

    @pytest.mark.parametrize(("function", "options"), [
        (search, {"order": 7, "stages": 36, "starts": 3, "seed": 1, "maxfev": 20}),
        *slow((construct, {"order": 7, "stages": 36, "tries": 3, "seed": 1, "iterations": 10})),
    ])  # fmt: skip
    def test_interrupted_run_is_resumed(self, function, options, store_path):
        name = function.__name__
        call = (
            f"cg.{name}(**{options}, workers=1, store={str(store_path)!r}, progress=say_and_wait)"
        )
        assert interrupted_after(call, after_one) == "interrupted"
        assert numbers(store_path) == [0]
        assert function(**options, store=store_path) == function(**options)
        assert numbers(store_path) == [0, 1, 2]
