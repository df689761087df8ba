"""Write reference steps of all methods: ``python tools/make_reference_steps.py``.

The file has one step of each method of the catalogue in ball arithmetic, on a rotation whose
angular velocity depends on time and on the rotation. Other implementations can be tested against
it. The field, its flow and dexp⁻¹ are implemented here independently of the package.
"""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, ctx

from cg.construction.catalogue import methods
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.paths import paths_of
from cg.construction.methods.reference_step import take_paths, with_weights
from cg.construction.methods.splitting import Splitting
from cg.support.quads import exact_midpoint, to_decimal
from cg.support.quads import to_ball as ball

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
    pair = {"result": method, "embedded": method.embedded}
    with ctx.workprec(BITS):
        return {
            name: [_rounded(x) for x in step(one).entries()]
            for name, one in pair.items()
            if one is not None
        }


def step(method: Method) -> arb_mat:
    """Return the rotation after a step from the identity."""
    paths = with_weights(paths_of(method), lambda weight: ball(STEP * weight))
    times = [ball(STEP * c) for c in paths.c]
    start = [field(t, ONE) for t in times]

    def combined(weights: Iterable[arb], values: Iterable[arb_mat]) -> arb_mat:
        return sum((v * w for w, v in zip(weights, values, strict=True)), 0 * ONE)

    if isinstance(method, MuntheKaas) and not method.explicit:  # stages on the algebra
        *a, b = ([ball(STEP * x) for x in row] for row in (*method.exact[0], method.exact[1]))

        def slopes(values: list[arb_mat]) -> list[arb_mat]:
            ends = [combined(row, values) for row in a]
            return [dexpinv(u, field(t, u.exp())) for t, u in zip(times, ends, strict=True)]

        return combined(b, _solved(slopes, start)).exp()

    def value(k: int, y: arb_mat, u: arb_mat | None) -> arb_mat:
        v = field(times[k], y)
        return v if u is None or not paths.series else dexpinv(u, v)

    def flow(terms: Any, values: Sequence[arb_mat], y: arb_mat) -> tuple[arb_mat, arb_mat]:
        u = combined((w for _, w in terms), (values[k] for k, _ in terms))
        return y * u.exp(), u

    def stages(values: list[arb_mat]) -> list[arb_mat]:
        ends, _ = take_paths(paths, ONE, value, flow, values)
        return [value(k, *ends[path]) for k, path in enumerate(paths.stages)]

    values = [] if method.explicit else _solved(stages, start)
    return take_paths(paths, ONE, value, flow, values)[0][paths.result][0]


def _solved(
    stages: Callable[[list[arb_mat]], list[arb_mat]], values: list[arb_mat]
) -> list[arb_mat]:
    """Return values at stages that are those of the points they lead to."""
    for _ in range(_MAX_ITERATIONS):
        before, values = values, [v.mid() for v in stages(values)]
        changes = [v - w for v, w in zip(values, before, strict=True)]
        if max(abs(x) for change in changes for x in change.entries()) < ball(_SOLVED):
            return values
    raise ArithmeticError("the stages don't converge")


def field(t: arb, y: arb_mat) -> arb_mat:
    """Return the matrix of the angular velocity."""
    entries = [*y.entries()]
    v1, v2, v3 = (
        (c + s * t + sum((a * x for a, x in zip(row, entries, strict=True)), arb(0))) / UNIT
        for c, s, row in zip(CONSTANT, SLOPE, LINEAR, strict=True)
    )
    return arb_mat([[0, -v3, v2], [v3, 0, -v1], [-v2, v1, 0]])


def dexpinv(u: arb_mat, v: arb_mat) -> arb_mat:
    """Return u' where ``y = exp(u)`` moves by ``y' = y v``.

    It is ``v + [u, v]/2 + (1 - (θ/2) cot(θ/2)) [u, [u, v]] / θ²``, ``θ² = -tr(u²) / 2``.
    """
    first = u * v - v * u
    square = -(u * u).trace() / 2
    if square == 0:
        return v
    half = square.sqrt() / 2
    return v + first / 2 + (u * first - first * u) * ((1 - half * half.cot()) / square)


def _rounded(x: arb) -> str:
    """Return the digits to which both ends of a ball round."""
    low, high = (to_decimal(exact_midpoint(end), DIGITS) for end in (x.lower(), x.upper()))
    if low != high:
        raise ArithmeticError(f"{x} doesn't tell {DIGITS} digits")
    return low


if __name__ == "__main__":
    sys.exit(main())
