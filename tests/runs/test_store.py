"""Stores of searches: resumed runs, several runs and processes, damaged files, progress."""

import io
import subprocess
import sys
import threading
import zlib
from dataclasses import asdict

import pytest
from refusals import refuses

import cg
import cg.construction.search.random_search as search_module
from cg.command import main
from cg.construction.runs import Store, StoreError, read_store
from cg.construction.search.random_search import search
from cg.construction.search.start import run_start

SMALL = {"order": 3, "stages": 3, "seed": 5}
CONSTRUCT = {"order": 4, "stages": 4, "seed": 1, "tries": 3, "force": True}
TREES = {"order": 3, "stages": 3, "seed": 2, "flows": 4, "tries": 2}
COMMAND = ("search", "--order", "3", "--stages", "3", "--seed", "5", "--starts", "12")


def numbers(path):
    return [line["index"] for line in read_store(path) if "index" in line]


def fail(*_):
    raise AssertionError


@pytest.fixture
def started_runs(monkeypatch):
    """The numbers of starts that run."""
    runs = []

    def counted(settings, index):
        runs.append(index)
        return run_start(settings, index)

    monkeypatch.setattr(search_module, "run_start", counted)
    return runs


def test_more_starts_continue_fewer(store_path, started_runs):
    search(**SMALL, starts=3, store=store_path)
    more = search(**SMALL, starts=6, store=store_path, workers=1)
    assert sorted(started_runs) == [0, 1, 2, 3, 4, 5]
    whole = search(**SMALL, starts=6)
    assert more == whole
    assert search(**SMALL, starts=2, store=store_path).starts == whole.starts[:2]
    assert (more.methods, more.best, repr(more)) == (whole.methods, whole.best, repr(whole))


def test_runs_share_a_store(store_path):
    changes = [{}, {"order": 2}, {"seed": 6}, {"algorithm": "lmdif"}, {"hold": {"a[2,1]": "1/3"}}]
    changes += [{"rows": "diagonal"}, {"width": 1e200}, {"maxfev": 7}, {"flows": 4}]
    changes += [{"flows": 4, "embedded": True}, {"tree": cg.methods["CF3"]}]
    results = [search(**{**SMALL, **change}, starts=2, store=store_path) for change in changes]
    constructions = [cg.construct(**one, store=store_path) for one in (CONSTRUCT, TREES)]
    for change, result in zip(changes, results, strict=True):
        assert result == search(**{**SMALL, **change}, starts=2)
        assert result == search(**{**SMALL, **change}, starts=2, store=store_path)
    for one, construction in zip((CONSTRUCT, TREES), constructions, strict=True):
        assert cg.construct(**one) == cg.construct(**one, store=store_path) == construction
    begun = [line for line in read_store(store_path) if "settings" in line]
    kinds = [line["settings"]["kind"] for line in begun]
    assert kinds == ["search"] * len(changes) + ["construct"] * 2
    assert [line["settings"]["order"] for line in begun[:2]] == [3, 2]
    assert len(numbers(store_path)) <= 2 * len(changes) + 3 + 2


@pytest.mark.parametrize("seeds", [("1", "2"), ("1", "1")])
def test_two_processes_write_at_once(store_path, seeds):
    script = "import cg, sys; cg.search(3, 3, 40, int(sys.argv[2]), store=sys.argv[1])"
    commands = [[sys.executable, "-c", script, str(store_path), seed] for seed in seeds]
    processes = [subprocess.Popen(command) for command in commands]
    assert [process.wait(120) for process in processes] == [0, 0]
    for seed in set(map(int, seeds)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(search_module, "run_start", fail)  # all are stored
            result = search(3, 3, 40, seed, store=store_path)
        assert result == search(3, 3, 40, seed)


def test_interrupt_keeps_finished_starts(store_path, started_runs):
    def stop(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(**SMALL, starts=5, store=store_path, progress=stop, workers=1)
    assert not [t for t in threading.enumerate() if t.name.startswith("ThreadPoolExecutor")]
    assert numbers(store_path) == [0, 1]
    started_runs.clear()
    assert search(**SMALL, starts=5, store=store_path) == search(**SMALL, starts=5)
    assert sorted(started_runs)[:3] == [0, 1, 2]


def with_text(text):
    """Return the damage by a text in the last line, whose checksum is right all the same."""

    def damage(content):
        lines, begin, last = content.rpartition(b'{"run"')
        body = begin + last[:20] + text
        return lines + body + b', "crc": %d}\n' % zlib.crc32(body)

    return damage


@pytest.mark.parametrize("damage", [
    with_text(b", oops"), with_text(b', "index": "\xff"'), with_text(b', "x": ' + b"[" * 10**5),
    lambda content: content[:-20],  # the process was killed while it wrote
    lambda content: content[:-20] + b"\n",
    lambda content: content.replace(b'"nfev": ', b'"nfev": 1'),
])  # fmt: skip
def test_damaged_lines_are_ignored(store_path, damage, started_runs, caplog):
    whole = search(**SMALL, starts=4, store=store_path, workers=1)
    store_path.write_bytes(damage(store_path.read_bytes()))
    started_runs.clear()
    assert search(**SMALL, starts=5, store=store_path, workers=1).starts[:4] == whole.starts
    assert started_runs in ([3, 4], [0, 1, 2, 3, 4])
    assert "damaged, and ignored" in caplog.text
    started_runs.clear()
    search(**SMALL, starts=5, store=store_path)
    assert started_runs == []


@pytest.mark.parametrize("content", [b"notes", b"\xff\xfe\x00\n" * 40, b"\n" * 9000])
def test_refuses_other_files_unchanged(store_path, content):
    store_path.write_bytes(content)
    refuses(StoreError, "isn't a file of runs of this package", search, **SMALL, store=store_path)
    assert store_path.read_bytes() == content


def test_refuses_runs_of_another_version(store_path):
    settings = search(**SMALL, starts=1, store=store_path).settings
    store = Store(store_path, asdict(settings))
    store.append({"index": 1, "residual": 0.0})
    store.close()
    refuses(StoreError, "another version of this package", search, **SMALL, store=store_path)


def test_full_disk(store_path, monkeypatch):
    store = Store(store_path, {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "_file", io.BytesIO())
        patch.setattr(store._file, "write", lambda data: 3, raising=False)
        refuses(OSError, "store can't be written", store.append, {"index": 1})
    store.close()


def test_rejects_impossible_paths(tmp_path):
    path = tmp_path / "none" / "runs.jsonl"
    refuses(FileNotFoundError, "store must be in an", search, **SMALL, starts=1, store=path)
    with pytest.raises(IsADirectoryError):
        search(**SMALL, starts=1, store=tmp_path)
    refuses(ValueError, "store must", search, **SMALL, starts=1, store="/dev/null")
    refuses(TypeError, "store must", search, **SMALL, starts=1, store=3)


def test_progress(store_path, capsys):
    calls = []
    cg.search(**SMALL, starts=12, progress=lambda *now: calls.append(now))
    assert calls == [(done, 12) for done in range(1, 13)]
    for call, count in ((cg.search, "starts"), (cg.construct, "tries")):
        refuses(TypeError, "progress must be callable, got 'yes'; True asks", call, 3, 3, seed=1,
                progress="yes", **{count: 1})  # fmt: skip
    pytest.importorskip("tqdm")
    cg.search(**SMALL, starts=6, store=store_path)
    result = cg.search(**SMALL, starts=12, store=store_path, progress=True)
    text = capsys.readouterr().err
    assert "12/12" in text
    assert f"{result.exact_starts} solved, smallest f" in text
    assert main([*COMMAND]) == 0
    assert "12/12" in capsys.readouterr().err
    assert main([*COMMAND, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_interrupted_command_says_how_to_continue(capsys, monkeypatch, store_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(cg.construction.runs, "completed", interrupted)
    assert main([*COMMAND, "--store", str(store_path)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"crouch-grossman: interrupted; finished results are in {store_path}; run the same search "
        "again to continue, on any executor"
    )
    assert main([*COMMAND]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "crouch-grossman: interrupted"
