"""Names and sources from files are escaped in code, documents and terminals."""

import subprocess

import pytest

import cg
from cg.command import main
from cg.construction.catalogue import dumps
from cg.construction.formats import FORMATS

CODE = ["python", "c"]
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
