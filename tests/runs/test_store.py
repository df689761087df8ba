"""Stores of searches: resumed runs, several runs and processes."""

import math
import sqlite3
import subprocess
import sys
import threading
from functools import partial

import pytest
from stored_runs import starts_of_the_file_alone, stored_numbers

import cg
import cg.command
import cg.construction.search.random_search as search_module
from cg.construction.runs import Store
from cg.construction.search.random_search import search
from cg.construction.search.start import run_start

SMALL = {"order": 3, "stages": 3, "seed": 5}
CONSTRUCT = {"order": 4, "stages": 4, "seed": 1, "tries": 3, "force": True}


class TestSearch:
    def counted_runs(self, monkeypatch):
        runs = []

        def counted(settings, index):
            runs.append(index)
            return run_start(settings, index)

        monkeypatch.setattr(search_module, "run_start", counted)
        return runs

    def test_more_starts_continue_fewer(self, path, monkeypatch):
        search(**SMALL, starts=3, store=path)
        runs = self.counted_runs(monkeypatch)
        more = search(**SMALL, starts=6, store=path, workers=1)
        assert runs == [3, 4, 5]
        whole = search(**SMALL, starts=6)
        assert more == whole
        assert search(**SMALL, starts=2, store=path).starts == whole.starts[:2]
        assert (more.methods, more.best, repr(more)) == (whole.methods, whole.best, repr(whole))

    def test_stored_starts_are_sequence(self, tmp_path):
        stored = search(**SMALL, starts=6, store=tmp_path / "runs.db").starts
        whole = search(**SMALL, starts=6).starts
        assert len(stored) == 6
        assert (stored[2], stored[-1], stored[1:5:2]) == (whole[2], whole[-1], whole[1:5:2])
        assert whole[3] in stored
        assert stored != whole[:5]
        for index in (6, -7):
            with pytest.raises(IndexError, match=f"start {index} of 6"):
                stored[index]

    def test_runs_share_a_store(self, path):
        changes = [{}, {"order": 2}, {"seed": 6}, {"algorithm": "lmdif"}]
        changes += [{"rows": "diagonal"}, {"width": 1e200}, {"maxfev": 7}, {"flows": 4}]
        changes += [{"flows": 4, "embedded": True}, {"tree": cg.methods["CF3"]}]
        results = [search(**{**SMALL, **change}, starts=2, store=path) for change in changes]
        construction = cg.construct(**CONSTRUCT, store=path)
        for change, result in zip(changes, results, strict=True):
            assert result == search(**{**SMALL, **change}, starts=2)
            assert result == search(**{**SMALL, **change}, starts=2, store=path)
        assert cg.construct(**CONSTRUCT, store=path) == construction
        with Store(path) as opened:
            runs = opened.runs()
        assert [run.kind for run in runs] == ["search"] * len(changes) + ["construct"]
        assert [run.starts for run in runs] == [2] * len(changes) + [3]
        assert [run.settings["order"] for run in runs[:2]] == [3, 2]
        assert all(run.seconds > 0 and not run.running and not run.failed for run in runs)

    def test_best_f_is_taken_after_refinement(self, path):
        starts = search(**SMALL, starts=6, store=path).starts
        ends = [start.quad.f if start.quad else start.double.f for start in starts]
        assert min(ends) < min(start.double.f for start in starts)
        with Store(path) as opened:
            (run,) = opened.runs()
            assert run.best == min(ends)
            assert min(opened.run(1).decades()) == max(-99, math.floor(math.log10(min(ends))))

    def test_two_processes_write_at_once(self, path):
        script = "import cg, sys; cg.search(3, 3, 40, int(sys.argv[2]), store=sys.argv[1])"
        commands = [[sys.executable, "-c", script, str(path), seed] for seed in ("1", "2")]
        processes = [subprocess.Popen(command) for command in commands]
        assert [process.wait(120) for process in processes] == [0, 0]
        with Store(path) as opened:
            assert [run.starts for run in opened.runs()] == [40, 40]
            assert {run.settings["seed"] for run in opened.runs()} == {1, 2}
        assert starts_of_the_file_alone(path) == [40, 40]

    def test_open_while_another_creates_the_tables(self, path, monkeypatch):
        others = []

        class Slow(sqlite3.Connection):
            def execute(self, statement, *values):
                if "sqlite_master" in statement and not others:
                    others.append(threading.Thread(target=lambda: Store(path).close()))
                    others[0].start()
                    others[0].join(0.3)
                return super().execute(statement, *values)

        monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Slow))
        Store(path).close()
        others[0].join()
        with Store(path) as opened:
            assert opened.runs() == ()

    def test_interrupt_at_begin_of_transaction(self, path, monkeypatch):
        begun = []

        class Interrupted(sqlite3.Connection):
            def execute(self, statement, *values):
                cursor = super().execute(statement, *values)
                begun.extend([statement] if statement == "BEGIN IMMEDIATE" else [])
                if len(begun) == 4 and statement == "BEGIN IMMEDIATE":
                    raise KeyboardInterrupt
                return cursor

        monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Interrupted))
        with pytest.raises(KeyboardInterrupt):
            search(**SMALL, starts=5, store=path, workers=1)
        assert len(begun) > 4  # the run was closed
        assert len(stored_numbers(path)) < 5
        assert search(**SMALL, starts=5, store=path) == search(**SMALL, starts=5)

    def test_exception_of_progress_keeps_finished_starts(self, path, monkeypatch):
        def stop(done, _):
            if done == 2:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt) as caught:
            search(**SMALL, starts=5, store=path, progress=stop, workers=1)
        assert not [t for t in threading.enumerate() if t.name.startswith("ThreadPoolExecutor")]
        del caught
        assert stored_numbers(path) == [0, 1]
        runs = self.counted_runs(monkeypatch)
        search(**SMALL, starts=5, store=path)
        assert sorted(runs) == [2, 3, 4]
