"""Functions that decide the claims of the paper.

Each takes the numbers of `evidence.gather` and the results of all items, and returns a verdict.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from . import top
from .blocks import Data, median, number, places

Verdict = tuple[bool | None, str]
"""Passed, failed, or (None) not reproducible; and the evidence or the reason."""

Results = Mapping[str, Data]

MANY = 1000  # one start in so many, a rate that another seed doesn't turn
_ABOUT = 10**0.5
"""Factor by which a number may differ from a power of ten that the paper gives."""


def catalogue_order(order: int, name: str, numbers: Data, results: Results) -> Verdict:
    """Return whether a method of the catalogue has an order, by its exact residuals."""
    exact_order = numbers["methods"][name]["exact_order"]
    return exact_order == order, f"order of {name}, as far as its digits can tell: {exact_order}"


def example(order: int, name: str, numbers: Data, results: Results) -> Verdict:
    """Return whether an example has its order, and the printed digits are those of the method.

    They may be off by two units of the last place, and their zeros must be exact ones.
    """
    passed, text = catalogue_order(order, name, numbers, results)
    part = results["appendix"]["methods"][name]
    residuals, bound = part["residuals"], 2 * 10.0 ** -part["decimals"]
    return bool(passed) and part["largest_difference"] <= bound and part["zeros_kept"], (
        f"{text}; its {part['count']} printed coefficients are within "
        f"{number(part['largest_difference'], 2)} of ours; largest residual "
        f"{number(residuals['paper']['largest'], 2)} as printed, "
        f"{number(residuals['ours']['largest'], 2)} ours"
    )


def slope(order: int, name: str, numbers: Data, results: Results) -> Verdict:
    """Return whether slopes are within 0.1 of the order in quadruple precision, 0.25 in double."""
    quad = results["fig4.2quad"]["readings"]["momentum"]["methods"][name]
    double = [results["fig4.2"]["readings"][reading][name]["slope"] for reading in top.READINGS]
    exact = all(slope is not None and abs(slope - order) < 0.25 for slope in double)
    return exact and abs(quad["slope"] - order) < 0.1, (
        f"{name}: slope {places(quad['slope'])} in quadruple precision, "
        f"{' and '.join(places(slope, 2) for slope in double)} in double (either ω(0))"
    )


def slope_six(numbers: Data, results: Results) -> Verdict:
    """Return whether CG6a's slope at the smallest stepsizes is within 0.1 of six."""
    run = results["fig4.2quad"]["readings"]["momentum"]["methods"]["CG6a"]
    early = " and ".join(places(s, 2) for s in run["local"][:2])
    return abs(run["slope"] - 6) < 0.1, (
        f"CG6a: local slopes {early} for h from 1/4 to 1/16, but {places(run['slope'])} over the "
        f"smallest stepsizes, where the error stays at {number(run['error'][-1], 2)}"
    )


def slope_approximate(numbers: Data, results: Results) -> Verdict:
    """Return whether CG6a's slope at the smallest stepsizes is below 5.5."""
    run = results["fig4.2quad"]["readings"]["momentum"]["methods"]["CG6a"]
    double = results["fig4.2"]["readings"]["momentum"]["CG6a"]
    return run["slope"] < 5.5, (
        f"slope {places(run['slope'])} at the smallest stepsizes in quadruple precision; the "
        f"error stays near {number(min(double['error']), 2)} in double too"
    )


def many(order: int, numbers: Data, results: Results) -> Verdict:
    """Return whether the search found a distinct exact method in one start of a thousand."""
    data = results[f"search{order}"]
    return _are_many(data["distinct"], data), f"{_found(data)}, one in {MANY} being many"


def _are_many(found: int, data: Data) -> bool:
    return found * MANY >= len(data["exact"])


def _found(data: Data) -> str:
    return f"{data['distinct']} distinct exact methods from {len(data['exact'])} starts"


def trees(numbers: Data, results: Results) -> Verdict:
    """Return whether as many trees are generated, far beyond order six, as there should be."""
    part = numbers["trees"]
    return part["generated"] == part["expected"], (
        f"{part['generated']} ordered trees for order {part['order']}, by the sum of Catalan "
        f"numbers {part['expected']}"
    )


def independence(numbers: Data, results: Results) -> Verdict:
    """Return whether the rank of the full Jacobian is the number of independent conditions."""
    parts = numbers["conditions"].values()
    passed = all(
        part["rank"] == [part["independent"]] * 2 and part["independent"] < part["all"]
        for part in parts
    )
    return passed, "rank of the Jacobian of all conditions at random tableaux: " + ", ".join(
        f"{part['rank'][0]} of {part['all']}" for part in parts
    )


def zeros(numbers: Data, results: Results) -> Verdict:
    """Return whether the integer table without its zeros has the paper's N_CG rows."""
    rows = results["table3.2"]["rows"]
    passed = all(row["trees"] - row["discarded"] == row["paper"]["N_CG"] for row in rows)
    return passed, "; ".join(
        f"order {row['paper']['q']}: {row['discarded']} zeros in {row['trees']} rows"
        for row in rows
    )


def table(numbers: Data, results: Results) -> Verdict:
    """Return whether all numbers of the table agree."""
    agree = [row["agree"] for row in results["table3.2"]["rows"]]
    return all(agree), f"{sum(agree)} of 3 rows agree"


def double(order: int, bound: float, numbers: Data, results: Results) -> Verdict:
    """Return whether many starts reach a bound of f in double."""
    data = results[f"search{order}"]
    reached, text = _reached(data["f_double"], f"{len(data['exact'])} starts", bound)
    return _are_many(reached, data), f"{text} in double"


def usually(order: int, bound: float, numbers: Data, results: Results) -> Verdict:
    """Return whether more than half of the refined starts reach a bound."""
    f = [value for value in results[f"search{order}"]["f_quad"] if value is not None]
    reached, text = _reached(f, f"{len(f)} refined starts", bound)
    return 2 * reached > len(f), text


def _reached(f: Sequence[float], starts: str, bound: float) -> tuple[int, str]:
    """Return how many starts reach a bound of f, and a text that also has those of √f."""
    reached, roots = (sum(value <= limit for value in f) for limit in (bound, bound**2))
    text = f"{reached} of {starts} reach f ≤ {number(bound, 1)}, {roots} √f ≤ {number(bound, 1)}"
    return reached, text + (f"; smallest f {number(min(f), 2)}" if f else "")


def six_no_further(numbers: Data, results: Results) -> Verdict:
    """Return whether no start of order six reaches f < 1e-7 in double."""
    data, evaluations = results["search6"], results["evaluations"]
    f = data["f_double"]
    by_limit = zip(evaluations["limits"], evaluations["f_quartiles"], strict=True)
    return min(f) >= 1e-7, (
        f"our f in double: smallest {number(min(f), 2)} (√f {number(math.sqrt(min(f)), 2)}), "
        f"median {number(median(f), 2)}; {data['at_limit']} of {len(f)} starts ended at the limit "
        f"of {data['settings']['maxfev']} evaluations. Median by limit: "
        + ", ".join(f"{number(five[2], 2)} ({limit})" for limit, five in by_limit)
    )


def improved(numbers: Data, results: Results) -> Verdict:
    """Return whether real(16) reduces f from 1e-6 to 1e-8 at more than half of the starts.

    This depends on the limits of evaluations, which the paper does not give: double is stopped
    near 1e-6 for this test, and the evidence has the search's own limits too. A start counts if f
    is above 10^-7.5 after double and not after real(16).
    """
    stopped, long = results["evaluations"]["stopped"], results["search6"]
    counted, pairs, text = _improvement(stopped)
    limits = long["settings"]
    return 2 * counted > len(pairs), (
        f"the paper does not give its limits. With {stopped['limit']} evaluations in double and "
        f"{stopped['limit_quad']} in real(16), {text}; with {limits['maxfev']} and "
        f"{limits['refine_maxfev']}, {_improvement(long)[2]}"
    )


def _improvement(data: Data) -> tuple[int, list[tuple[float, float]], str]:
    """Return at how many starts real(16) leads to about 1e-8, f before and after, and a text."""
    pairs = [
        (before, after)
        for before, after in zip(data["f_double"], data["f_quad"], strict=True)
        if after is not None
    ]
    counted = sum(before > _ABOUT * 1e-8 >= after for before, after in pairs)
    text = f"{counted} of {len(pairs)} starts come to about 1e−8 in real(16)"
    if pairs:
        before, after = (median(values) for values in zip(*pairs, strict=True))
        text += f", the median of f from {number(before, 2)} to {number(after, 2)}"
    return counted, pairs, text


def no_zero(numbers: Data, results: Results) -> Verdict:
    """Return whether the search found no exact method of order six."""
    data = results["search6"]
    return data["distinct"] == 0, _found(data) + f"; smallest f {number(data['best']['f'], 2)}"


def ill_conditioned(numbers: Data, results: Results) -> Verdict:
    """Return whether difference quotients in double cannot resolve the Jacobian of order six.

    Their relative error is about the square root of the machine epsilon, so they do not resolve
    directions whose singular value is smaller than this times the largest.
    """
    at_random = {q: part["condition_number"] for q, part in numbers["conditions"].items()}
    named = {name: numbers["methods"][name]["condition_number"] for name in ("CG4a", "CG6a")}
    end = results["search6"]["best"]["condition_number"] or np.inf
    limit = 1 / float(np.sqrt(np.finfo(np.float64).eps))
    grows = at_random["4"] < at_random["5"] < at_random["6"]
    return grows and min(named["CG6a"], end) > limit > named["CG4a"], (
        "condition number of the Jacobian, median over random tableaux: "
        + ", ".join(f"{number(value, 2)} (order {q})" for q, value in at_random.items())
        + f"; at CG4a {number(named['CG4a'], 2)}, at CG6a {number(named['CG6a'], 2)}, at our best "
        f"start of order six {number(end, 2)}; difference quotients resolve {number(limit, 2)}"
    )


def typical_digits(numbers: Data, results: Results) -> Verdict:
    """Return whether the median condition holds to six or seven decimals."""
    part = numbers["approximate"]
    return 6 <= part["median"] <= 7, (
        f"decimals to which CG6a satisfies the median condition: {number(part['median'])}"
    )


def all_digits(numbers: Data, results: Results) -> Verdict:
    """Return whether every condition holds to six decimals."""
    part = numbers["approximate"]
    return part["worst"] >= 6, (
        f"{part['six']} of {part['conditions']} conditions hold to 1e−6; the worst to "
        f"{number(part['worst'])} decimals, in the root mean square "
        f"{number(part['root_mean_square'])}; the digits after the eighth, which are not printed, "
        f"change a condition by at most {number(part['truncation'], 1)}"
    )


def moderate(numbers: Data, results: Results) -> Verdict:
    """Return whether no coefficient exceeds the largest of CG4, the method known before."""
    sizes = {name: numbers["methods"][name]["largest_coefficient"] for name in top.METHODS}
    known = sizes.pop("CG4")
    text = ", ".join(f"{name} {number(size)}" for name, size in sizes.items())
    evidence = f"largest coefficient: {text}; for comparison CG4 {number(known)}"
    return max(sizes.values()) < known, evidence


def in_unit_interval(numbers: Data, results: Results) -> Verdict:
    """Return whether the abscissae of CG4a lie in [0, 1]."""
    low, high = numbers["methods"]["CG4a"]["abscissae"]
    return 0 <= low <= high <= 1, f"abscissae of CG4a from {number(low)} to {number(high)}"


def initial(numbers: Data, results: Results) -> Verdict:
    """Return whether B(0) is a rotation to rounding."""
    part = numbers["initial"]
    return max(part.values()) < 1e-15, (
        f"BᵀB − I: {number(part['orthogonality'], 2)}, det B − 1: {number(part['determinant'], 2)}"
    )


def superior(
    name: str, others: tuple[str, ...], factor: float, numbers: Data, results: Results
) -> Verdict:
    """Return whether errors are always below the others', at t = 1 by a factor, in each reading."""
    ratios = {reading: _ratio(results, reading, name, others, factor) for reading in top.READINGS}
    rival = others[0] if len(others) == 1 else "the best of the others"
    return all(passed for passed, _ in ratios.values()), (
        f"error of {name} against {rival}, all times. "
        + ". ".join(f"ω(0) a {reading}: {text}" for reading, (_, text) in ratios.items())
    )


def _ratio(
    results: Results, reading: top.Reading, name: str, others: tuple[str, ...], factor: float
) -> tuple[bool, str]:
    runs = results["fig4.1"]["readings"][reading]["methods"]
    texts, passed = [], True
    for component, label in (("rotation", "B"), ("momentum", "ω")):
        errors = np.array(runs[name][component][1:])
        best = np.min([runs[other][component][1:] for other in others], axis=0)
        ratios = best / errors
        passed = passed and ratios[-1] > factor and bool((ratios > 1).all())
        texts.append(
            f"{label}: smaller by {number(float(ratios.min()))} to {number(float(ratios.max()))}, "
            f"at t = 1 by {number(float(ratios[-1]))}"
        )
    return passed, "; ".join(texts)


def exact(numbers: Data, results: Results) -> Verdict:
    """Return whether the distance from SO(3) stays at rounding, of the flows themselves too."""
    runs = [run for methods in results["fig4.2"]["readings"].values() for run in methods.values()]
    flows = max(max(run["distance_flows"]) for run in runs)
    stepped = max(max(run["distance"]) for run in runs)
    return max(flows, stepped) < 1e-14, (
        f"largest distance from SO(3): {number(flows, 2)} by flows alone, {number(stepped, 2)} "
        "with a Newton–Schulz step at the end of each step"
    )


def theorem(kind: str, numbers: Data, results: Results) -> Verdict:
    """Return whether slopes on another problem are the orders, or larger with Munthe-Kaas."""
    runs = numbers["rotation_slopes"][kind]
    most = np.inf if kind == "Munthe-Kaas" else 0.1
    passed = all(-0.1 < run["slope"] - run["order"] < most for run in runs.values())
    return passed, "slopes on a rotation whose velocity depends on it: " + ", ".join(
        f"{name} {places(run['slope'])} (order {run['order']})" for name, run in runs.items()
    )


def drift(numbers: Data, results: Results) -> Verdict:
    """Return whether SciPy's solvers leave SO(3), by more and more."""
    runs = numbers["drift"].values()
    passed = all(run == sorted(run) and run[0] > 1e-6 and run[-1] > 2 * run[0] for run in runs)
    times = ", ".join(number(t) for t in numbers["drift_times"])
    return passed, f"distance of the top's B from SO(3) at t = {times}, default tolerances: " + (
        "; ".join(
            f"SciPy's {name} {', '.join(number(size, 2) for size in run)}"
            for name, run in numbers["drift"].items()
        )
    )


def flat(numbers: Data, results: Results) -> Verdict:
    """Return whether the methods agree with the classical ones to rounding."""
    worst = max(numbers["flat"].values())
    return worst < 1e-14, f"largest difference from the classical methods: {number(worst, 2)}"


def truncated(numbers: Data, results: Results) -> Verdict:
    """Return whether 16 decimals are printed, and may be those of an exact method, truncated."""
    parts = results["appendix"]["methods"]
    passed = all(
        part["decimals"] == 16 and part["if_truncated"] is not None and part["if_truncated"] <= 0.5
        for part in parts.values()
    )
    return passed, "; ".join(
        f"{name}: {part['decimals']} decimals"
        + (
            ""
            if part["if_truncated"] is None
            else f", the nearest exact method is {number(part['if_truncated'], 2)} units of the "
            "last place from the middle of what is truncated to them, "
            f"{number(part['if_rounded'], 2)} from that of what is rounded; up to 0.5 is possible"
        )
        for name, part in parts.items()
    )
