"""The subcommand `runs`."""

import json
from dataclasses import replace

import pytest

import cg
from cg.construction.runs import Failure, Store


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "runs.db"
    cg.search(3, 3, 30, 1, store=path)
    cg.search(4, 4, 3, 1, store=path, force=True)  # there are none
    settings = cg.search(3, 3, 1, 1).settings
    with Store(path) as store:
        run = store.begin("search", vars(settings))
        run.fail(Failure(99, "Killed"))
        run.close()
    return str(path)


def test_list(run_command, path):
    code, out, _ = run_command("runs", "list", path)
    assert code == 0
    lines = out.splitlines()
    assert lines[1].split()[:6] == ["1", "search", "3", "3", "-", "1"]
    assert lines[1].split()[6] == "30"
    assert lines[2].split()[6:9] == ["3", "0", "0"]
    code, out, _ = run_command("runs", "list", path, "--json")
    assert [run["starts"] for run in json.loads(out)] == [30, 3]
    assert json.loads(out)[0]["failed"] == 1


def test_show(run_command, path):
    code, out, _ = run_command("runs", "show", path, "1", "--json")
    data = json.loads(out)
    exact = sum(start.exact for start in cg.search(3, 3, 30, 1).starts)
    assert (code, data["starts"], data["solved"]) == (0, 30, exact)
    assert sum(data["decades"].values()) == 30
    assert 1 <= data["families_at_most"] < data["distinct"] <= exact
    assert data["failures"] == [[99, "Killed"]]
    code, out, _ = run_command("runs", "show", path, "1")
    assert "rows explicit" in out
    assert "30 starts in" in out
    assert f"{exact} solved, 1 failed" in out
    assert "start 99 failed: Killed" in out
    bars = [line for line in out.splitlines() if line.startswith("  1e")]
    assert [int(line.split()[1]) for line in bars] == list(data["decades"].values())
    assert max(bar.count("#") for bar in bars) == 40


def test_best(run_command, path):
    code, out, _ = run_command("runs", "best", path, "1", "--count", "3", "--json")
    errors = [one["principal_error"] for one in json.loads(out)]
    assert code == 0
    assert errors == sorted(errors)
    assert len(errors) == 3
    code, out, _ = run_command("runs", "best", path, "1", "--objective", "largest_coefficient")
    largest = [float(line.split()[4]) for line in out.splitlines()[1:]]
    assert largest == sorted(largest)
    assert len(largest) == 10
    assert len({len(line) for line in out.splitlines()}) == 1  # columns are aligned
    code, out, _ = run_command("runs", "best", path, "2")
    assert (code, out) == (1, "no start led to a method\n")


def test_publish(run_command, path, tmp_path):
    code, out, _ = run_command("runs", "publish", path, "1", "Mine", "--folder", str(tmp_path))
    assert code == 0
    assert f"wrote {tmp_path / 'Mine.toml'}" in out
    assert cg.construction.catalogue.load(tmp_path / "Mine.toml").order == 3
    before, now = (float(part.split()[-1]) for part in out.splitlines()[1].split(", now"))
    assert now <= before
    code, _, err = run_command("runs", "publish", path, "2", "None", "--folder", str(tmp_path))
    assert code == 2
    assert "run 2 has no start that led to a method" in err


def test_wrong_arguments(run_command, path, tmp_path):
    for arguments, message in [
        (["show", path, "9"], "no run 9"),
        (["show", str(tmp_path / "none"), "1"], "does not exist"),
        (["best", path, "1", "--objective", "beauty"], "beauty"),
    ]:
        code, out, err = run_command("runs", *arguments)
        assert (code, out) == (2, "")
        assert message in err
        assert len(err.splitlines()) == 1
    (tmp_path / "notes").write_text("notes")
    code, _, err = run_command("runs", "list", str(tmp_path / "notes"))
    assert code == 2
    assert "is not an SQLite database" in err


def test_numbers_of_starts_have_all_digits(run_command, tmp_path):
    path = tmp_path / "runs.db"
    settings = cg.search(2, 2, 1, 1, store=path).settings
    with Store(path) as store:
        (entry,) = store.run(1).entries()
        rerun = store.begin("search", vars(settings) | {"seed": 2})
        rerun.append([replace(entry, number=1_234_567)])
        rerun.close()
    out = run_command("runs", "best", str(path), "2")[1]
    assert out.splitlines()[1].split()[0] == "1234567"
