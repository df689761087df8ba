"""Arguments of the reproduction that are refused before any work."""

import sys

import pytest

from cg.reproduce.main import main


@pytest.mark.parametrize(("arguments", "named"), [
    (["--seed", "-1"], "--seed"),
    (["--seed", "one"], "--seed"),
    (["--workers", "0"], "--workers"),
    (["--workers", "1.5"], "--workers"),
    (["--frequency"], "--frequency"),
    (["--minutes", "-1"], "--minutes"),
    (["--minutes", "nan"], "--minutes"),
    (["--only", "fig9.9"], "fig9.9"),
])  # fmt: skip
def test_rejects_wrong_arguments(arguments, named, capsys):
    assert main(arguments) == 2
    assert named in capsys.readouterr().err


@pytest.fixture
def no_work(monkeypatch):
    def refuse(*arguments):
        raise AssertionError("work has begun")

    monkeypatch.setattr("cg.reproduce.run.run", refuse)


@pytest.mark.usefixtures("no_work")
def test_rejects_out_that_is_a_file(tmp_path, capsys):
    path = tmp_path / "taken"
    path.write_text("mine")
    assert main(["--out", str(path)]) == 2
    assert f"{path} is not a directory" in capsys.readouterr().err
    assert main(["--out", str(path / "below")]) == 2
    assert "is not a directory" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.usefixtures("no_work")
@pytest.mark.skipif(sys.platform != "linux", reason="/proc takes no folders, not even from root")
def test_rejects_out_that_is_not_writable(capsys):
    assert main(["--out", "/proc/nothing"]) == 2
    assert "/proc/nothing is not writable" in capsys.readouterr().err
