"""Flat Runge–Kutta methods to manifolds: `lift`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...conditions import MAX_ORDER
from ...method.commutator_free import CommutatorFree
from ...method.flat import flat_order, stage_orders
from ...method.tableau import Tableau
from ...support.checks import MAX_STAGES, check_flag, check_integer
from ...support.parallel import raise_if_stopped
from .exact import refined
from .improvement import improved
from .merging import reduced
from .solver import Fit, fit
from .splitting import FlatRows, Splitting, chains_layout, random_layout

__all__ = ["LiftError", "Lifted", "lift"]

_FREE_ZEROS_EVERY = (
    4  # starts from chains that keep the zeros of the tableau mostly converge faster
)
_WIDTH = 0.4  # of the unknowns at random starts
# Flows to the result, and to each stage, that were seen to suffice, by order.
_CHAINS = {1: 1, 2: 1, 3: 2, 4: 3, 5: 4, 6: 5, 7: 8, 8: 12}
_STAGE_CHAINS = {1: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 3, 7: 4, 8: 6}
_ITERATIONS = {7: 200, 8: 350}
_ITERATIONS_BELOW = 150
_STAGE_ORDERS_FROM = 6  # below, to assume stage orders only costs flows
_EXACT = 1e-33


class LiftError(ArithmeticError):
    """No start led to a method.

    Attributes
    ----------
    best : float
        The least sum of squared residuals that was reached.

    Examples
    --------
    One flow to each stage and one to the result are too few:

    >>> import cg
    >>> heun = cg.Tableau([[], ["1/3"], [0, "2/3"]], ["1/4", 0, "3/4"])
    >>> try:
    ...     cg.lift(heun, chains=[1, 1, 1], tries=2)
    ... except cg.LiftError as error:
    ...     print(f"{error.best:.0e}")
    2e-02
    """

    def __init__(self, message: str, best: float) -> None:
        super().__init__(f"{message}; the least sum of squared residuals was {best:.1e}")
        self.best = best


@dataclass(frozen=True)
class Lifted:
    """A flat method on manifolds, and how it was found.

    Attributes
    ----------
    method : CommutatorFree
        Its flat tableau is the one that was given, exactly.
    index : int
        The start that led to it.
    starts, hits : int
        Starts that were run, and those of them that led to a method.
    unknowns, rank : int
        Weights that the flat tableau leaves open, and how many of them the conditions determine.
    largest_residual : float
        Of the order conditions, in extended precision.

    Examples
    --------
    Heun's method of order three, which has order two on manifolds as it stands:

    >>> import cg
    >>> found = cg.lift(cg.Tableau([[], ["1/3"], [0, "2/3"]], ["1/4", 0, "3/4"]))
    >>> found.method.order, found.flows, found.largest_residual < 1e-30
    (3, 4, True)
    """

    method: CommutatorFree
    index: int
    starts: int
    hits: int
    unknowns: int
    rank: int
    largest_residual: float

    @property
    def flows(self) -> int:
        """Flows that a step takes, without the estimate of its error."""
        return self.method.exponentials

    @property
    def largest_weight(self) -> float:
        """Magnitude of the largest weight of a flow."""
        return max(abs(float(w)) for point in self.method.points for w in point.weights.values())


def lift(
    tableau: Tableau,
    order: int | None = None,
    *,
    embedded_order: int | None = None,
    flows: int | None = None,
    chains: Sequence[int] | None = None,
    seed: int = 0,
    tries: int = 100,
    hits: int = 1,
    reduce: bool = True,
    improve: bool = False,
    max_iterations: int | None = None,
    name: str | None = None,
    source: str | None = None,
) -> Lifted:
    """Make a commutator-free method of a flat one, which it stays wherever flows commute.

    The weights on each stage add up, along the path to every stage and to the result, to the
    entry of the flat tableau, exactly; how they are split into flows is found from random
    starts. If the last stage has the row of the result ("first same as last"), it is at the
    result. Second weights of a pair become one more flow, from the result.

    Parameters
    ----------
    tableau : Tableau
        Explicit. Rational coefficients stay rational.
    order : int, optional
        By default that of the flat method.
    embedded_order : int, optional
        Of the second weights; by default the flat one.
    flows : int, optional
        Start from random trees of points with so many flows.
    chains : sequence of int, optional
        Start from chains of so many flows each: to every stage but the first (and one at the
        result), and to the result. By default lengths that were seen to suffice. Every
        fourth start has weights where the tableau has zeros, too.
    seed : int, optional
        Start ``index`` is a pure function of the seed and its index.
    tries : int, optional
        Most starts.
    hits : int, optional
        Stop after so many of them led to a method; the one with the fewest flows is returned,
        and of those the one with the smallest largest weight.
    reduce : bool, optional
        Merge flows along the set of solutions for as long as that goes.
    improve : bool, optional
        Then move along the set of solutions to a small principal error; of several methods
        the one is returned that has the smallest error at equally many flows, to leading order.
    max_iterations : int, optional
        Steps from each start.
    name, source : str, optional
        Of the method; by default as of the tableau.

    Returns
    -------
    Lifted

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
    order, embedded_order = _check_orders(tableau, order, embedded_order)
    rows = FlatRows(*tableau.exact, tableau.exact_embedded)
    lengths = _check_shape(rows, order, flows, chains)
    if flows is not None:
        flows = check_integer("flows", flows, len(rows.own) + 1, MAX_STAGES)
    seed = check_integer("seed", seed, 0)
    tries, hits = check_integer("tries", tries, 1), check_integer("hits", hits, 1)
    reduce, improve = check_flag("reduce", reduce), check_flag("improve", improve)
    if improve and order >= MAX_ORDER:
        raise ValueError(
            f"improve: the order must be below {MAX_ORDER}, the highest in this build, got {order}"
        )
    if max_iterations is None:
        max_iterations = _ITERATIONS.get(order, _ITERATIONS_BELOW)
    max_iterations = check_integer("max_iterations", max_iterations, 1)
    assumed = stage_orders(tableau) if order >= _STAGE_ORDERS_FROM else ()

    found: list[tuple[tuple[float, float], int, Splitting, Fit]] = []
    best, index = np.inf, 0
    for index in range(tries):
        raise_if_stopped()
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        if flows is not None:
            layout = random_layout(rows, flows, generator)
        else:
            zeros = (index + 1) % _FREE_ZEROS_EVERY != 0
            layout = chains_layout(rows, lengths, zeros=zeros)
        splitting = Splitting(rows, layout, order, embedded_order, assumed)
        end = fit(splitting, _start(splitting, generator), max_iterations=max_iterations)
        best = min(best, end.f)
        if not end.solved:
            continue
        if reduce:
            splitting, end = reduced(splitting, end, max_iterations)
        count = len(splitting.layout.parents)
        rank = float(count), float(np.max(np.abs(end.x)))
        if improve:
            end = improved(splitting, end)
            error = float(np.linalg.norm(splitting.principal_residual(end.x)))
            rank = count * error ** (1 / order), 0.0
        found.append((rank, index, splitting, end))
        if len(found) == hits:
            break
    for _, start, splitting, end in sorted(found, key=lambda hit: hit[:2]):
        exact = refined(splitting, end.x)
        if exact.largest_residual < _EXACT:
            method = CommutatorFree.from_layout(
                splitting.layout,
                exact.weights,
                name=tableau.name if name is None else name,
                source=tableau.source if source is None else source,
            )
            return Lifted(
                method, start, index + 1, len(found), splitting.free.size, exact.rank,
                exact.largest_residual,
            )  # fmt: skip
    raise LiftError(f"none of {index + 1} starts led to a method of order {order}", best)


def _check_orders(
    tableau: Tableau, order: int | None, embedded_order: int | None
) -> tuple[int, int]:
    if not isinstance(tableau, Tableau):
        raise TypeError(f"tableau must be a Tableau, got {tableau!r}")
    if not tableau.explicit:
        raise ValueError(f"tableau must be explicit, got {tableau!r}")
    flat = flat_order(tableau)
    order = flat if order is None else check_integer("order", order, 1)
    if not 1 <= order <= flat:
        raise ValueError(f"order must be from 1 to {flat}, that of the flat method, got {order}")
    if tableau.embedded_weights is None:
        if embedded_order is not None:
            raise ValueError(f"embedded_order: {tableau!r} has no second weights")
        return order, 0
    flat = min(flat_order(tableau, embedded=True), order)
    second = flat if embedded_order is None else check_integer("embedded_order", embedded_order, 1)
    if not 1 <= second <= flat:
        raise ValueError(
            f"embedded_order must be from 1 to {flat}, that of the flat second weights, "
            f"got {second}"
        )
    return order, second


def _check_shape(
    rows: FlatRows, order: int, flows: int | None, chains: Sequence[int] | None
) -> list[int]:
    """Return the lengths of chains."""
    if chains is None:
        return [*(min(_STAGE_CHAINS[order], k) for k in rows.own), _CHAINS[order]]
    if flows is not None:
        raise ValueError("flows and chains exclude each other")
    if isinstance(chains, str | bytes) or not isinstance(chains, Sequence | np.ndarray):
        raise TypeError(f"chains must be a sequence of integers, got {chains!r}")
    if isinstance(chains, np.ndarray) and chains.ndim != 1:
        raise ValueError(f"chains must be a sequence of integers, got shape {chains.shape}")
    lengths = list(chains)
    if len(lengths) != len(rows.own) + 1:
        raise ValueError(
            f"chains must have {len(rows.own) + 1} lengths, of stages and the result, "
            f"got {len(lengths)}"
        )
    return [check_integer("a length in chains", length, 1, MAX_STAGES) for length in lengths]


def _start(splitting: Splitting, generator: np.random.Generator) -> NDArray[np.float64]:
    # the last weights of chains make up for all others, so that flows are far from commuting
    return splitting.from_unknowns(generator.uniform(-_WIDTH, _WIDTH, splitting.free.size))
