from fractions import Fraction

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from cg import _core_r128
from cg.construction.layouts import Layout, Rows
from cg.support.quads import decode, encode, from_float, to_decimal, to_float

MAX_QUAD = Fraction(2) ** 16384 - Fraction(2) ** 16271

patterns = st.builds(
    lambda sign, biased, fraction: sign << 127 | biased << 112 | fraction,
    st.integers(0, 1),
    st.one_of(st.integers(0, 0x7FFE), st.sampled_from([0, 1, 0x3FFF, 0x7FFE])),
    st.one_of(st.integers(0, 2**112 - 1), st.sampled_from([0, 1, 2**111, 2**112 - 1])),
)


def quads(*bits):
    data = b"".join(pattern.to_bytes(16, "little") for pattern in bits)
    return np.frombuffer(data, dtype=np.int8).reshape(-1, 16)


def through_fortran(bits):
    """Return a_11 through the compiled core, the derivative of Φ([[τ]]) = a_11 b_1 by b_1."""
    order, tree, owner = 2, np.array([4], np.intc), np.zeros(1, np.intc)
    x = np.concatenate([bits, bits])
    jac = _core_r128.jacobian(order, Layout.tableau(1, Rows.DIAGONAL).code, x.T, tree, owner=owner)
    return np.ascontiguousarray(jac.T[1])


@given(patterns)
def test_bits_survive_python(pattern):
    assume(pattern != 1 << 127)  # a Fraction has no signed zero
    bits = quads(pattern)
    np.testing.assert_array_equal(encode(decode(bits)), bits)


@given(patterns)
def test_bits_survive_fortran(pattern):
    assume(pattern != 1 << 127)  # it is added to zero
    bits = quads(pattern)
    np.testing.assert_array_equal(through_fortran(bits), bits)


@given(st.fractions(), st.integers(-16500, 16000))
def test_encoding_rounds_to_nearest(value, exponent):
    value *= Fraction(2) ** exponent
    assume(abs(value) <= MAX_QUAD)
    bits = encode([value])
    error = abs(decode(bits)[0] - value)
    pattern = int.from_bytes(bits.tobytes(), "little") & ~(1 << 127)
    neighbours = [p for p in (pattern - 1, pattern + 1) if 0 <= p < 0x7FFF << 112]
    assert all(error <= abs(x - abs(value)) for x in decode(quads(*neighbours)))


def test_strings_and_numbers_are_read_exactly():
    actual = decode(encode(["0.5", "119/128", 3, -0.25, Fraction(1, 4)]))
    assert actual == [Fraction(1, 2), Fraction(119, 128), 3, Fraction(-1, 4), Fraction(1, 4)]
    third = decode(encode(["1/3"]))[0]
    assert 0 < abs(third - Fraction(1, 3)) <= Fraction(1, 2**115)
    assert encode([]).shape == (0, 16)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5))
def test_doubles_widen_exactly(values):
    array = np.array(values, dtype=np.float64)
    bits = from_float(array)
    assert bits.shape == (len(values), 16)
    assert decode(bits) == [Fraction(v) for v in values]
    back = to_float(bits)
    assert back.tobytes() == array.tobytes()  # signed zeros and subnormals included


@given(st.fractions(), st.integers(-1100, 900))
def test_narrowing_rounds_to_nearest(value, exponent):
    value *= Fraction(2) ** exponent
    assume(abs(value) < 2.0**1000)
    bits = encode([value])
    assert to_float(bits)[0] == float(decode(bits)[0])


@given(st.fractions(), st.integers(1, 40))
def test_decimals_are_rounded_correctly(value, digits):
    text = to_decimal(value, digits)
    significant = text.partition("e")[0].lstrip("-").replace(".", "").lstrip("0")
    assert len(significant.rstrip("0")) <= digits
    if value:
        assert abs(Fraction(text) - value) <= abs(value) * Fraction(5, 10**digits)
