"""Malicious files and numbers raise clear errors soon, and no file is written elsewhere."""

import time
from dataclasses import replace
from decimal import Decimal

import pytest
from refusals import refuses

import cg
from cg.construction.catalogue import dumps, load, loads, save
from cg.construction.conditions.exact import Condition
from cg.construction.points import MethodError
from cg.construction.proofs import Certificate, CertificationError, certificate_of, check
from cg.problems import HeavyTop
from cg.support.parsing import read_fraction

pytestmark = pytest.mark.no_core

METHOD = cg.methods["CG3"]
CERTIFICATE = certificate_of(METHOD)


@pytest.fixture(autouse=True)
def ends_soon():
    begin = time.process_time()
    yield
    assert time.process_time() - begin < 10


NAMES = [
    "../outside", "/tmp/outside", "a/b", "..", ".", "", ".hidden", "back\\slash", "zero\0",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_rejects_unfit_file_names(name, tmp_path):
    refuses(ValueError, "name must", save, cg.Tableau([[], ["1/2"]], [0, 1], name=name), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["CG3", "CF4(3)", "König 5", "a.b", "order 4, 5 stages, start 3"])
def test_accepts_file_names(name, tmp_path):
    method = cg.Tableau([[], ["1/2"]], [0, 1], name=name)
    save(method, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.toml"]
    assert load(tmp_path / f"{name}.toml").name == name


HUGE = ["1e999999999", "1e-999999999", "-1E+99999999999999999999", "1e1_000_000", "9" * 5000]


@pytest.mark.parametrize("text", [*HUGE, Decimal("1e999999999"), Decimal("1e-999999")])
def test_rejects_huge_exponents(text):
    refuses(ValueError, "exponents must|Exceeds", read_fraction, text)
    with pytest.raises(ValueError, match="row 1 of a must"):
        cg.conditions.residuals([[text]], [1], 1, arithmetic="exact")
    refuses(ValueError, "b must", cg.conditions.residuals, [[0]], [text], 1, arithmetic="exact")
    refuses(cg.TableauError, "a_11: (expected a finite|Exceeds)", cg.Tableau, [[text]], [1])
    refuses(ValueError, "phi_over_pi must", HeavyTop, phi_over_pi=text)


ODD = ["1_0e-37", "\u0663e-36", "1e-36 ", "1/3", "0x1p-3"]


@pytest.mark.parametrize("text", [*HUGE, *ODD, "nan", "-1", "1/0", "1e5000", "1e-4001"])
def test_certificates_reject_numbers(text):
    written = CERTIFICATE.dumps()
    for key, value in (("radius", CERTIFICATE.radius), ("bound", CERTIFICATE.beyond.bound)):
        line = f'{key} = "{value}"'
        assert line in written
        with pytest.raises(CertificationError, match=f"{key} must be a decimal number"):
            Certificate.loads(written.replace(line, f'{key} = "{text}"'))


@pytest.mark.parametrize(("message", "changes"), [
    *(("orders must be between 1 and 9", {"order": order}) for order in (10**9, 0)),
    *(("bits must be between 53 and 16384", {"bits": bits}) for bits in (10**9, -1)),
    ("distinct independent ones", {"left_out": (Condition(0, ((),)),) * 100_000}),
    ("no independent condition", {"beyond": replace(CERTIFICATE.beyond, word=())}),
    ("distinct ones of the method", {"fixed": ("a_1,1",) * 1_000_000}),
    *(("as many movable", {"radius": Decimal(text)}) for text in ("1e-3999", "1e3999")),
])  # fmt: skip
def test_rejects_forged_certificates(message, changes):
    refuses(CertificationError, message, check, replace(CERTIFICATE, **changes), METHOD)


def test_certificates_reject_files(tmp_path):
    texts = {
        "nested": "a = " + "[" * 10_000,
        "tables": "a" + ".a" * 10_000 + " = 1",
        "inline": "a = " + "{a = " * 10_000,
        "digits": "order = " + "9" * 5000,
        "kinds": CERTIFICATE.dumps().replace("order = 3", 'order = "3"', 1),
        "latin": 'name = "\xe9"',
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="latin-1")
        refuses(CertificationError, f"{name}.toml: ", Certificate.load, tmp_path / f"{name}.toml")


@pytest.mark.parametrize("stage", ["9" * 5000, "٣", "-1", "1e3"])
def test_stage_keys_must_be_small_integers(stage):
    text = dumps(cg.methods["CF3"]).replace("{0 =", f'{{"{stage}" =', 1)
    refuses(MethodError, "weights of point 0 must", loads, text)
