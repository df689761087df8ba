"""Exports as data and LaTeX, digits, rejected arguments."""

import json
import re
import shutil
import subprocess
from fractions import Fraction

import pytest
from refusals import refuses

import cg
from cg.construction.catalogue import loads, resolve_method
from cg.construction.formats import FORMATS, known_digits
from cg.construction.formats.latex import to_formula

SOME = ["CG2(3)", "CG5a", "CG6a", "CF4", "CF5(4)", "RKMK8(5,3)", "ImplicitMidpoint"]
CODE = ["python", "c"]


class TestDigits:
    def test_stored_digits(self):
        method = cg.methods["CG5d"]
        assert known_digits(method) == 34
        assert known_digits(cg.methods["CG3"]) is None
        assert known_digits(cg.Tableau([[], [0.1]], [0.3, 0.7])) == 16
        assert known_digits(cg.Tableau([[], ["0.123456789"]], [0, 1])) == 9
        texts = [row for row in json.loads(cg.export(method, "json", digits=20))["a"] if row]
        assert max(len(x.lstrip("-0.").replace(".", "")) for row in texts for x in row) == 20

    def test_digits_from_the_certificate(self):
        method = cg.methods["CG3(2)"]
        a, b = cg.digits(method, 60)
        table = json.loads(cg.export(method, "json", digits=60))
        assert table["b"] == b
        assert [row + ["0"] * (3 - len(row)) for row in table["a"]] == a
        loaded = loads(cg.export(method, "toml", digits=200))
        residuals = cg.conditions.residuals(loaded, 3, arithmetic="exact")
        assert max(map(abs, residuals)) < Fraction(1, 10**198)
        assert loaded.order == 3

    def test_abscissae_have_all_digits(self):
        method = cg.methods["CG3(2)"]
        a, _ = cg.digits(method, 90)
        c3 = sum(map(Fraction, a[2]))
        text = cg.export(method, "c", digits=80)
        numbers = re.search(r"cg3_2_c\[3\] = \{(.*?)\};", text, re.DOTALL)[1]
        matches = re.findall(r"NUMBER\((.*?)\)", numbers)
        assert matches[1] == a[1][0]  # which the certificate holds at its stored value
        assert len(matches[2]) == 82
        assert abs(Fraction(matches[2]) - c3) < Fraction(1, 10**80)

    def test_users_certificate(self):
        method = cg.Tableau(cg.methods["CG3(2)"].entries, cg.methods["CG3(2)"].weights, name="mine")
        with pytest.raises(
            ValueError,
            match=r"digits must be at most 34, which are stored, since mine isn't in the "
            r"catalogue: pass certificate=cg.certify\(method\); got 50",
        ):
            cg.export(method, "json", digits=50)
        certificate = cg.certify(method)
        text = cg.export(method, "json", digits=50, certificate=certificate)
        assert len(json.loads(text)["b"][0]) > 50
        refuses(TypeError, "certificate must", cg.export, method, "json", certificate="proof")
        with pytest.raises(cg.CertificationError):
            cg.export(cg.methods["CG5d"], "json", digits=50, certificate=certificate)


def test_rejects():
    with pytest.raises(ValueError, match=r"format must be one of json, toml, .*, got 'excel'"):
        cg.export("CG3", "excel")
    refuses(TypeError, "format must", cg.export, "CG3", None)
    refuses(ValueError, r"similar names are CG3", cg.export, "CG33", "c")
    for format in CODE:
        with pytest.raises(ValueError, match="must be json, toml or latex for an implicit"):
            cg.export("DICG4", format)
    assert set(FORMATS) == {"json", "toml", "latex", *CODE}


class TestLatex:
    def test_a_tableau(self):
        text = cg.export("CG2(3)", "latex")
        body = text.split("\n")
        assert body[1] == r"% \usepackage{booktabs}"
        rows = [line for line in body if line.endswith(r"\\")]
        assert [row.count("&") for row in rows] == [3] * 5
        assert r"$\frac{17}{24}$ & $\frac{119}{216}$ & $\frac{17}{108}$ &  \\" in rows
        assert [line for line in body if line.endswith("rule")] == [
            r"\toprule", r"\midrule", r"\bottomrule"
        ]  # fmt: skip

    def test_points(self):
        text = cg.export("CF4", "latex")
        rows = [line.split("&") for line in text.split("\n") if line.endswith(r"\\")]
        assert [len(row) for row in rows] == [5] * (2 + 12)
        assert [row[3].strip() for row in rows[2:4]] == [r"$\frac{1}{2}$"] * 2
        assert "result" in rows[10][4]

    @pytest.mark.skipif(shutil.which("pdflatex") is None, reason="TeX isn't installed")
    def test_latex_compiles(self, tmp_path):
        parts = [cg.export(name, "latex") for name in SOME]
        parts += [cg.export(name, "latex", digits=5) for name in ("CG5d", "RKMK8(5,3)", "DICG6")]
        parts += [f"{to_formula(resolve_method(name))}\n" for name in ("CF3", "CG6a", "DICG4")]
        text = "\n\n\\clearpage\n".join(parts)
        head = r"\documentclass{article}\usepackage{booktabs,longtable,amsmath}\begin{document}"
        (tmp_path / "all.tex").write_text(f"{head}\n{text}\n\\end{{document}}\n", encoding="utf-8")
        run = subprocess.run(
            ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "all.tex"],
            capture_output=True, text=True, check=False, cwd=tmp_path,
        )  # fmt: skip
        assert run.returncode == 0, run.stdout[-2000:]
        assert "pages" in run.stdout
