r"""Low-storage methods with two registers, for large states.

A Runge–Kutta method stores the fields of all its stages. A two-register method [1]_ stores the
point and a single combination Z of the fields:

.. math:: Z_i = A_i Z_{i-1} + F_i, \qquad y_i = \exp(h B_i Z_i)\, y_{i-1},

with :math:`F_i` frozen at :math:`y_{i-1}`. Its tree of points is a chain with a stage at every
point but the last; the weights are products of A and B.

References
----------
.. [1] J. H. Williamson, "Low-storage Runge–Kutta schemes", J. Comput. Phys. 35 (1980), 48-56. As
   methods on manifolds: A. Bazavov, "Commutator-free Lie group methods with minimum storage
   requirements and reuse of exponentials", BIT Numer. Math. 62 (2022), arXiv:2007.04225.
"""

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

from cg.construction.methods.coefficients import MIN_ROUNDED_PLACES, Coefficient, read_row
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.construction.methods.tolerance import TOLERANCE_FACTOR
from cg.construction.points import MethodError
from cg.support.checks import check_instance

Registers = tuple[tuple[Fraction, ...], tuple[Fraction, ...]]


def from_two_registers(
    a: Iterable[Any], b: Iterable[Any], *, name: str = "", source: str = ""
) -> CommutatorFree:
    """Return the two-register method with coefficients A and B, which `Coefficient.read` takes.

    The first A multiplies an empty register and must be 0. Weights are rational if all numbers are
    exact; otherwise decimals, with as many places as the units of A and B determine.

    >>> from_two_registers(["0", "-5/9", "-153/128"], ["1/3", "15/16", "8/15"]).order
    3
    """
    factors = read_row(a, "a")
    steps = read_row(b, "b", len(factors))
    if factors[0].value != 0:
        raise MethodError(f"a[0] must be 0, since it multiplies nothing, got {factors[0].text}")
    for i, step in enumerate(steps):
        if step.value == 0:
            raise MethodError(f"b[{i}] must not be 0, or the next stage repeats stage {i}")
    register: list[tuple[Fraction, Fraction]] = []  # weights on stages, and what they are off by
    points = []
    for i, (factor, step) in enumerate(zip(factors, steps, strict=True)):
        register = [*(_product(weight, factor) for weight in register), (Fraction(1), Fraction(0))]
        weights = {k: _rounded_weight(*_product(weight, step)) for k, weight in enumerate(register)}
        points.append((i - 1, weights))
    return CommutatorFree(points, range(-1, len(steps) - 1), name=name, source=source)


def _product(weight: tuple[Fraction, Fraction], factor: Coefficient) -> tuple[Fraction, Fraction]:
    value, unit = weight
    return value * factor.value, unit * abs(factor.value) + abs(value) * factor.unit


def _rounded_weight(value: Fraction, unit: Fraction) -> Fraction | str:
    """Return an exact number, or a decimal with the places that `unit` leaves significant."""
    if not unit:
        return value
    places = MIN_ROUNDED_PLACES  # with fewer it would be read as exact
    while unit * 10 ** (places + 1) <= 1:
        places += 1
    whole, fraction = divmod(abs(round(value * 10**places)), 10**places)
    return f"{'-' * (value < 0)}{whole}.{fraction:0{places}}"


def two_registers(method: Method) -> Registers | None:
    """Return A and B of a two-register method, up to the units of its weights; None for others."""
    check_instance("method", method, Method)
    if not method.explicit or method.embedded_result is not None:
        return None
    stages = method.stages
    chain = tuple(range(-1, stages - 1))
    if (
        tuple(point.parent for point in method.points) != chain
        or method.stage_points != chain
        or method.result != stages - 1
        or any(point.weights.get(i, 0) == 0 for i, point in enumerate(method.points))
    ):
        return None
    units = _units(method)
    b = tuple(point.weights[i] for i, point in enumerate(method.points))
    a = [Fraction(0)]
    for i in range(1, stages):
        now, before = method.points[i], method.points[i - 1]
        lead, lead_unit = now.weights.get(i - 1, Fraction(0)), units[i].get(i - 1, Fraction(0))
        for k in range(i - 1):
            weight, other = now.weights.get(k, Fraction(0)), before.weights.get(k, Fraction(0))
            off = (
                units[i].get(k, 0) * abs(b[i - 1])
                + abs(weight) * units[i - 1].get(i - 1, 0)
                + lead_unit * abs(other)
                + abs(lead) * units[i - 1].get(k, 0)
            )
            if abs(weight * b[i - 1] - lead * other) > TOLERANCE_FACTOR * off:
                return None
        a.append(lead / b[i])
    return tuple(a), b


def _units(method: Method) -> list[dict[int, Fraction]]:
    """Return the units of the weights by point and stage; unused with one weight a point."""
    if not isinstance(method, CommutatorFree):
        return [{} for _ in method.points]
    return [{k: w.unit for k, w in row.items()} for row in method.point_coefficients]
