"""Certificates stored beside files of methods."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal

import pytest

import cg
from cg.catalogue import loads, save
from cg.proofs import certify

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
