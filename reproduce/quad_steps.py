"""Steps for the spinning top with about 34 digits.

All numbers are integers in units of 2**-114, products of which are rounded down. A rotation is a
unit quaternion, on which the flows are those on rotation matrices.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from operator import mul

from cg.construction.methods.method import Method
from cg.construction.methods.paths import paths_of
from cg.construction.methods.reference_step import take_paths, with_weights
from cg.problems import HeavyTop
from cg.support.quads import exact_midpoint, to_flint, working_precision

_BITS = 114
_ONE = 1 << _BITS

# a quaternion, scalar first, and the momentum
_Point = tuple[int, int, int, int, int, int, int]
# angular velocity in body axes, and derivative of the momentum; or both times a step size
_Field = Sequence[int]
# stages and weights of a flow
_Terms = Sequence[tuple[int, int]]


def end_point(top: HeavyTop, method: Method, steps: int) -> tuple[Fraction, ...]:
    """Return the solution at t = 1 by an explicit method with equal steps, as twelve numbers."""
    paths, f = with_weights(paths_of(method), lambda w: _fixed(w / steps)), _right_hand_side(top)
    y = _start(top)
    for _ in range(steps):
        ends, _ = take_paths(paths, y, lambda k, point, v: f(point), _combined_flow)
        y = ends[paths.result][0]
    return _rotation(*(Fraction(x, _ONE) for x in y[:4])) + tuple(Fraction(x, _ONE) for x in y[4:])


def _combined_flow(terms: _Terms, fields: Sequence[_Field], y: _Point) -> tuple[_Point, _Field]:
    if len(terms) == 1:  # much faster than a sum
        ((stage, weight),) = terms
        v: _Field = [weight * x >> _BITS for x in fields[stage]]
    else:
        columns = zip(*(fields[k] for k, _ in terms), strict=True)
        weights = [weight for _, weight in terms]
        v = [sum(map(mul, weights, column)) >> _BITS for column in columns]
    return _flow(y, v), v


def _fixed(x: Fraction) -> int:
    return round(x * _ONE)


def _start(top: HeavyTop) -> _Point:
    from cg.support.flint import arb  # without python-flint its error says what to install

    with working_precision(2 * _BITS):
        half = to_flint(top.phi_over_pi) / 2
        sine, cosine = map(exact_midpoint, arb.sin_cos_pi_fmpq(half))
    m1, m2, m3 = map(_fixed, top.y0_exact[9:])
    return _fixed(cosine), _fixed(-sine), 0, 0, m1, m2, m3


def _right_hand_side(top: HeavyTop) -> Callable[[_Point], _Field]:
    inverse1, inverse2, inverse3 = (_fixed(1 / moment) for moment in top.inertia)
    mgl, bits = _fixed(top.mgl), _BITS

    def f(y: _Point) -> _Field:
        q0, q1, q2, q3, m1, m2, m3 = y
        w1, w2, w3 = inverse1 * m1 >> bits, inverse2 * m2 >> bits, inverse3 * m3 >> bits
        up1, up2 = (q1 * q3 - q0 * q2) >> bits - 1, (q2 * q3 + q0 * q1) >> bits - 1
        return (
            w1,
            w2,
            w3,
            (m2 * w3 - m3 * w2 + mgl * up2) >> bits,
            (m3 * w1 - m1 * w3 - mgl * up1) >> bits,
            (m1 * w2 - m2 * w1) >> bits,
        )

    return f


def _flow(y: _Point, v: _Field) -> _Point:
    """Return the point to which y moves along v: q exp(v / 2), and the momentum plus its change."""
    q0, q1, q2, q3, m1, m2, m3 = y
    v1, v2, v3, change1, change2, change3 = v
    bits = _BITS
    # the series of cos and of sin(s) / s at the half angle s
    square = v1 * v1 + v2 * v2 + v3 * v3 >> bits + 2
    term = cosine = sine = _ONE
    k = 1
    while term:
        term = -(term * square >> bits) // (k * (k + 1))
        k += 2
        cosine += term
        sine += term // k
    a, b, c = sine * v1 >> bits + 1, sine * v2 >> bits + 1, sine * v3 >> bits + 1
    return (
        (q0 * cosine - q1 * a - q2 * b - q3 * c) >> bits,
        (q0 * a + q1 * cosine + q2 * c - q3 * b) >> bits,
        (q0 * b + q2 * cosine + q3 * a - q1 * c) >> bits,
        (q0 * c + q3 * cosine + q1 * b - q2 * a) >> bits,
        m1 + change1,
        m2 + change2,
        m3 + change3,
    )


def _rotation(q0: Fraction, q1: Fraction, q2: Fraction, q3: Fraction) -> tuple[Fraction, ...]:
    """Return the matrix of a quaternion, row by row."""
    return (
        q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3,
        2 * (q1 * q2 - q0 * q3),
        2 * (q1 * q3 + q0 * q2),
        2 * (q1 * q2 + q0 * q3),
        q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3,
        2 * (q2 * q3 - q0 * q1),
        2 * (q1 * q3 - q0 * q2),
        2 * (q2 * q3 + q0 * q1),
        q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3,
    )
