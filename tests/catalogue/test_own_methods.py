"""Files of methods, and folders of the user's own."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cg
from cg.catalogue import dumps, own_folders
from cg.command import main
from cg.proofs import CertificationError, certificate_of, check, proved
from cg.structure.points import MethodError

pytestmark = pytest.mark.no_core

MIDPOINT = cg.Tableau([[], ["1/2"]], [0, 1], name="mine", source="a book")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CG_METHODS", str(tmp_path))
    return tmp_path


class TestFiles:
    @pytest.mark.parametrize("suffix", [".toml", ".json"])
    @pytest.mark.parametrize("name", ["CG2(3)", "CG5a", "CG6a", "CF5(4)", "DP5(4)", "RKMK8(5,3)"])
    def test_what_is_saved_is_loaded(self, name, suffix, tmp_path):
        method = cg.catalogue.resolve_method(name)
        path = tmp_path / f"method{suffix}"
        method.save(path)
        assert path.read_text(encoding="utf-8").startswith("{" if suffix == ".json" else "name")
        found = type(method).load(path)
        assert found == method
        assert type(found) is type(method)
        assert [c.text for c in found.coefficients] == [c.text for c in method.coefficients]
        assert (found.name, found.source) == (method.name, method.source)
        assert found.nominal_order == method.nominal_order
        assert cg.Method.load(str(path)) == method

    def test_another_kind_is_refused(self, tmp_path):
        MIDPOINT.save(tmp_path)
        path = tmp_path / "mine.toml"
        with pytest.raises(MethodError, match=r"mine.toml: it holds a Tableau, not a Commutator"):
            cg.CommutatorFree.load(path)
        assert cg.Tableau.load(path) == MIDPOINT

    def test_a_folder_gets_a_file_of_the_name(self, tmp_path):
        MIDPOINT.save(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
        with pytest.raises(TypeError, match="path must be a path, got 3"):
            MIDPOINT.save(3)
        with pytest.raises(TypeError, match="path must be a path, got None"):
            cg.Tableau.load(None)

    def test_numbers_in_json_keep_their_digits(self):
        text = '{"name": "x", "source": "", "a": [[], [0.30000000000000000004]], "b": [0, 1]}'
        method = cg.catalogue.loads(text)
        assert method.coefficients[0].text == "0.30000000000000000004"
        assert json.loads(cg.export(method, "json"))["a"][1] == ["0.30000000000000000004"]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("{", "not a JSON file"),
            ('{"name": "x"}', "lacks a, b, source"),
            ('{"name": "x", "name": "y"}', "'name' is there twice"),
            ('{"a": NaN}', "NaN is no number"),
            ('{"a": 1' + "0" * 5000 + "}", "not a file of this kind"),
            ('{"a": ' + "[" * 50 + "]" * 50 + "}", "nested too deeply"),
            ('{"a": ' + "[" * 100000 + "]" * 100000 + "}", "nested too deeply"),
            ('{"name": 1, "source": "", "a": [[]], "b": [1]}', "name must be a str"),
        ],
    )
    def test_what_is_no_method_in_json(self, text, message):
        with pytest.raises(MethodError, match=message):
            cg.catalogue.loads(text)


class TestFolders:
    def test_methods_appear_by_name(self, folder):
        MIDPOINT.save(folder)
        (folder / "other.json").write_text(
            cg.Tableau([[], [1]], ["1/2", "1/2"], name="Heun of mine").export("json")
        )
        assert list(cg.methods)[-2:] == ["mine", "Heun of mine"]
        assert len(cg.methods) == len(cg.catalogue.packaged) + 2
        assert cg.methods["mine"] == MIDPOINT
        assert "Heun of mine" in cg.methods
        assert "mine" in repr(cg.methods)
        run = cg.integrate(
            lambda t, y: [0, 0, t], (0, 1), np.eye(3), frame=cg.frames.SO3(), method="mine", h=0.1
        )
        assert run.method == MIDPOINT
        assert cg.export("Heun of mine", "c").startswith("// Heun of mine: order 2")

    def test_files_that_change_are_read_again(self, folder):
        assert "mine" not in cg.methods
        MIDPOINT.save(folder)
        assert cg.methods["mine"] is cg.methods["mine"]
        other = cg.Tableau([[], ["0.5000"]], [0, 1], name="mine", source="another book")
        other.save(folder)
        assert cg.methods["mine"].source == "another book"
        (folder / "mine.toml").unlink()
        assert "mine" not in cg.methods
        with pytest.raises(KeyError, match="no method is named 'mine'"):
            cg.methods["mine"]

    def test_broken_files_are_left_out_with_one_warning(self, folder):
        (folder / "broken.toml").write_text("name = 3")
        MIDPOINT.save(folder)
        with pytest.warns(UserWarning, match=r"left out of cg.methods: .*broken.toml: .* lacks"):
            assert "mine" in cg.methods
        assert list(cg.methods)[-1] == "mine"  # without another warning
        with pytest.raises(MethodError, match=r"broken.toml: the entry lacks a, b, source"):
            cg.methods["broken"]
        with pytest.raises(ValueError, match=r"method 'broken' can't be used: .*lacks a, b"):
            cg.catalogue.resolve_method("broken")
        assert cg.methods["CG3"].order == 3

    @pytest.mark.parametrize("taken", ["CG3", "RKMK4"])
    def test_names_of_the_package_are_taken(self, folder, taken):
        (folder / "x.toml").write_text(dumps(MIDPOINT).replace('"mine"', f'"{taken}"'))
        with pytest.warns(UserWarning, match=f"has a method named '{taken}'; choose another"):
            assert list(cg.methods) == list(cg.catalogue.packaged)
        assert cg.catalogue.resolve_method(taken) != MIDPOINT

    def test_names_that_two_files_have_and_names_that_are_none(self, folder):
        MIDPOINT.save(folder / "a.toml")
        MIDPOINT.save(folder / "b.json")
        (folder / "c.toml").write_text(dumps(MIDPOINT).replace('"mine"', '" "'))
        with pytest.warns(UserWarning, match="left out") as caught:
            assert cg.methods["mine"] == MIDPOINT
        messages = sorted(str(warning.message) for warning in caught)
        assert len(messages) == 2
        assert messages[0].endswith("b.json: another file has a method named 'mine'")
        assert messages[1].endswith("c.toml: the method has no name")

    def test_several_folders_and_ones_that_are_not_there(self, tmp_path, monkeypatch):
        first, second = tmp_path / "1", tmp_path / "2"
        second.mkdir()
        MIDPOINT.save(second)
        monkeypatch.setenv("CG_METHODS", f"{first}{os.pathsep}{second}")
        assert own_folders() == (first, second)
        assert cg.methods["mine"] == MIDPOINT
        monkeypatch.setenv("CG_METHODS", "")
        assert own_folders() == ()
        assert "mine" not in cg.methods

    def test_the_usual_folder(self, tmp_path, monkeypatch):
        monkeypatch.delenv("CG_METHODS")
        monkeypatch.setenv("HOME", str(tmp_path))
        monkeypatch.setenv("APPDATA", str(tmp_path / "data"))
        monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
        places = {
            "linux": tmp_path / "config",
            "darwin": tmp_path / "Library" / "Application Support",
            "win32": tmp_path / "data",
        }
        for system, place in places.items():
            monkeypatch.setattr(sys, "platform", system)
            assert own_folders() == (place / "crouch-grossman" / "methods",)
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.setenv("XDG_CONFIG_HOME", "relative")  # which the specification ignores
        assert own_folders() == (tmp_path / ".config" / "crouch-grossman" / "methods",)
        monkeypatch.setattr(Path, "home", _nobody)
        assert own_folders() == ()

    def test_what_is_broken_breaks_no_import(self, folder):
        (folder / "broken.toml").write_bytes(b"\xff")
        (folder / "folder.toml").mkdir()
        code = "import cg; cg.methods['CG3'].order; cg.Tableau"
        run = subprocess.run(
            [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
        )
        assert (run.returncode, run.stderr) == (0, "")
        with pytest.warns(UserWarning, match="left out") as caught:
            assert len(cg.methods) == len(cg.catalogue.packaged)
        assert len(caught) == 2


def _nobody():
    raise RuntimeError("could not determine home directory")


class TestNotebooks:
    def test_a_tableau(self):
        html = cg.methods["CG2(3)"]._repr_html_()
        assert "<b>CG2(3)</b>: order 3(2), 3 evaluations, 6 flows" in html
        assert html.count("<tr") == 5
        assert "119/216" in html
        formula = cg.methods["CG2(3)"]._repr_latex_()
        assert formula.startswith(r"$\displaystyle \begin{array}{c|ccc}")
        assert r"\frac{17}{24} & \frac{119}{216} & \frac{17}{108} &  \\ \hline" in formula

    def test_points(self):
        html = cg.methods["CF4"]._repr_html_()
        assert html.count("<tr>") == 7
        assert "1/4 F<sub>1</sub> + 1/6 F<sub>2</sub>" in html
        formula = cg.methods["CF3"]._repr_latex_()
        wanted = r"y_{3} &= \exp\bigl(h(-\frac{1}{12}\,F_{1}+\frac{3}{4}\,F_{3})\bigr)\,y_{1}"
        assert wanted in formula

    def test_names_are_escaped(self):
        method = cg.Tableau([[]], [1], name="<b>&", source="<i>")
        html = method._repr_html_()
        assert "&lt;b&gt;&amp;" in html
        assert "<i>" not in html

    def test_large_methods_are_cut(self):
        assert (
            "more</td>" in cg.methods["CF7a"]._repr_html_() or len(cg.methods["CF7a"].points) < 40
        )
        assert "0.0000" not in cg.methods["CG5d"]._repr_html_()


def test_what_a_method_says_of_itself():
    assert repr(cg.methods["CG4(3)b"]) == "<Tableau CG4(3)b: order 4(3), 5 evaluations, 15 flows>"
    assert repr(cg.methods["LieEuler"]) == "<Tableau LieEuler: order 1, 1 evaluation, 1 flow>"
    assert repr(cg.methods["ImplicitMidpoint"]).endswith("2 flows, implicit>")
    assert repr(cg.methods["CG6a"]).startswith("<Tableau CG6a: order 6 (nominal), 16 eval")
    large = cg.Tableau([["1/3"] * k for k in range(30)], ["1/30"] * 30)
    assert repr(large) == "<Tableau without name: 30 evaluations, 59 flows>"
    assert large.description(complete=True).startswith("order ")
    assert repr(large).startswith("<Tableau without name: order ")


class TestCertificatesOfOnesOwn:
    """What ``show`` tells of them is proved, not read."""

    def shown(self, capsys):
        assert main(["show", "mine"]) == 0
        (line,) = re.findall("^  certificate +(.*)$", capsys.readouterr().out, re.MULTILINE)
        return line

    def test_one_that_holds(self, folder, capsys):
        MIDPOINT.save(folder)
        assert self.shown(capsys) == "none"
        cg.certify(MIDPOINT).save(folder / "mine.certificate.toml")
        assert self.shown(capsys).startswith("mine: order 2 by its rational coefficients")
        assert proved(cg.methods["mine"]) == "whole"

    def test_one_of_other_coefficients(self, folder, capsys):
        cg.certify(MIDPOINT).save(folder / "mine.certificate.toml")
        cg.Tableau([[], ["1/3"]], [0, 1], name="mine").save(folder)
        assert self.shown(capsys).startswith("proves nothing: ")

    def test_a_radius_that_was_not_proved(self, folder, capsys):
        method = cg.methods["CG4a"]
        cg.Tableau(*texts(method), name="mine", source="x").save(folder)
        proof = replace(cg.certify("CG4a"), name="mine", radius="1e-60")
        proof.save(folder / "mine.certificate.toml")
        assert self.shown(capsys).startswith("proves nothing: ")
        assert proved(cg.methods["mine"]) == "no"

    def test_a_file_that_is_no_text(self, folder):
        MIDPOINT.save(folder)
        (folder / "mine.certificate.toml").write_bytes(b"\xff\xfe")
        with pytest.raises(CertificationError, match=r"mine\.certificate\.toml: not UTF-8"):
            certificate_of(cg.methods["mine"])


def texts(method):
    coefficients = iter(method.coefficients)
    a = [[next(coefficients).text for _ in range(i)] for i in range(method.stages)]
    return a, [next(coefficients).text for _ in range(method.stages)]


def test_no_certificate_is_one_of_a_munthe_kaas_method():
    """Coefficients are the same, conditions aren't."""
    tableau = cg.Tableau([[], ["1/2"]], [0, 1], name="X")
    with pytest.raises(CertificationError, match="method must be a Tableau or CommutatorFree"):
        check(cg.certify(tableau), cg.MuntheKaas(tableau))


@pytest.mark.parametrize("radius", ["1_0e-37", "\u0663e-36", "1e-36 ", "1/3", "0x1p-3", "nan"])
def test_a_radius_is_a_plain_decimal(radius):
    with pytest.raises(CertificationError, match="expected a decimal number"):
        replace(cg.certify("CF4"), radius=radius)


@pytest.mark.parametrize("bits", ["320", 320.0, True, None])
def test_bits_are_an_integer(bits):
    with pytest.raises(CertificationError, match="bits must be an integer, got"):
        replace(cg.certify("CF4"), bits=bits)


def test_pipes_in_a_folder_are_no_methods(folder):
    MIDPOINT.save(folder)
    os.mkfifo(folder / "pipe.toml")
    assert list(cg.methods.own) == ["mine"]


def test_orders_of_errors():
    method = cg.methods["CF4"]
    with pytest.raises(ValueError, match=r"order must be .* 8.*, got 9"):
        method.principal_error(9)
    still = cg.Tableau([[], ["1/2"]], [0, 0])
    assert still.largest_residual() == 1.0
