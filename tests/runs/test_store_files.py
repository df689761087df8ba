"""Files of stores: locks, logs, damaged and forged contents."""

import json
import os
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from functools import partial

import pytest
from refusals import refuses
from stored_runs import starts_of_the_file_alone, stored_numbers

import cg
import cg.command
from cg.construction.runs import Store, StoredStart, database, schema, store
from cg.construction.search.random_search import search

SMALL = {"order": 3, "stages": 3, "seed": 5}
CONSTRUCT = {"order": 4, "stages": 4, "seed": 1, "tries": 3, "force": True}
TREES = {"order": 3, "stages": 3, "seed": 2, "flows": 4, "tries": 2}
ENTRY = StoredStart(
    number=0, stages=3, phase="double", f=0.5, status=1, evaluations=2, largest_residual=0.7,
    solved=False, coefficients=bytes(96),
)  # fmt: skip


def run_sql(path, statement, *values):
    with closing(sqlite3.connect(path)) as connection, connection:
        assert connection.execute(statement, values).rowcount == 1


FORGERIES = {
    "solved": "UPDATE starts SET solved = NOT solved WHERE number = ?",
    "a residual": "UPDATE starts SET largest_residual = largest_residual / 2 + 1e-40 "
    "WHERE number = ?",
    "coefficients": "UPDATE starts SET coefficients = zeroblob(96) WHERE number = ?",
    "one too few": "UPDATE starts SET coefficients = zeroblob(80) WHERE number = ?",
    "half of one": "UPDATE starts SET coefficients = zeroblob(88) WHERE number = ?",
    "a text": "UPDATE starts SET coefficients = '0.5' WHERE number = ?",
    "f": "UPDATE starts SET f = 'small' WHERE number = ?",
    "a status": "UPDATE starts SET status = 'good' WHERE number = ?",
    "an index": "UPDATE starts SET number = -1 WHERE number = ?",
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_rejects_forged_starts(forgery, path, caplog):
    whole = search(**SMALL, starts=6, store=path)
    assert {start.exact for start in whole.starts} == {True, False}
    content = path.read_bytes()
    for number in range(6):
        path.write_bytes(content)
        run_sql(path, FORGERIES[forgery], number)
        refuses(ValueError, "not the entry of a start", search, **SMALL, starts=6, store=path)
        assert "still in its log" not in caplog.text


@pytest.mark.parametrize("settings", [CONSTRUCT, TREES])
@pytest.mark.parametrize("change", [
    "solved = NOT solved", "f = f / 2 + 1e-300",
    "coefficients = zeroblob(length(coefficients) - 16)",
    "coefficients = zeroblob(length(coefficients))", "number = -5", "stages = stages + 1",
    "tree = '{}'",
])  # fmt: skip
def test_rejects_forged_tries(settings, change, path, caplog):
    whole = cg.construct(**settings, workers=1, store=path)
    assert cg.construct(**settings, store=path) == whole
    run_sql(path, f"UPDATE starts SET {change} WHERE number = 0")
    refuses(ValueError, "not the entry of an attempt", cg.construct, **settings, store=path)
    assert "still in its log" not in caplog.text


def killed(path):
    """Leave a store whose run was killed after its first start."""
    script = (
        "import cg, os, sys\n"
        "cg.search(3, 3, 9, 5, store=sys.argv[1], workers=1, progress=lambda *_: os._exit(9))"
    )
    assert subprocess.run([sys.executable, "-c", script, str(path)], check=False).returncode == 9


def only_immutable(monkeypatch):
    """Refuse connections as in a folder where nothing can be written."""
    connect = sqlite3.connect

    class Refusing(sqlite3.Connection):
        def execute(self, *arguments):
            raise sqlite3.OperationalError("unable to open database file")

    def refusing(file, **options):
        kind = sqlite3.Connection if "immutable" in file else Refusing
        return connect(file, factory=kind, **options)

    monkeypatch.setattr(sqlite3, "connect", refusing)


class TestLog:
    """SQLite's log beside the file."""

    def test_new_store_is_readable_without_log(self, path):
        with Store(path):
            assert starts_of_the_file_alone(path) == []

    @pytest.mark.parametrize("other", [Store, partial(Store, read=True)])
    def test_finished_run_is_in_file_while_others_have_it_open(self, other, path):
        Store(path).close()
        with other(path):
            search(**SMALL, starts=20, store=path)
            assert starts_of_the_file_alone(path) == [20]
        assert starts_of_the_file_alone(path) == [20]

    def test_warns_if_reader_prevents_folding(self, path, monkeypatch, caplog):
        monkeypatch.setattr(database, "_FOLD_SECONDS", 0.1)
        result = search(**SMALL, starts=2, store=path)
        with closing(iter(result.starts)) as reading:
            next(reading)
            search(**SMALL, starts=9, store=path)
        assert "is still in its log runs.db-wal (other connections are open)" in caplog.text
        assert starts_of_the_file_alone(path) == [2]
        Store(path).close()
        assert starts_of_the_file_alone(path) == [9]

    def test_waits_for_another_process_that_folds(self, path, monkeypatch, caplog):
        killed(path)
        pauses = []

        class Folding(sqlite3.Connection):
            def execute(self, statement, *values):
                if "TRUNCATE" in statement and not pauses:  # what SQLite returns at once
                    return super().execute("SELECT 1, -1, -1")
                return super().execute(statement, *values)

        connect = partial(sqlite3.connect, factory=Folding)
        monkeypatch.setattr(sqlite3, "connect", connect)
        monkeypatch.setattr(database.time, "sleep", pauses.append)
        database.fold_log(path)
        assert len(pauses) == 1
        assert starts_of_the_file_alone(path) == [1]
        assert "still in its log" not in caplog.text

    def test_warns_if_log_cannot_be_folded(self, path, caplog):
        killed(path)
        path.write_bytes(b"notes " * 1000)
        database.fold_log(path)
        assert "still in its log runs.db-wal (file is not a database)" in caplog.text

    def test_error_if_log_cannot_be_read(self, path, monkeypatch, capsys):
        killed(path)
        only_immutable(monkeypatch)
        refuses(OSError, r"part of it is in its log runs\.db-wal", Store, path, read=True)
        assert cg.command.main(["runs", "list", str(path)]) == 2
        assert "part of it is in its log runs.db-wal" in capsys.readouterr().err

    def test_warns_if_log_is_missing(self, path, caplog):
        killed(path)
        with Store(path, read=True) as opened:
            assert [run.starts for run in opened.runs()] == [1]
        assert not caplog.text
        for _ in range(2):
            starts_of_the_file_alone(path)
            assert "copy.db may lack starts" in caplog.text
            caplog.clear()
        Store(path).close()
        assert starts_of_the_file_alone(path) == [1]
        assert not caplog.text

    def test_rejects_empty_file_without_log(self, path):
        with closing(sqlite3.connect(path)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
        with pytest.raises(ValueError, match=r"is not a store, or its log runs\.db-wal is missing"):
            Store(path, read=True)


class TestFile:
    def test_rejects_second_process_with_same_settings(self, path):
        script = "import cg, sys; cg.search(3, 3, 4, 5, store=sys.argv[1])"
        command = [sys.executable, "-c", script, str(path)]
        settings = vars(search(**SMALL, starts=1, store=path).settings)
        with Store(path) as opened, closing(opened.begin("search", settings)):
            process = subprocess.run(command, capture_output=True, text=True, check=False)
            assert process.returncode == 1
            assert f"in use by process {os.getpid()}" in process.stderr
            refuses(BlockingIOError, "in use by process", search, **SMALL, starts=4, store=path)
            assert opened.runs()[0].running
        assert subprocess.run(command, check=False).returncode == 0
        assert stored_numbers(path) == [0, 1, 2, 3]

    @pytest.mark.parametrize("owner", [
        {"process": 2**22 + 1, "began": 1},  # no such process
        {"process": os.getppid(), "began": 1},  # another one has its number now
    ])  # fmt: skip
    def test_resumes_run_of_dead_process(self, path, owner):
        search(**SMALL, starts=1, store=path)
        machine = socket.gethostname()
        run_sql(path, "UPDATE runs SET owner = ?", json.dumps({"machine": machine, **owner}))
        assert len(search(**SMALL, starts=2, store=path).starts) == 2

    def test_resumes_silent_run_of_another_machine(self, path):
        search(**SMALL, starts=1, store=path)
        owner = json.dumps({"machine": "another", "process": 1, "began": 1})
        run_sql(path, "UPDATE runs SET owner = ?, changed = ?", owner, time.time())
        with pytest.raises(BlockingIOError):
            search(**SMALL, starts=2, store=path)
        run_sql(path, "UPDATE runs SET changed = ?", time.time() - 100)
        assert len(search(**SMALL, starts=2, store=path).starts) == 2

    @pytest.mark.parametrize("content", [b"notes\n", b"\xff\xfe\x00\n" * 40, b"\n" * 9000])
    def test_refuses_other_files_unchanged(self, path, content):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"runs\.db is not an SQLite database"):
            search(**SMALL, starts=1, store=path)
        assert path.read_bytes() == content

    def test_refuses_other_databases_unchanged(self, path):
        with closing(sqlite3.connect(path)) as connection:
            connection.execute("CREATE TABLE starts (x)")
        content = path.read_bytes()
        refuses(ValueError, "a database of another program", search, **SMALL, starts=1, store=path)
        assert path.read_bytes() == content

    def test_error_names_damaged_file(self, path):
        search(**SMALL, starts=30, store=path)
        content = bytearray(path.read_bytes())
        content[4096:] = b"\xa5" * (len(content) - 4096)
        path.write_bytes(content)
        refuses(ValueError, r"runs\.db", search, **SMALL, starts=31, store=path)

    @pytest.mark.parametrize("read", [False, True])
    @pytest.mark.parametrize("version", [schema.VERSION - 1, schema.VERSION + 1])
    def test_refuses_store_of_another_version_unchanged(self, path, version, read):
        search(**SMALL, starts=1, store=path)
        with closing(sqlite3.connect(path)) as connection:
            connection.execute(f"PRAGMA user_version = {version}")
        content = path.read_bytes()
        refuses(ValueError, "written by another version", Store, path, read=read)
        assert path.read_bytes() == content

    def test_full_disk_keeps_stored_starts(self, path):
        with Store(path) as opened, closing(opened.begin("search", {"order": 3})) as run:
            (pages,) = opened._connection.execute("PRAGMA page_count").fetchone()
            opened._connection.execute(f"PRAGMA max_page_count = {pages + 4}")
            run.append([ENTRY])
            many = [replace(ENTRY, number=k) for k in range(2000)]
            refuses(OSError, "store can't be used: database or disk is full", run.append, many)
            complete = list(run.numbers())
            assert complete == [0]  # all of a call or nothing
        assert stored_numbers(path) == complete

    def test_error_for_readonly_file(self, path, monkeypatch):
        search(**SMALL, starts=1, store=path)
        connect = sqlite3.connect
        monkeypatch.setattr(
            store.sqlite3, "connect", lambda file, **options: connect(f"{file}?mode=ro", **options)
        )
        refuses(OSError, "readonly database", search, **SMALL, starts=2, store=path)
        monkeypatch.undo()
        assert stored_numbers(path) == [0]

    def test_result_reads_its_own_file_after_chdir(self, tmp_path, monkeypatch):
        for name, seed in (("a", 1), ("b", 9)):
            (tmp_path / name).mkdir()
            monkeypatch.chdir(tmp_path / name)
            result = search(2, 2, 3, seed, store="runs.db")
            expected = search(2, 2, 3, seed)
        monkeypatch.chdir(tmp_path / "a")
        assert result.starts == expected.starts
        assert repr(result) == repr(expected)
        os.remove(tmp_path / "b" / "runs.db")
        refuses(FileNotFoundError, "store must", list, result.starts)
        assert not (tmp_path / "b" / "runs.db").exists()

    @pytest.mark.parametrize("name", [":memory:", "file:x?mode=memory", "a?b#c%20.db", "ü ñ.db"])
    def test_names_special_to_sqlite(self, name, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        first = search(**SMALL, starts=2, store=name)
        assert (tmp_path / name).is_file()
        assert search(**SMALL, starts=2, store=name).starts == first.starts

    @pytest.mark.parametrize("content", [b"", b"[method]\n"])
    def test_reading_changes_no_file(self, content, tmp_path):
        path = tmp_path / "a.toml"
        path.write_bytes(content)
        refuses(ValueError, r"is not a store|not an SQLite database", Store, path, read=True)
        assert path.read_bytes() == content
        assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]

    def test_reads_in_readonly_folder(self, path, monkeypatch):
        """SQLite can't create the files that readers share there."""
        search(**SMALL, starts=2, store=path)
        before = path.read_bytes()
        only_immutable(monkeypatch)
        with Store(path, read=True) as opened:
            assert [run.starts for run in opened.runs()] == [2]
        assert path.read_bytes() == before

    def test_rejects_impossible_paths(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            search(**SMALL, starts=1, store=tmp_path / "none" / "runs.db")
        with pytest.raises(IsADirectoryError):
            search(**SMALL, starts=1, store=tmp_path)
        refuses(ValueError, "store must", search, **SMALL, starts=1, store="/dev/null")
        refuses(TypeError, "store must", search, **SMALL, starts=1, store=3)

    def test_rejects_missing_run(self, tmp_path):
        with Store(tmp_path / "runs.db") as opened, pytest.raises(KeyError, match="no run 3"):
            opened.run(3)
