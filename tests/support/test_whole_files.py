"""Files are replaced atomically: after a failure the old file is unchanged."""

import os
import stat

import pytest
from refusals import refuses

import cg
from cg.command import main
from cg.construction.catalogue import save, summary
from cg.construction.proofs import certificate_of
from cg.support import parsing

METHOD = cg.methods["CG3"]
WRITERS = {
    "save": lambda path: save(METHOD, path),
    "certificate": lambda path: certificate_of(METHOD).save(path),
    "summaries": summary.write_summaries,
}
COMMANDS = {
    "export": ["export", "CG3", "c"],
    "certify": ["certify", "CG3"],
    "construct": ["construct", "--order", "2", "--stages", "2", "-q"],
}


@pytest.fixture
def old_file(tmp_path):
    file = tmp_path / "file.toml"
    file.write_text("old", encoding="utf-8")
    return file


@pytest.fixture
def full_disk(monkeypatch):
    def fail(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("what", WRITERS)
def test_a_full_disk_leaves_the_old_file(what, old_file, monkeypatch):
    monkeypatch.setattr(summary, "compute_summary", summary.summary_of)  # stored ones are faster
    refuses(OSError, "No space left", WRITERS[what], old_file)
    assert old_file.read_text(encoding="utf-8") == "old"
    assert os.listdir(old_file.parent) == [old_file.name]


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("what", COMMANDS)
def test_commands_leave_the_old_file(what, old_file, capsys):
    assert main([*COMMANDS[what], "-o", str(old_file)]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert old_file.read_text(encoding="utf-8") == "old"
    assert os.listdir(old_file.parent) == [old_file.name]


def test_encoding_errors_leave_the_old_file(old_file):
    refuses(ValueError, "surrogates not allowed", parsing.write_file, old_file, "\ud800")
    assert old_file.read_text(encoding="utf-8") == "old"


@pytest.mark.skipif(os.name == "nt", reason="modes and links are those of POSIX")
def test_modes_and_links_stay(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    before = os.umask(0o027)
    try:
        parsing.write_file(file, "one")
    finally:
        os.umask(before)
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    file.chmod(0o604)
    link.symlink_to(file)
    parsing.write_file(link, "two")
    assert link.is_symlink()
    assert file.read_text(encoding="utf-8") == "two"
    assert stat.S_IMODE(file.stat().st_mode) == 0o604
