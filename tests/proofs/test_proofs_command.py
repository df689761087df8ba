"""The command that proves stored certificates."""

from dataclasses import replace

from cg.catalogue import methods
from cg.proofs import Certificate, certificate_of, certify
from cg.proofs.__main__ import main

PROVED_HERE = ["LieEuler", "CG2", "CG3", "CG2(3)", "CG4b", "CG4a", "CF5a"]


class TestCommand:
    def test_all_small_ones(self, capsys):
        assert main(["--check", *PROVED_HERE]) == 0
        out = capsys.readouterr().out
        assert "CF5a: order 5 is proved: coefficients within" in out
        assert out.splitlines()[-1] == f"{len(PROVED_HERE)} proved"

    def test_partial_proofs_are_counted_separately(self, tmp_path, capsys):
        path = tmp_path / "CG5a.toml"
        certify("CG5a").save(path)
        assert main(["--check", "CG3", str(path), "nonsense"]) == 1
        first, second, _, last = capsys.readouterr().out.splitlines()
        assert first.startswith("CG3: order 3 is proved: ")
        assert second.startswith("CG5a: order 5 is proved in part: ")
        assert last == "1 proved, 1 in part, 1 failed"

    def test_failures_have_an_exit_code(self, tmp_path, capsys):
        path = tmp_path / "CG4a.toml"
        honest = certificate_of(methods["CG4a"])
        replace(honest, order=5).save(path)
        assert main(["--check", "CG3", str(path)]) == 1
        assert f"FAILED {path}" in capsys.readouterr().out
        assert main(["--check", "CG6a"]) == 1
        assert main(["--check", "nonsense"]) == 1
        assert main(["--check", str(tmp_path / "none.toml")]) == 1

    def test_new_certificates(self, tmp_path):
        assert main(["--output", str(tmp_path), "CG4a"]) == 0
        assert Certificate.load(tmp_path / "CG4a.toml") == certificate_of(methods["CG4a"])
        assert main(["CG6a"]) == 1
