"""Files of methods, their checks and representations; reference steps of the tool and the core."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from kinds import FROZEN, MUNTHE_KAAS
from refusals import refuses

import cg
from cg.construction.catalogue import dumps, dumps_json, loads, resolve_method, save
from cg.construction.diagnosis import diagnose_file
from cg.construction.points import MethodError
from cg.construction.proofs import CertificationError, certify, check
from cg.problems import StateDependentRotation

pytestmark = pytest.mark.no_core

MIDPOINT = cg.Tableau([[], ["1/2"]], [0, 1], name="mine", source="a book")


class TestFiles:
    @pytest.mark.parametrize("suffix", [".toml", ".json"])
    @pytest.mark.parametrize("name", [
        "CG2(3)", "CG5a", "CG6a", "CF5(4)", "DP5(4)", "RKMK8(5,3)", "CFM6(4)", "Magnus8(4)",
        "Leapfrog", "BlanesMoan6",
    ])  # fmt: skip
    def test_save_and_load(self, name, suffix, tmp_path):
        method = resolve_method(name)
        path = tmp_path / f"method{suffix}"
        cg.save(method, path)
        assert path.read_text(encoding="utf-8").startswith("{" if suffix == ".json" else "name")
        loaded = cg.load(str(path))
        assert loaded == method
        assert (type(loaded), hash(loaded)) == (type(method), hash(method))
        assert [c.text for c in loaded.coefficients] == [c.text for c in method.coefficients]
        assert (loaded.name, loaded.source) == (method.name, method.source)
        assert getattr(loaded, "nominal_order", 0) == getattr(method, "nominal_order", 0)

    @pytest.mark.parametrize(("text", "message"), [
        ("{", "not a JSON file"),
        ('{"name": "x"}', "lacks a, b"),
        ('{"name": "x", "a": [], "b": [NaN]}', "b_1: expected a finite real"),
        ('{"a": 1' + "0" * 5000 + "}", "not a JSON file"),
        ('{"a": ' + "[" * 100000 + "]" * 100000 + "}", "not a JSON file"),
        ('{"name": 1, "source": "", "a": [[]], "b": [1]}', "name must be a str"),
        ('{"b": [1], "b": [2]}', "'b' is there twice"),
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
        message = r"method must be .* or an existing file, got 'missing\.toml'"
        refuses(FileNotFoundError, message, resolve_method, "missing.toml")
        with pytest.raises(IsADirectoryError):
            resolve_method(tmp_path)


def test_certificate_of_a_munthe_kaas_method_is_refused():
    """It has the coefficients of its tableau but other order conditions."""
    tableau = cg.Tableau([[], ["1/2"]], [0, 1], name="X")
    refuses(CertificationError, "method must", check, cg.certify(tableau), cg.MuntheKaas(tableau))


METHOD = cg.Tableau(cg.methods["CG3(2)"].entries, cg.methods["CG3(2)"].weights, name="Mine")


@pytest.fixture(params=["mine.certificate.toml", "certificates/mine.toml"])
def certificate_path(request, tmp_path):
    path = tmp_path / str(request.param)
    path.parent.mkdir(exist_ok=True)
    certify(METHOD).save(path)
    return path


def certificate_line(run, file):
    """Return what ``show`` writes about the certificate."""
    text = run("show", str(file))[1]
    (line,) = re.findall("^certificate +(.*)$", text, re.MULTILINE)
    return str(line)


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_show_and_export_find_it(suffix, certificate_path, run_command, tmp_path):
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
    assert certificate_path.is_file()


def test_certificate_is_proved_again(certificate_path, run_command, tmp_path):
    file = tmp_path / "mine.toml"
    save(METHOD, file)
    text = certificate_path.read_text(encoding="utf-8")
    certificate_path.write_text(text.replace("order = 3", "order = 4", 1), encoding="utf-8")
    assert certificate_line(run_command, file).startswith("proves nothing: ")
    assert run_command("export", str(file), "json", "--digits", "60")[0] == 2
    assert run_command("export", str(file), "json", "--digits", "20")[0] == 0
    certificate_path.write_text("nothing", encoding="utf-8")
    assert certificate_line(run_command, file).startswith(
        f"proves nothing: {certificate_path}: not a TOML file"
    )
    assert str(certificate_path) in run_command("export", str(file), "json", "--digits", "60")[2]
    certificate_path.write_bytes(b"\xff")
    assert certificate_line(run_command, file).startswith(
        f"proves nothing: {certificate_path}: not UTF-8"
    )
    certificate_path.unlink()
    assert "certificate" not in run_command("show", str(file))[1]


@pytest.mark.parametrize("name", ["M.JSON", "M.toml", "m.TOML"])
def test_byte_order_marks_and_capital_endings(tmp_path, name):
    path, method = tmp_path / name, cg.methods["CG4a"]
    text = dumps_json(method) if "JSON" in name else dumps(method)
    path.write_text(text, encoding="utf-8-sig")
    assert resolve_method(str(path)) == resolve_method(path) == loads("\ufeff" + text) == method


def test_arrays_in_json_files_are_called_json(tmp_path):
    path = tmp_path / "m.JSON"
    path.write_text("[1, 2]")
    for read in (cg.load, diagnose_file):
        refuses(MethodError, "m.JSON: not a JSON file of this kind: an object", read, path)


TOOL = "tools/make_reference_steps"
FILE = Path(cg.construction.catalogue.__file__).parent / "reference_steps.json"
REFERENCE = json.loads(FILE.read_text(encoding="utf-8"))
METHODS = {**FROZEN, **MUNTHE_KAAS}
H = 0.25


def as_rotation(texts):
    return np.array([float(text) for text in texts]).reshape(3, 3)


def step_of(method):
    problem = StateDependentRotation()
    run = cg.integrate(problem.f, (0.0, H), problem.y0, frame=problem.frame, method=method, h=H)
    return run.y[-1]


def test_every_method_has_a_reference_step():
    """If this fails, `make catalogue` hasn't been run since a method was added."""
    assert set(REFERENCE["steps"]) == set(METHODS)
    pairs = {name for name, method in METHODS.items() if method.embedded is not None}
    assert {name for name, entry in REFERENCE["steps"].items() if "embedded" in entry} == pairs


def test_problem_equals_that_of_the_package():
    problem = REFERENCE["problem"]
    own = StateDependentRotation()
    for name in ("constant", "slope", "linear"):
        stored = np.array(problem[name]) / problem["unit"]
        np.testing.assert_array_equal(stored, getattr(own, name))
    assert problem["h"] == "1/4"


@pytest.mark.parametrize(
    "name", ["LieEuler", "CG3", "CG4a", "CG4(3)", "CF5a", "CF5(4)", "DICG3", "RKMK4", "DOP853"]
)
def test_tool_reproduces_the_steps(tool, name):
    assert tool.entry_of(METHODS[name]) == REFERENCE["steps"][name]


@pytest.mark.parametrize("name", METHODS)
def test_core_agrees_with_reference_steps(name):
    method, entry = METHODS[name], REFERENCE["steps"][name]
    # a few roundings a flow, and what they grow by
    largest = max(abs(float(weight.value)) for weight in method.coefficients)
    tolerance = 1e-15 * (4 + method.exponentials / 4) * max(1.0, largest)
    assert abs(step_of(method) - as_rotation(entry["result"])).max() < tolerance
    if method.embedded is not None:
        second = step_of(method.embedded)
        assert abs(second - as_rotation(entry["embedded"])).max() < tolerance
        assert abs(second - as_rotation(entry["result"])).max() > 100 * tolerance
