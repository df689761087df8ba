"""Readers of damaged files return an object or raise their own error.

The environment variable ``CG_FUZZ`` multiplies the number of examples.
"""

import os

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import cg
from cg.construction.catalogue import dumps
from cg.construction.proofs import Certificate, CertificationError, certificate_of

MANY = int(os.environ.get("CG_FUZZ", "1"))
METHODS = [
    dumps(cg.methods[name]) for name in ("CG3", "CG4(3)", "CF4", "CF3b", "DICG3(2)", "CF4(3)")
]
METHODS.append(dumps(cg.methods["RKMK5(4)"]))
CERTIFICATES = [certificate_of(cg.methods[name]).dumps() for name in ("CG3", "CG4(3)", "CF4b")]

NASTY = [
    "1e999999999", "-1e-999999999", "nan", "inf", "-0.0", "9" * 5000, "0x10", "1/0", "٣", "1_0",
    '"1/0"', '"1e999999999"', '"nan"', '"-"', '""', '"\\u0000"', '"[[]"', '"' + "[" * 3000 + '"',
    "true", "[]", "[[]]", "{}", "{a = 1}", "[" * 400, "1979-05-27T07:32:00Z", "'", '"""', "\x00",
]  # fmt: skip
WORDS = st.sampled_from(NASTY) | st.text(max_size=8)


@st.composite
def spoilt(draw, texts):
    """Draw a text in which a few lines or characters are replaced, removed or repeated."""
    text = draw(st.sampled_from(texts))
    for _ in range(draw(st.integers(1, 3))):
        lines = text.split("\n")
        k = draw(st.integers(0, len(lines) - 1))
        how = draw(st.sampled_from(["value", "line", "twice", "cut", "characters", "key"]))
        if how == "value":
            key, equals, _ = lines[k].partition("=")
            lines[k] = f"{key}{equals} {draw(WORDS)}" if equals else draw(WORDS)
        elif how == "line":
            del lines[k]
        elif how == "twice":
            lines.insert(draw(st.integers(0, len(lines))), lines[k])
        elif how == "cut":
            lines = lines[:k]
        elif how == "key":
            lines.insert(k, f"{draw(st.sampled_from(KEYS))} = {draw(WORDS)}")
        else:
            at = draw(st.integers(0, len(lines[k])))
            end = draw(st.integers(at, len(lines[k])))
            lines[k] = lines[k][:at] + draw(WORDS) + lines[k][end:]
        text = "\n".join(lines)
    return text


KEYS = ["a", "b", "name", "order", "points", "kind", "b_embedded", "nominal", "embedded", "beyond"]


def reads(reader, text, error):
    """Return the result of a reader, or None if it raises its own error with a message."""
    message = ""
    try:
        return reader(text)
    except error as caught:
        message = str(caught)
    assert message
    return None


@settings(max_examples=150 * MANY)
@given(spoilt(CERTIFICATES) | st.text(max_size=60))
@example(CERTIFICATES[1].replace("[embedded]\norder = 3", '[embedded]\norder = "3"'))
@example(CERTIFICATES[1].replace("[embedded]\norder = 3", "[embedded]"))
def test_certificates(text):
    certificate = reads(Certificate.loads, text, CertificationError)
    if certificate is not None:
        assert Certificate.loads(certificate.dumps()) == certificate
        assert isinstance(certificate.order, int)
        assert certificate.embedded_order is None or type(certificate.embedded_order) is int
        assert (certificate.embedded_beyond is None) == (certificate.embedded_order is None)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    path = tmp_path_factory.mktemp("store") / "runs.jsonl"
    cg.search(3, 3, 4, seed=5, store=path)
    return path.read_bytes()


@settings(max_examples=40 * MANY)
@given(st.data())
def test_stores(filled, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("spoilt") / "runs.jsonl"
    content = bytearray(filled)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        patch = data.draw(st.binary(min_size=1, max_size=64))
        content[at : at + len(patch)] = patch
    path.write_bytes(content[: data.draw(st.integers(1, len(content)))])
    whole = cg.search(3, 3, 4, seed=5)
    result = reads(
        lambda store: cg.search(3, 3, 4, seed=5, store=store), path, (ValueError, OSError)
    )
    assert result is None or result == whole
