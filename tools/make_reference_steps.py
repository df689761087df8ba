"""Write reference steps of all methods: ``python tools/make_reference_steps.py``.

The file has one step of each method of the catalogue in ball arithmetic, on a rotation whose
angular velocity depends on time and on the rotation. Other implementations can be tested against
it. Points, stages, exponentials and dexp⁻¹ are implemented here independently of the package.
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
from cg.construction.layouts import START
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
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


def step(method: Method) -> arb_mat:
    """Return the rotation after a step from the identity."""
    if isinstance(method, MuntheKaas):
        return _coordinates_step(method)
    return _explicit_step(method) if method.explicit else _implicit_step(method)


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


def _combined(weights: Sequence[Fraction], fields: Sequence[Vector]) -> Vector:
    h = ball(STEP)
    pairs = [(h * ball(w), v) for w, v in zip(weights, fields, strict=False) if w != 0]
    return [sum((w * v[i] for w, v in pairs), arb(0)) for i in range(3)]


def _identity() -> arb_mat:
    return arb_mat([[int(i == j) for j in range(3)] for i in range(3)])


def _times(method: Method) -> list[arb]:
    return [ball(STEP * sum(row, Fraction(0))) for row in method.exact[0]]


def _explicit_step(method: Method) -> arb_mat:
    tree, times = method.tree, _times(method)
    ends: dict[int, arb_mat] = {START: _identity()}
    fields: list[Vector] = []
    waiting = list(tree.stage_points)
    for m, point in enumerate([*tree.points, None]):
        while waiting and waiting[0] in ends:
            fields.append(field(times[len(fields)], ends[waiting.pop(0)]))
        if point is not None:
            weights = [point.weights.get(k, Fraction(0)) for k in range(len(times))]
            ends[m] = ends[point.parent] * exponential(_combined(weights, fields))
    return ends[tree.result]


def _implicit_step(method: Method) -> arb_mat:
    (a, b), times = method.exact, _times(method)
    fields = [field(t, _identity()) for t in times]

    def end(row: Sequence[Fraction]) -> arb_mat:
        y = _identity()
        for k, weight in enumerate(row):
            if weight != 0:
                y = y * exponential([(ball(STEP * weight) * x).mid() for x in fields[k]])
        return y

    def stage(i: int) -> Vector:
        return field(times[i], end(a[i]))

    _iterate(method, fields, stage)
    return end(b)


def _iterate(method: Method, fields: list[Vector], stage: Callable[[int], Vector]) -> None:
    """Solve the equations of the stages, ``stage(i) = fields[i]``, in place."""
    for _ in range(_MAX_ITERATIONS):
        before = [*fields]
        for i in range(len(fields)):
            fields[i] = [x.mid() for x in stage(i)]
        change = max(
            abs(x - y)
            for v, w in zip(before, fields, strict=True)
            for x, y in zip(v, w, strict=True)
        )
        if change < ball(_SOLVED):
            return
    raise ArithmeticError(f"{method.name}: stages don't converge")


def _coordinates_step(method: MuntheKaas) -> arb_mat:
    (a, b), times = method.exact, _times(method)
    slopes: list[Vector] = []

    def stage(i: int) -> Vector:
        sigma = _combined(a[i], slopes)
        return dexpinv(sigma, field(times[i], exponential(sigma)))

    if method.explicit:
        for i in range(len(times)):
            slopes.append(stage(i))
    else:
        slopes += [field(t, _identity()) for t in times]
        _iterate(method, slopes, stage)
    return exponential(_combined(b, slopes))


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
