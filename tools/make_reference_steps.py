"""Write reference steps of all methods: ``python tools/make_reference_steps.py``.

The file has one step of each method of the catalogue in ball arithmetic, on a rotation whose
angular velocity depends on time and on the rotation. Other implementations can be tested against
it. The field, its flow and dexp⁻¹ are implemented here independently of the package.
"""

import json
import sys
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, ctx

from cg.construction.catalogue import methods
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.paths import paths_of
from cg.construction.methods.plain import take_paths, with_weights
from cg.construction.methods.splitting import Splitting
from cg.support.quads import to_ball as ball
from cg.support.quads import to_decimal

FILE = Path(__file__).parent.parent / "cg/construction/catalogue/reference_steps.json"
BITS = 512
DIGITS = 30
STEP = Fraction(1, 4)
UNIT = 4
CONSTANT = (2, -3, 1)
SLOPE = (-2, 3, 4)
LINEAR = (
    (3, -1, 2, -2, 1, 4, 1, -3, 2),
    (-1, 4, 1, 3, -2, -1, 2, 2, -4),
    (2, 1, -3, 1, 3, -2, -4, 1, 2),
)
_MAX_ITERATIONS = 2000
_SOLVED = Fraction(1, 2**400)

ONE = arb_mat([[int(i == j) for j in range(3)] for i in range(3)])

Vector = list[arb]


def main() -> int:
    """Write the file."""
    steps = {
        method.name: entry_of(method)
        for method in methods.values()
        if not isinstance(method, MagnusMethod | Splitting)
    }
    problem = {
        "equation": "y' = y hat(v), y a rotation, hat(v) x = v × x",
        "v": "v_i = (constant_i + slope_i t + sum_j linear_ij vec(y)_j) / unit",
        "vec": "the nine entries of y, row by row",
        "constant": CONSTANT,
        "slope": SLOPE,
        "linear": LINEAR,
        "unit": UNIT,
        "t": "0",
        "y": ["1", "0", "0", "0", "1", "0", "0", "0", "1"],
        "h": str(STEP),
    }
    lines = ",\n".join(f"    {json.dumps(name)}: {json.dumps(e)}" for name, e in steps.items())
    text = f'{{\n  "problem": {json.dumps(problem)},\n  "steps": {{\n{lines}\n  }}\n}}\n'
    FILE.write_text(text, encoding="utf-8")
    return 0


def entry_of(method: Method) -> dict[str, list[str]]:
    """Return the results of a step, row by row: ``result``, and ``embedded`` of a pair."""
    with ctx.workprec(BITS):
        entry = {"result": _digits(step(method))}
        if method.embedded is not None:
            entry["embedded"] = _digits(step(method.embedded))
    return entry


def step(method: Method) -> Any:
    """Return the rotation after a step from the identity."""
    paths = with_weights(paths_of(method), lambda weight: ball(STEP * weight))
    times = [ball(STEP * c) for c in paths.c]
    start = [field(t, ONE) for t in times]
    if isinstance(method, MuntheKaas) and not method.explicit:
        return _collocation_step(method, times, start)

    def value(k: int, y: arb_mat, u: Vector | None) -> Vector:
        v = field(times[k], y)
        return v if u is None or not paths.series else dexpinv(u, v)

    def flow(terms: Any, values: Sequence[Vector], y: arb_mat) -> tuple[arb_mat, Vector]:
        u = [sum((w * values[k][i] for k, w in terms), arb(0)) for i in range(3)]
        return y * exponential(u), u

    def stages(values: list[Vector]) -> list[Vector]:
        ends, _ = take_paths(paths, ONE, value, flow, values)
        return [value(k, *ends[path]) for k, path in enumerate(paths.stages)]

    values = [] if method.explicit else _solved(stages, start)
    return take_paths(paths, ONE, value, flow, values)[0][paths.result][0]


def _collocation_step(method: MuntheKaas, times: list[arb], start: list[Vector]) -> arb_mat:
    """Return the step of an implicit method on the algebra."""
    a, b = method.exact

    def end(row: Sequence[Fraction], slopes: list[Vector]) -> Vector:
        weights = [ball(STEP * weight) for weight in row]
        return [
            sum((w * v[i] for w, v in zip(weights, slopes, strict=True)), arb(0)) for i in range(3)
        ]

    def stages(slopes: list[Vector]) -> list[Vector]:
        ends = [end(row, slopes) for row in a]
        return [dexpinv(u, field(t, exponential(u))) for t, u in zip(times, ends, strict=True)]

    return exponential(end(b, _solved(stages, start)))


def _solved(stages: Callable[[list[Vector]], list[Vector]], values: list[Vector]) -> list[Vector]:
    """Return values at stages that are those of the points they lead to."""
    for _ in range(_MAX_ITERATIONS):
        before, values = values, [[x.mid() for x in v] for v in stages(values)]
        change = max(
            abs(x - y)
            for v, w in zip(before, values, strict=True)
            for x, y in zip(v, w, strict=True)
        )
        if change < ball(_SOLVED):
            return values
    raise ArithmeticError("the stages don't converge")


def field(t: arb, y: arb_mat) -> Vector:
    """Return the angular velocity."""
    entries = [*y.entries()]
    return [
        (c + s * t + sum((a * x for a, x in zip(row, entries, strict=True)), arb(0))) / UNIT
        for c, s, row in zip(CONSTANT, SLOPE, LINEAR, strict=True)
    ]


def exponential(v: Sequence[arb]) -> arb_mat:
    """Return the exponential of the skew matrix of v."""
    x, y, z = v
    return arb_mat([[0, -z, y], [z, 0, -x], [-y, x, 0]]).exp()


def dexpinv(sigma: Vector, v: Vector) -> Vector:
    """Return σ' where ``y = exp(hat σ)`` moves by ``y' = y hat(v)``.

    It is ``v + σ×v/2 + (1 - (θ/2) cot(θ/2)) σ×(σ×v) / θ²`` with θ = |σ|.
    """
    first = _cross(sigma, v)
    second = _cross(sigma, first)
    if all(x == 0 for x in sigma):
        return v
    square = sum((x * x for x in sigma), arb(0))
    half = square.sqrt() / 2
    factor = (1 - half * half.cot()) / square
    return [x + y / 2 + factor * z for x, y, z in zip(v, first, second, strict=True)]


def _cross(x: Vector, y: Vector) -> Vector:
    return [x[i] * y[j] - x[j] * y[i] for i, j in ((1, 2), (2, 0), (0, 1))]


def _digits(y: arb_mat) -> list[str]:
    return [_rounded(x) for x in y.entries()]


def _rounded(x: arb) -> str:
    """Return the digits to which both ends of a ball round."""
    exact = partial(_exact, x)
    low, high = (to_decimal(exact(end), DIGITS) for end in ("lower", "upper"))
    if low != high:
        raise ArithmeticError(f"{x} doesn't tell {DIGITS} digits")
    return low


def _exact(x: arb, end: Any) -> Fraction:
    mantissa, exponent = getattr(x, end)().man_exp()
    return int(mantissa) * Fraction(2) ** int(exponent)


if __name__ == "__main__":
    sys.exit(main())
