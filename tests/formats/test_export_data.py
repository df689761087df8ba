"""Exports as data and LaTeX, digits, rejected arguments, texts that are escaped."""

import json
import re
import shutil
import subprocess
from fractions import Fraction

import pytest
from refusals import refuses

import cg
from cg.command import main
from cg.construction.catalogue import dumps, loads
from cg.construction.formats import FORMATS, known_digits

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
        message = r"digits must be at most 34, .* mine .*: pass certificate=cg.certify\(method\)"
        refuses(ValueError, f"{message}; got 50", cg.export, method, "json", digits=50)
        certificate = cg.certify(method)
        text = cg.export(method, "json", digits=50, certificate=certificate)
        assert len(json.loads(text)["b"][0]) > 50
        refuses(TypeError, "certificate must", cg.export, method, "json", certificate="proof")
        for more in {"digits": 50}, {}:
            with pytest.raises(cg.CertificationError, match="it is for 'mine', not for 'CG5d'"):
                cg.export(cg.methods["CG5d"], "json", certificate=certificate, **more)


def test_rejects():
    message = r"format must be one of 'json', 'toml', .*, got 'excel'"
    refuses(ValueError, message, cg.export, "CG3", "excel")
    refuses(TypeError, "format must", cg.export, "CG3", None)
    refuses(ValueError, r"similar names are CG3", cg.export, "CG33", "c")
    for format in CODE:
        refuses(ValueError, "must be json, toml or latex for an", cg.export, "DICG4", format)
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
        text = "\n\n\\clearpage\n".join(parts)
        head = r"\documentclass{article}\usepackage{booktabs,longtable,amsmath}\begin{document}"
        (tmp_path / "all.tex").write_text(f"{head}\n{text}\n\\end{{document}}\n", encoding="utf-8")
        run = subprocess.run(
            ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "all.tex"],
            capture_output=True, text=True, check=False, cwd=tmp_path,
        )  # fmt: skip
        assert run.returncode == 0, run.stdout[-2000:]
        assert "pages" in run.stdout


TEXTS = {
    "encoding": ("M coding=raw_unicode_escape", "\\u000araise SystemExit(1)"),
    "no encoding": ("M", "Channel coding: an overview"),
    "line breaks": ("M", "one\rint x;\x0bint x;\x0cint x;\x85int x;\u2028int x;\u2029int x;"),
    "terminal": ("M\x1b]0;owned\x07", "\x9b31mred\x1b[2J\x7f\x08\x08"),
    "right to left": ("M\u202e", "\u2066 hidden \u2069 \ufeff"),
    "ends of comments": ("M */ =# ]] %} --> ''' \"\"\"", "*/ int x; /* =# #= %} %{\n%}\n%{"),
    "continued": ("M", "\\\nint x;??/\nint x;\n" + "x" * 95 + "\\ " + "x" * 93 + "??/ &"),
    "directives": ("!TeX program = sh", "$omp parallel\n#codegen\nDIR$ x\n-*- texinfo -*-\n&latex"),
    "beyond": ("M \U0001f600 \U000e0001", "\u00a0K\u00f6nig\u3000"),
}


def method_of(what):
    name, source = TEXTS[what]
    return cg.Tableau([[], ["1/2"]], [0, 1], name=name, source=source)


@pytest.mark.parametrize("format", CODE)
@pytest.mark.parametrize("what", TEXTS)
def test_texts_stay_in_comments(what, format):
    method = method_of(what)
    other = cg.Tableau(method.entries, method.weights, name=method.name)
    text = cg.export(method, format)
    mark = {"c": "// ", "python": "# "}[format]

    rest = lambda text: [line for line in text.split("\n") if not f"{line} ".startswith(mark)]
    assert rest(text) == rest(cg.export(other, format))
    assert text.replace("\n", "").replace("\u00a0", "").replace("\u3000", "").isprintable()
    comments = [line for line in text.split("\n") if line.startswith(mark)]
    assert not any(line.endswith(("\\", "??/")) for line in comments)


@pytest.mark.parametrize("what", TEXTS)
def test_c_has_no_warnings(what, tmp_path):
    (tmp_path / "m.h").write_text(cg.export(method_of(what), "c"), encoding="utf-8")
    (tmp_path / "m.c").write_text('#include "m.h"\nint main(void) { return 0; }\n')
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    subprocess.run(["gcc", *flags, "m.c"], check=True, cwd=tmp_path)


@pytest.mark.parametrize("what", TEXTS)
def test_a_terminal_gets_lines_of_text(what, tmp_path, capsys):
    file, bad = tmp_path / "mine.toml", tmp_path / "broken\x1b[2J.json"
    file.write_text(dumps(method_of(what)), encoding="utf-8")
    bad.write_text('{"name": 1, "\\u001b[2J": 2}', encoding="utf-8")
    for command in ("show", "check", "certify"):
        for path in (file, bad):
            main([command, str(path)])
            main([command, str(path), "--json"])
    for format in FORMATS:
        main(["export", str(file), format])
    captured = capsys.readouterr()
    output = captured.out + captured.err
    assert output.replace("\n", "").replace("\u00a0", "").replace("\u3000", "").isprintable()
