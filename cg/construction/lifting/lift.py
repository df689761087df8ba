"""Make commutator-free methods of flat Runge–Kutta methods.

The weights on stage j along the path to stage i add up to a_ij, so that the method is the flat one
where flows commute, and its order conditions of flat space hold beforehand. What is left to solve
are the conditions in which the sequence of flows counts; the unknowns are how a_ij and b_j are
split (E. Celledoni, A. Marthinsen, B. Owren, Future Generation Computer Systems 19, 2003).

Flows are merged: the weights of a flow are added to those of the flow after it, which changes the
result little where both are short, and the conditions are solved again from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from operator import attrgetter, itemgetter

import numpy as np

from cg.construction.conditions import MAX_ORDER
from cg.construction.layouts import MAX_STAGES, check_length
from cg.construction.lifting.split_rows import FlatRows, SplitRows, chains_layout, random_layout
from cg.construction.methods.classical_conditions import flat_order, flat_residuals, stage_orders
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.tableau import Tableau
from cg.construction.search.candidate import Candidate, correct, solved
from cg.construction.search.optimise import Limits, optimise
from cg.construction.search.shapes import merge_point, start_generator
from cg.construction.solvers.refine import polish
from cg.support import flint
from cg.support.checks import check_flag, check_instance, check_integer
from cg.support.parallel import raise_if_stopped

# Every fourth start has weights where the tableau has zeros; the others converge faster.
_FREE_ZEROS_EVERY = 4
_DAMPING = 1e-2  # at first
_WIDTH = 0.4  # unknowns of random starts are uniform in [-width, width]
# Numbers of flows to the result, and to each stage, that sufficed in experiments, by order.
_CHAINS = {1: 1, 2: 1, 3: 2, 4: 3, 5: 4, 6: 5, 7: 8, 8: 12}
_STAGE_CHAINS = {1: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 3, 7: 4, 8: 6}
_ITERATIONS = {7: 200, 8: 350}  # limit for a start, by order
_ITERATIONS_BELOW = 150  # in lower orders
_STAGE_ORDERS_FROM = 6  # below this order, assumed stage orders only cost flows
_EXACT = 1e-33  # largest residual of a method
_DENOMINATOR_DIGITS = 8  # digits of the largest denominators that are recognised

_FIRST_ITERATIONS = 60  # after a merge; most successful ones need fewer
_FURTHER_SHARE = 4  # a quarter of the merges, the best ones, get more iterations
_MIN_FURTHER = 6  # at least that many merges get them
_GROWTH = 1.25  # bound on improved weights, relative to the largest entry of the tableau

_ROUNDED_F = 1e-15  # sum of squared residuals that rounded coefficients leave

_Solution = tuple[tuple[float, float], int, Candidate]  # key and index of a start, and its end


class LiftError(ArithmeticError):
    """No start led to a method.

    Attributes
    ----------
    best
        Smallest sum of squared residuals of all starts.

    Examples
    --------
    One flow to each stage and one to the result are too few:

    >>> import crouch_grossman as cg
    >>> heun = cg.Tableau([[], ["1/3"], [0, "2/3"]], ["1/4", 0, "3/4"])
    >>> try:
    ...     cg.lift(heun, chains=[1, 1, 1], tries=2)
    ... except cg.LiftError as error:
    ...     print(f"{error.best:.0e}")
    7e-03
    """

    def __init__(self, message: str, best: float) -> None:
        super().__init__(message, best)
        self.best = best

    def __str__(self) -> str:
        text = f"{self.args[0]}; the least sum of squared residuals was {self.best:.1e}"
        if self.best < _ROUNDED_F:
            text += ": coefficients must be exact or have some 40 digits, rounded ones may not do"
        return text


@dataclass(frozen=True)
class Lifted:
    """The result of `lift`.

    Attributes
    ----------
    method
        Its flat tableau is exactly the given one.
    index
        Number of the start that led to it.
    max_residual
        Largest residual of the order conditions, in extended precision.

    Examples
    --------
    Heun's method of order three, which has order two on manifolds as it stands:

    >>> import crouch_grossman as cg
    >>> lifted = cg.lift(cg.Tableau([[], ["1/3"], [0, "2/3"]], ["1/4", 0, "3/4"]))
    >>> lifted.method.order, lifted.flows, lifted.max_residual < 1e-30
    (3, 4, True)
    """

    method: CommutatorFree
    index: int
    max_residual: float

    @property
    def flows(self) -> int:
        """Number of flows in a step, without those of the error estimate."""
        return self.method.exponentials


def lift(
    tableau: Tableau, order: int | None = None, *, flows: int | None = None,
    chains: Sequence[int] | None = None, seed: int = 0, tries: int = 100, hits: int = 1,
    reduce: bool = True, improve: bool = False,
) -> Lifted:  # fmt: skip
    """Make a commutator-free method of a flat one.

    Where flows commute, the method is the flat one: along the path to every stage and to the
    result, the weights on each stage add up exactly to the entry of the flat tableau. How they
    are split into flows is solved for from random starts. If the last stage has the row of the
    result ("first same as last"), it is at the result. Second weights of a pair become one more
    flow, from the result.

    A tree with fewer flows may exist than the default finds: classical RK4 becomes a method of six
    flows, and CF4 of the catalogue has its tableau and five. Pass `flows` with more `tries`.

    Parameters
    ----------
    tableau
        Explicit, with coefficients that are exact or have some 40 digits. Rounded ones, such as
        doubles, are taken as the simplest fractions next to them if these satisfy all flat
        conditions, and may have no solution otherwise. Rational coefficients stay rational.
    order
        Order of the method; by default that of the flat method. The second result has at most that
        of the flat second weights.
    flows
        Start from random trees of points with this number of flows.
    chains
        Sequence of int. Numbers of flows in the chains to start from: to every stage except the
        first (and one at the result), and to the result. The default lengths sufficed in
        experiments. Every fourth start also has weights where the tableau has zeros.
    seed
        The seed and the number of a start determine its random numbers.
    tries
        Largest number of starts.
    hits
        Number of solutions after which to stop. Of these, the one with the fewest flows is
        returned; of several, the one whose largest weight is smallest.
    reduce
        Merge flows as long as a solution with fewer flows exists.
    improve
        Then reduce the principal error along the solution set. Of several solutions, the one
        with the smallest leading error for the same number of flows is returned.

    Raises
    ------
    TypeError, ValueError
        If the tableau is implicit, an order is above the flat one, or an argument is out of
        range.
    LiftError
        If no start led to a method.

    Examples
    --------
    >>> kutta = Tableau([[], ["1/2"], [-1, 2]], ["1/6", "2/3", "1/6"])
    >>> lifted = lift(kutta)
    >>> lifted.method.order, lifted.method.exact == kutta.exact
    (3, True)
    """
    order, embedded_order = _check_orders(tableau, order)
    tableau = _unrounded(tableau)
    flat = FlatRows(*tableau.exact, tableau.exact_embedded)
    if flows is not None:
        flows = check_integer("flows", flows, len(flat.moved_stages) + 1, MAX_STAGES)
    split_of = partial(
        SplitRows, order, flat=flat, embedded_order=embedded_order,
        stage_orders=stage_orders(tableau) if order >= _STAGE_ORDERS_FROM else (),
    )  # fmt: skip
    lengths, seed = _check_chains(flat, order, flows, chains), check_integer("seed", seed, 0)
    reduce, improve = check_flag("reduce", reduce), check_flag("improve", improve)
    if improve and order >= MAX_ORDER:
        raise ValueError(
            f"improve must be False for order {order}, as {MAX_ORDER} is the highest in this build"
        )
    tries, hits = check_integer("tries", tries, 1), check_integer("hits", hits, 1)
    _ = flint.ctx  # an error if it is missing, by which results are refined
    solutions: list[_Solution] = []  # the one with the smallest key is the best
    best, index = np.inf, 0
    for index in range(tries):
        generator = start_generator(seed, index)
        if flows is None:
            layout = chains_layout(flat, lengths, zeros=(index + 1) % _FREE_ZEROS_EVERY != 0)
        else:
            layout = random_layout(flat, flows, generator)
        end = _solved(split_of(layout), generator, reduce)
        best = min(best, end.f)
        if solved(end):
            solutions.append(_with_key(index, end, improve))
        if len(solutions) == hits:
            break
    names = {"name": tableau.name, "source": tableau.source}
    for _, start, end in sorted(solutions, key=itemgetter(0, 1)):
        system = end.system
        exact = polish(list(map(Fraction, end.x.tolist())), system)
        if exact.max_residual < _EXACT:
            method = CommutatorFree.from_layout(system.layout, system.texts(exact.x), **names)
            return Lifted(method, start, float(exact.max_residual))
    raise LiftError(f"none of {index + 1} starts led to a method of order {order}", best)


def _solved(split: SplitRows, generator: np.random.Generator, reduce: bool) -> Candidate:
    """Solve from one random start, and merge flows of a solution if `reduce`."""
    raise_if_stopped()
    iterations = _ITERATIONS.get(split.order, _ITERATIONS_BELOW)
    # the remainders, last weights of chains, are large: flows are far from commuting
    start = Candidate(split, generator.uniform(-_WIDTH, _WIDTH, split.size))
    end = correct(start, damping=_DAMPING, max_iterations=iterations)
    while reduce and solved(end) and (merged := _merged(end, iterations)):
        end = merged
    return end


def _merged(end: Candidate, iterations: int) -> Candidate | None:
    """Return the first merge that leads to a solution; merges with small residuals come first."""
    starts = sorted(_merges(end), key=attrgetter("f"))
    for max_iterations in (min(_FIRST_ITERATIONS, iterations), iterations):
        unsolved = []
        for start in starts:
            raise_if_stopped()
            merged = correct(start, damping=_DAMPING, max_iterations=max_iterations)
            if solved(merged):
                return merged
            unsolved.append(merged)
        unsolved.sort(key=attrgetter("f"))
        starts = unsolved[: max(_MIN_FURTHER, len(unsolved) // _FURTHER_SHARE)]
    return None


def _merges(end: Candidate) -> Iterator[Candidate]:
    """Yield the candidates without each point that is no stage or result and has one flow on."""
    layout = end.system.layout
    for point in range(len(layout.parents)):
        if point not in layout.ends and layout.parents.count(point) == 1:
            smaller, x = merge_point(layout, end.x.tolist(), point)
            yield Candidate(replace(end.system, layout=smaller), x)


def _with_key(index: int, end: Candidate, improve: bool) -> _Solution:
    """Return a solution with its key, if `improve` with a reduced principal error."""
    flows = len(end.system.layout.parents)
    if not improve:
        return (float(flows), end.max_coefficient), index, end
    assert isinstance(end.system, SplitRows)
    rows = [*end.system.flat.stages, end.system.flat.result]
    largest = float(max(abs(entry) for row in rows for entry in row))
    bound = max(end.max_coefficient, _GROWTH * largest)
    end = optimise(end, limits=Limits(np.eye(end.system.size), -bound, bound))
    return (flows * end.principal_error ** (1 / end.system.order), 0.0), index, end


def _check_orders(tableau: Tableau, order: int | None) -> tuple[int, int]:
    """Return the orders of the results, 0 for a second one that there isn't."""
    check_instance("tableau", tableau, Tableau)
    if not tableau.explicit:
        raise ValueError(f"tableau must be explicit, got {tableau!r}")
    pair = tableau.embedded_weights is not None
    orders = [flat_order(tableau, embedded=embedded) for embedded in (False, True)[: 1 + pair]]
    if 0 in orders:
        raise ValueError(f"tableau must have weights of sum 1 at least, got {tableau!r}")
    order = orders[0] if order is None else check_integer("order", order, 1, orders[0])
    return order, min(orders[1], order) if pair else 0


def _unrounded(tableau: Tableau) -> Tableau:
    """Return the tableau with simple rational numbers of which its coefficients are rounded ones.

    It is the given one, unless the flat conditions then hold exactly.
    """
    simple = tableau.with_coefficients([_simplest(entry) for entry in tableau.coefficients])
    for embedded in (False, True)[: 1 + (tableau.embedded_weights is not None)]:
        order = flat_order(tableau, embedded=embedded)
        a, b = simple.exact[0], simple.exact_embedded if embedded else simple.exact[1]
        assert b is not None
        if any(flat_residuals(a, b, order)):
            return tableau
    return simple


def _simplest(entry: Coefficient) -> Fraction | Coefficient:
    """Return the fraction of smallest denominator that a coefficient may be rounded from."""
    near = (entry.value.limit_denominator(10**k) for k in range(1, _DENOMINATOR_DIGITS + 1))
    allowed = (simple for simple in near if abs(simple - entry.value) <= 2 * entry.unit)
    return next(allowed, entry) if entry.unit else entry


def _check_chains(
    rows: FlatRows, order: int, flows: int | None, chains: Sequence[int] | None
) -> list[int]:
    """Return the numbers of flows in the chains to moved stages and to the result."""
    if chains is None:
        return [*(min(_STAGE_CHAINS[order], k) for k in rows.moved_stages), _CHAINS[order]]
    if flows is not None:
        raise ValueError(f"flows must be None with chains, which say their numbers, got {flows}")
    check_length(chains, len(rows.moved_stages) + 1, "chains")
    return [check_integer("a length in chains", length, 1, MAX_STAGES) for length in chains]
