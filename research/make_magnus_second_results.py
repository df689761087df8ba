"""Give Magnus methods second and third results that see quadrature as well as commutators.

The weights of both flows of the second result, w / 2 ± b (1 - 2 c), have moments of order four for
any weights w that integrate cubic polynomials. With those of the first result, b, the difference
of both would vanish where coefficients commute. So w leaves out a node: at Lobatto's five nodes the
middle one; CFM6(4), which has four nodes, gets the middle of the step as another one, with weights
of Simpson's rule. A third result follows one flow, with 3 b / 4 and a quarter of the trapezoidal
rule. Then all errors of the difference have the same orders, five and three.

    python research/make_magnus_second_results.py FOLDER [NAME ...]
"""

from fractions import Fraction

from recipes import run, texts

import cg
from cg.construction.methods.estimate import estimate_ratio

_HALF = Fraction(1, 2)
FACTORS = {"CFM6(4)": 1, "CFM6(4)b": 8, "CFM8(4)": 2}
"""Those of the third results: powers of two with ratios of error to estimate below 4."""

NOTE = "; second result research/make_magnus_second_results.py"


def make(name: str) -> cg.MagnusMethod:
    """Return a method of the catalogue with other second and third results."""
    method = cg.methods[name]
    assert isinstance(method, cg.MagnusMethod)
    rows = [{k: row[k].value for k in range(len(row))} for row in method.weights]
    nodes = dict(enumerate(method.abscissae))
    if _HALF not in nodes.values():
        nodes[len(nodes)] = _HALF
    order = sorted(nodes, key=lambda k: nodes[k])
    c = [nodes[k] for k in order]
    flows = [[row.get(k, Fraction(0)) for k in order] for row in rows]
    b = [sum(column, Fraction(0)) for column in zip(*flows, strict=True)]
    w = _symmetric("-1/12", "7/12", "0") if b[2] else _symmetric("1/6", "0", "2/3")
    first = [x / 2 + weight * (1 - 2 * node) for x, weight, node in zip(w, b, c, strict=True)]
    ends = _symmetric("1/2", "0", "0")
    third = [3 * weight / 4 + end / 4 for weight, end in zip(b, ends, strict=True)]
    result = cg.MagnusMethod(
        texts(c), list(map(texts, flows)), [texts(first), texts(first[::-1])],
        third=texts(third), third_factor=FACTORS[name], name=name,
        source=method.source.split(";")[0] + NOTE,
    )  # fmt: skip
    print(f"{name}: ratio of error to estimate {estimate_ratio(result):.3g}")
    return result


def _symmetric(first: str, second: str, middle: str) -> list[Fraction]:
    return list(map(Fraction, (first, second, middle, second, first)))


if __name__ == "__main__":
    run(make, FACTORS, __doc__)
