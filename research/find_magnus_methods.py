"""Search for the commutator-free Magnus methods of orders six and eight, and write their files.

    python research/find_magnus_methods.py ORDER FLOWS [FOLDER] [--symmetric] [--optimise]

``6 4`` finds four flows for order six, ``8 8 --symmetric`` eight flows for order eight, ``6 6
--symmetric --optimise --seed 1 --starts 2`` six flows for order six with a small error. A(t) is
expanded in K = ORDER/2 Legendre polynomials on the step, with --optimise in one more; Lobatto's
formula with K + 1 nodes integrates all that the order needs. With x_ij the weight of polynomial j
in exponential i, the order conditions are those of Lyndon words in K letters of degrees 1 to K (of
odd degree, if the method is symmetric). scipy's least_squares solves them from random starts, with
--optimise near the integrals over equal parts of the step; it then moves along the set of solutions
towards smaller coefficients of words of degree ORDER + 1. The solution with the smallest Σ|x_i1|,
with --optimise that with the smallest norm of these coefficients, is refined.
"""

import argparse
from decimal import Decimal
from pathlib import Path

import numpy as np
from magnus_series import Array, Numbers, Words, letters_at, lobatto, minimum, written, zero

from cg.construction.catalogue import save
from cg.construction.conditions.linear_equations import (
    Series,
    as_decimal,
    combined,
    exponential,
    times,
)
from cg.construction.methods.magnus import MagnusMethod


def expand(movable: Array, flows: int, letters: int, symmetric: bool) -> Array:
    """Return x, shape (..., flows, letters), from its free entries."""
    if not symmetric:
        return movable.reshape(*movable.shape[:-1], flows, letters)
    half = movable.reshape(*movable.shape[:-1], flows // 2, letters)
    signs = (-1) ** np.arange(letters)
    return np.concatenate([half, half[..., ::-1, :] * signs], axis=-2)


def search(
    order: int, flows: int, symmetric: bool, starts: int, seed: int, optimise: bool
) -> Array | None:
    """Return the free entries of the best solution; None without any."""
    letters = order // 2 + optimise
    algebra = Words(letters, order + optimise)
    exact = np.array(list(algebra.solution().values()), dtype=np.float64)
    rows = algebra.conditions(order, symmetric)
    beyond = [i for i, word in enumerate(algebra.words) if sum(word) > order]
    size = flows * letters // (2 if symmetric else 1)

    def series(movable: Array) -> Array:
        x = expand(movable, flows, letters, symmetric)
        product = algebra.exponential(x[..., 0, :])
        for i in range(1, flows):
            product = algebra.multiply(algebra.exponential(x[..., i, :]), product)
        return product - exact

    def solve(movable: Array, weight: float) -> Array:
        def residuals(movable: Array) -> Array:
            found = series(movable)
            return np.concatenate([found[..., rows], weight * found[..., beyond]], axis=-1)

        return minimum(residuals, movable, 200, 1e-15)

    random, best = np.random.default_rng(seed), None
    for k in range(starts):
        if optimise:
            scale = random.choice([0.05, 0.1, 0.2, 0.4])
            movable = integrals(flows, letters)[:size] + scale * random.normal(size=size)
        else:
            movable = random.uniform(-0.6, 0.8, size)
        for weight in (0.0, *((1e-1, 1e-2, 1e-3, 1e-4, 0.0) if optimise else ())):
            movable = solve(movable, weight)
        found = series(movable)
        if np.abs(found[rows]).max() < 1e-11:
            length = np.abs(expand(movable, flows, letters, symmetric)[:, 0]).sum()
            error = float(np.linalg.norm(found[beyond])) if optimise else length
            print(f"start {k}: sum of |x_i1| {length:.4f}, error {error:.4g}", flush=True)
            if best is None or error < best[0] * (1 - 1e-9):
                best = error, movable
    return None if best is None else best[1]


def integrals(flows: int, letters: int) -> Array:
    """Return the integrals of Legendre polynomials over equal parts of the step, one by one."""
    ends = np.linspace(-1, 1, flows + 1)
    values = [np.polynomial.Legendre.basis(j).integ()(ends) / 2 for j in range(letters)]
    return np.diff(np.array(values), axis=1).T.reshape(-1)


def refine(movable: Array, order: int, flows: int, symmetric: bool, letters: int) -> list[Numbers]:
    """Return x to 60 digits."""
    algebra = Words(letters, order)
    exact = algebra.solution()
    words = [algebra.words[i] for i in algebra.conditions(order, symmetric)]
    each: list[Series] = [{(j + 1,): 1} for j in range(letters)]

    def residuals(movable: list[Decimal]) -> list[Decimal]:
        product: Series = {(): 1}
        for row in expand(np.array(movable), flows, letters, symmetric):
            product = times(exponential(combined(row, each), order), product, order)
        return [product[word] - as_decimal(exact[word]) for word in words]

    found = np.array(zero(residuals, movable))
    return expand(found, flows, letters, symmetric).tolist()


def method_of(x: list[Numbers], name: str) -> MagnusMethod:
    """Return the method that evaluates A at Lobatto's nodes, its coefficients to 36 places."""
    nodes, quadrature = lobatto(len(x[0]) + 1)
    letters = np.array(letters_at(nodes, quadrature, len(x[0])))
    weights = [written(list(row)) for row in np.array(x) @ letters]
    return MagnusMethod(
        written(nodes), weights, name=name, source="research/find_magnus_methods.py"
    )


def main() -> None:
    """Search, refine, print, and write a file if there is a folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("order", type=int, choices=(4, 6, 8))
    parser.add_argument("flows", type=int)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--symmetric", action="store_true")
    parser.add_argument("--optimise", action="store_true")
    parser.add_argument("--starts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    movable = search(
        given.order, given.flows, given.symmetric, given.starts, given.seed, given.optimise
    )
    if movable is None:
        raise SystemExit("no start came to a solution")
    letters = given.order // 2 + given.optimise
    x = refine(movable, given.order, given.flows, given.symmetric, letters)
    method = method_of(x, f"CFM{given.order}")
    print(method, method.principal_error)
    if given.folder is not None:
        save(method, given.folder)


if __name__ == "__main__":
    main()
