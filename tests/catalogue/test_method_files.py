"""Files of methods, their checks and representations."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.catalogue import dumps, dumps_json, loads, resolve_method, save
from cg.construction.diagnosis import diagnose_file
from cg.construction.formats.notebooks import to_formula, to_html
from cg.construction.layouts.points import MethodError
from cg.construction.proofs import CertificationError, certify, check

MIDPOINT = cg.Tableau([[], ["1/2"]], [0, 1], name="mine", source="a book")


class TestFiles:
    @pytest.mark.parametrize("suffix", [".toml", ".json"])
    @pytest.mark.parametrize("name", ["CG2(3)", "CG5a", "CG6a", "CF5(4)", "DP5(4)", "RKMK8(5,3)"])
    def test_save_and_load(self, name, suffix, tmp_path):
        method = resolve_method(name)
        path = tmp_path / f"method{suffix}"
        cg.save(method, path)
        assert path.read_text(encoding="utf-8").startswith("{" if suffix == ".json" else "name")
        loaded = cg.load(str(path))
        assert loaded == method
        assert type(loaded) is type(method)
        assert [c.text for c in loaded.coefficients] == [c.text for c in method.coefficients]
        assert (loaded.name, loaded.source) == (method.name, method.source)
        assert loaded.nominal_order == method.nominal_order

    def test_save_to_a_folder(self, tmp_path):
        cg.save(MIDPOINT, tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
        refuses(TypeError, "path must", cg.save, MIDPOINT, 3)
        refuses(TypeError, "path must", cg.load, None)

    def test_numbers_in_json_keep_their_digits(self):
        text = '{"name": "x", "source": "", "a": [[], [0.30000000000000000004]], "b": [0, 1]}'
        method = cg.construction.catalogue.loads(text)
        assert method.coefficients[0].text == "0.30000000000000000004"
        assert json.loads(cg.export(method, "json"))["a"][1] == ["0.30000000000000000004"]

    @pytest.mark.parametrize(("text", "message"), [
        ("{", "not a JSON file"),
        ('{"name": "x"}', "lacks a, b"),
        ('{"name": "x", "name": "y"}', "'name' is there twice"),
        ('{"a": NaN}', "NaN isn't a finite number"),
        ('{"a": 1' + "0" * 5000 + "}", "not a file of this kind"),
        ('{"a": ' + "[" * 50 + "]" * 50 + "}", "nested too deeply"),
        ('{"a": ' + "[" * 100000 + "]" * 100000 + "}", "nested too deeply"),
        ('{"name": 1, "source": "", "a": [[]], "b": [1]}', "name must be a str"),
    ])  # fmt: skip
    def test_bad_json(self, text, message):
        refuses(MethodError, message, cg.construction.catalogue.loads, text)


class TestPaths:
    @pytest.mark.parametrize("suffix", [".toml", ".json"])
    def test_a_path_serves_as_a_method(self, tmp_path, suffix):
        path = tmp_path / f"mine{suffix}"
        cg.save(MIDPOINT, path)
        for method in (path, str(path)):
            run = cg.integrate(
                lambda t, y: [0, 0, t], (0, 1), np.eye(3), frame=cg.frames.SO3(), method=method,
                h=0.1,
            )  # fmt: skip
            assert run.method == MIDPOINT
            assert cg.export(method, "c").startswith("// mine: order 2")

    def test_a_name_in_the_working_directory(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        cg.save(MIDPOINT, "mine.toml")
        assert resolve_method("mine.toml") == MIDPOINT
        assert "mine" not in cg.methods

    def test_bad_paths(self, tmp_path):
        (tmp_path / "broken.toml").write_text("name = 3")
        (tmp_path / "binary.toml").write_bytes(b"\xff")
        with pytest.raises(MethodError, match=r"broken.toml: the entry lacks a, b"):
            resolve_method(tmp_path / "broken.toml")
        with pytest.raises(MethodError, match=r"binary.toml: not UTF-8"):
            resolve_method(str(tmp_path / "binary.toml"))
        (tmp_path / "long.toml").write_text("#" * 10_000_001)
        with pytest.raises(
            MethodError, match=r"long.toml: a file must have at most 10000000 bytes"
        ):
            resolve_method(tmp_path / "long.toml")
        refuses(
            FileNotFoundError,
            r"missing\.toml",
            resolve_method,
            "missing.toml",
        )
        with pytest.raises(IsADirectoryError):
            resolve_method(tmp_path)

    @pytest.mark.skipif(sys.platform == "win32", reason="no pipes in folders")
    @pytest.mark.parametrize("read", [cg.load, diagnose_file, cg.Certificate.load])
    def test_devices_and_pipes(self, tmp_path, read):
        os.mkfifo(tmp_path / "pipe.toml")
        for path in (tmp_path / "pipe.toml", Path("/dev/zero")):
            refuses((MethodError, CertificationError), "not a regular file", read, path)


class TestNotebooks:
    def test_ipython_shows_them(self):
        pytest.importorskip("IPython")
        code = """if True:
            from IPython.core.interactiveshell import InteractiveShell
            shell = InteractiveShell.instance()
            import cg
            from cg.construction.formats.notebooks import to_formula, to_html
            views, _ = shell.display_formatter.format(cg.methods["CG3"])
            assert views["text/html"] == to_html(cg.methods["CG3"])
            assert views["text/latex"] == to_formula(cg.methods["CG3"])
        """
        subprocess.run([sys.executable, "-c", code], check=True)

    def test_a_tableau(self):
        html = to_html(cg.methods["CG2(3)"])
        assert "<b>CG2(3)</b>: order 3(2), 3 evaluations, 6 flows" in html
        assert html.count("<tr") == 5
        assert "119/216" in html
        formula = to_formula(cg.methods["CG2(3)"])
        assert formula.startswith(r"$\displaystyle \begin{array}{c|ccc}")
        assert r"\frac{17}{24} & \frac{119}{216} & \frac{17}{108} &  \\ \hline" in formula

    def test_points(self):
        html = to_html(cg.methods["CF4"])
        assert html.count("<tr>") == 7
        assert "1/4 F<sub>1</sub> + 1/6 F<sub>2</sub>" in html
        formula = to_formula(cg.methods["CF3"])
        expected = r"y_{3} &= \exp\bigl(h(-\frac{1}{12}\,F_{1}+\frac{3}{4}\,F_{3})\bigr)\,y_{1}"
        assert expected in formula


def test_certificate_of_a_munthe_kaas_method_is_refused():
    """It has the coefficients of its tableau but other order conditions."""
    tableau = cg.Tableau([[], ["1/2"]], [0, 1], name="X")
    refuses(CertificationError, "method must", check, cg.certify(tableau), cg.MuntheKaas(tableau))


def test_residual_of_a_method_without_order():
    still = cg.Tableau([[], ["1/2"]], [0, 0])
    assert still.largest_residual() == 1.0


METHOD = cg.Tableau(cg.methods["CG3(2)"].entries, cg.methods["CG3(2)"].weights, name="Mine")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(params=["mine.certificate.toml", "certificates/mine.toml"])
def proof(request, tmp_path):
    path = tmp_path / str(request.param)
    path.parent.mkdir(exist_ok=True)
    certify(METHOD).save(path)
    return path


def certificate_line(run_command, file):
    """Return what ``show`` writes about the certificate."""
    text = run_command("show", str(file))[1]
    (line,) = re.findall("^  certificate +(.*)$", text, re.MULTILINE)
    return str(line)


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_show_and_export_find_it(suffix, proof, run_command, tmp_path):
    file = tmp_path / f"mine{suffix}"
    save(METHOD, file)
    assert str(certify(METHOD)) in run_command("show", str(file))[1]
    assert json.loads(run_command("show", str(file), "--json")[1])["certificate"] == str(
        certify(METHOD)
    )
    code, output, _ = run_command("export", str(file), "json", "--digits", "60")
    assert code == 0
    residuals = cg.conditions.residuals(loads(output), 3, arithmetic="exact")
    assert max(map(abs, residuals)) < 1e-58
    assert proof.is_file()


def test_certificate_is_proved_again(proof, run_command, tmp_path):
    file = tmp_path / "mine.toml"
    save(METHOD, file)
    text = proof.read_text(encoding="utf-8")
    proof.write_text(text.replace("order = 3", "order = 4", 1), encoding="utf-8")
    assert certificate_line(run_command, file).startswith("proves nothing: ")
    assert run_command("export", str(file), "json", "--digits", "60")[0] == 2
    assert run_command("export", str(file), "json", "--digits", "20")[0] == 0
    proof.write_text("nothing", encoding="utf-8")
    assert certificate_line(run_command, file).startswith(
        f"proves nothing: {proof}: not a TOML file"
    )
    assert str(proof) in run_command("export", str(file), "json", "--digits", "60")[2]
    proof.write_bytes(b"\xff")
    assert certificate_line(run_command, file).startswith(f"proves nothing: {proof}: not UTF-8")
    proof.unlink()
    assert certificate_line(run_command, file) == "none"


def test_certificate_with_another_radius(run_command, tmp_path):
    file = tmp_path / "CG4a.toml"
    save(cg.methods["CG4a"], file)
    certificate = certify("CG4a")
    path = tmp_path / "CG4a.certificate.toml"
    certificate.save(path)
    assert certificate_line(run_command, file) == str(certificate)
    replace(certificate, box=replace(certificate.box, radius=Decimal("1e-60"))).save(path)
    assert certificate_line(run_command, file).startswith("proves nothing: ")


@pytest.mark.parametrize("name", ["M.JSON", "M.toml", "m.TOML"])
def test_byte_order_marks_and_capital_endings(tmp_path, name):
    path, method = tmp_path / name, cg.methods["CG4a"]
    text = dumps_json(method) if "JSON" in name else dumps(method)
    path.write_text(text, encoding="utf-8-sig")
    assert resolve_method(str(path)) == resolve_method(path) == loads("\ufeff" + text) == method


@pytest.mark.parametrize(("name", "other"), [("Verlet", "Leapfrog"), ("Yoshida6", "BlanesMoan6")])
def test_other_names_of_splitting_methods(name, other):
    with pytest.raises(ValueError, match=f"got '{name}'; {other} is"):
        resolve_method(name)
