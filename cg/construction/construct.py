"""From random starts to an exact method with few stages."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checkpoint import Checkpoint
from ..checks import (
    LARGEST_COUNT,
    MOST_STAGES,
    WIDEST,
    check_flag,
    check_integer,
    check_real,
)
from ..conditions import count
from ..layout import Layout
from ..method import Method
from ..parallel import as_finished, available_cores
from ..points import START
from ..solve.system import ConditionSystem, Structure
from ..tree_shapes import check_order, check_points, draw_layout
from .candidate import Candidate, NotExactError, refinable, solved, to_method
from .drop import solve_start
from .drop_flow import drop_flow
from .eliminate import eliminate, walk
from .start import default_start, likely_structure, random_candidate, tree_start

__all__ = ["Attempt", "Construction", "ConstructionSettings", "construct", "run_attempt"]


@dataclass(frozen=True)
class ConstructionSettings:
    """What a construction does; see `construct`."""

    order: int
    stages: int
    seed: int
    structure: Structure
    first_stages: int
    width: float
    iterations: int
    promising: float
    largest: float
    restarts: int
    full_rank: bool
    flows: int | None = None
    first_flows: int | None = None
    embedded: bool = False
    tree: Layout | None = None
    first_same_as_last: bool = False


@dataclass(frozen=True)
class Attempt:
    """One random start and how far down it came.

    Attributes
    ----------
    index : int
        With the seed it determines everything else.
    stages : int
        Fewest stages reached.
    flows : int or None
        Fewest flows reached, where they count.
    solved : bool
        Whether it is on the solution set there, within the bounds asked for.
    f : float
        Sum of squared residuals there, in double.
    x : tuple of float
        Packed coefficients there.
    """

    index: int
    stages: int
    solved: bool
    f: float
    x: tuple[float, ...] = field(repr=False)
    flows: int | None = None
    tree: Layout | None = field(default=None, repr=False)

    def record(self) -> dict[str, Any]:
        """Return it as plain data, floats in hexadecimal."""
        return {**asdict(self), "f": self.f.hex(), "x": [entry.hex() for entry in self.x]}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Attempt:
        """Read what `record` wrote; ValueError if it isn't that."""
        try:
            x = tuple(map(float.fromhex, record["x"]))
            return cls(
                index=int(record["index"]),
                stages=int(record["stages"]),
                solved=bool(record["solved"]),
                f=float.fromhex(record["f"]),
                x=x,
                flows=None if record["flows"] is None else int(record["flows"]),
                tree=None if record["tree"] is None else _layout(record["tree"]),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"not the record of an attempt: {str(record)[:80]}") from error


@dataclass(frozen=True)
class Construction:
    """What a construction came to.

    Attributes
    ----------
    settings : ConstructionSettings
    method : Method or None
        The exact method, refined in real(16); None if the tries ran out.
    best : Attempt
        The attempt that the method is from, else the one that came furthest: not a
        method of the wanted order and stages.
    tries : int
        Attempts made.
    """

    settings: ConstructionSettings
    method: Method | None
    best: Attempt
    tries: int

    @property
    def exact(self) -> bool:
        """Whether a method was found."""
        return self.method is not None


def construct(
    order: int,
    stages: int,
    seed: int,
    *,
    tries: int = 400,
    largest: float = 3.0,
    restarts: int = 1,
    full_rank: bool = False,
    structure: Structure | None = None,
    first_stages: int | None = None,
    width: float | None = None,
    iterations: int | None = None,
    workers: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[Attempt], None] | None = None,
    force: bool = False,
    tree: Any = None,
    flows: int | None = None,
    first_flows: int | None = None,
    embedded: bool = False,
    first_same_as_last: bool = False,
) -> Construction:
    """Construct an exact explicit method from random starts.

    Each try solves the order conditions from a random guess with enough stages and then
    eliminates stages along the solution set; with `flows`, from a random tree of points with
    enough flows, of which it eliminates flows. The method returned is the one of the
    first successful try by number, whatever the number of workers.

    Parameters
    ----------
    order, stages : int
        What is wanted.
    seed : int
        Not negative; try k depends on (seed, k) alone.
    tries : int, optional
        Random starts at most.
    largest : float, optional
        Bound on the magnitude of coefficients.
    restarts : int, optional
        Walks along the solution set where elimination gets stuck.
    full_rank : bool, optional
        Accept only candidates at which all conditions are independent, which is what a
        certificate without further identities needs.
    structure : Structure, optional
        Simplifying assumptions to look for methods with. By default those of
        `Structure.MIDDLE` from order 6 on, and for fewer stages than the conditions of
        a general method need; none with `full_rank`.
    first_stages : int, optional
        Stages of the random starts; by default what order and structure make easy.
    width : float, optional
        Guesses are uniform in [-width, width]; by default what order and structure ask for.
    iterations : int, optional
        Bound on the solver's steps for a random start, and once more where they lead far
        down; by default what order and structure ask for.
    workers : int, optional
        Threads; all cores by default.
    checkpoint : path, optional
        File that receives every try, and from which an interrupted run goes on; tries
        that are running when it is interrupted are dropped.
    progress : callable, optional
        Called with each `Attempt`.
    force : bool, optional
        Try even where there are fewer unknowns than independent conditions; for trees, than
        conditions where flows commute.
    tree : PointTree, method, or sequence, optional
        Look for a method with this tree of points, as `cg.search` takes it.
    flows : int, optional
        Look for a method of points, `cg.CommutatorFree`, with so many flows. Its tree is drawn,
        or points of the given one are left out until so many remain. The flow to a second
        result doesn't count.
    first_flows : int, optional
        Flows of the trees that are drawn, by default `flows`. Points are left out from there.
    embedded : bool, optional
        With `flows`, whether one more flow, from the result, leads to a second result of order
        one less.
    first_same_as_last : bool, optional
        With `flows`, whether the last stage is at the result, where the next step begins.

    Returns
    -------
    Construction

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range, or there are too few stages.

    Examples
    --------
    >>> construct(order=3, stages=3, seed=1).method.order
    3
    """
    common = (order, stages, seed, largest, restarts, full_rank, structure, first_stages)
    of_points = tree is not None or flows is not None or first_flows is not None
    if of_points:
        settings = _tree_settings(
            *common,
            width,
            iterations,
            force,
            tree,
            flows,
            first_flows,
            embedded,
            first_same_as_last,
        )
    elif check_flag("embedded", embedded):
        raise ValueError("embedded needs a number of flows, got a construction of tableaux")
    elif check_flag("first_same_as_last", first_same_as_last):
        raise ValueError("first_same_as_last needs a number of flows, got one of tableaux")
    else:
        settings = _settings(*common, width, iterations, force)
    tries = check_integer("tries", tries, 1, LARGEST_COUNT)
    if progress is not None and not callable(progress):
        raise TypeError(f"progress must be callable, got {progress!r}")
    workers = available_cores() if workers is None else check_integer("workers", workers, 1)
    header = {"construct": asdict(settings)}
    checkpoint_file = Checkpoint.open(checkpoint, header) if checkpoint is not None else None
    try:
        records = map(Attempt.from_record, checkpoint_file.records if checkpoint_file else ())
        done = {attempt.index: attempt for attempt in records}
        method = None
        for attempt in _in_order(settings, tries, workers, done, checkpoint_file, progress):
            if attempt.solved and _arrived(settings, attempt):
                method = _refined(settings, attempt)
                if method is not None:
                    return Construction(settings, method, attempt, attempt.index + 1)
    finally:
        if checkpoint_file:
            checkpoint_file.close()
    best = min(
        (done[index] for index in range(tries)),
        key=lambda a: (not a.solved, a.stages, a.flows or 0, a.f),
    )
    return Construction(settings, None, best, tries)


def _in_order(
    settings: ConstructionSettings,
    tries: int,
    workers: int,
    done: dict[int, Attempt],
    checkpoint_file: Checkpoint | None,
    progress: Callable[[Attempt], None] | None,
) -> Iterator[Attempt]:
    """Yield attempts by index, running those that aren't done yet as workers get free."""
    missing = [index for index in range(tries) if index not in done]
    running = as_finished(partial(run_attempt, settings), missing, workers)
    try:
        for index in range(tries):
            while index not in done:
                attempt = next(running)
                done[attempt.index] = attempt
                if checkpoint_file:
                    checkpoint_file.append(attempt.record())
                if progress:
                    progress(attempt)
            yield done[index]
    finally:
        running.close()


def run_attempt(settings: ConstructionSettings, index: int) -> Attempt:
    """Run one try alone."""
    random = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    if settings.flows is not None:
        return _run_tree(settings, index, random)
    spread = max(0, settings.first_stages - settings.stages)
    stages = settings.first_stages + (int(random.integers(0, 4)) if spread else 0)
    system = ConditionSystem.tableau(settings.order, stages, structure=settings.structure)
    guess = random_candidate(system, settings.width, random)
    candidate = solve_start(guess, settings.iterations, promising=settings.promising)
    if not _acceptable(settings, candidate):
        return _attempt(settings, index, candidate)
    for smaller in eliminate(
        candidate,
        settings.stages,
        random=random,
        largest=settings.largest,
        restarts=settings.restarts,
        accept=partial(_acceptable, settings),
    ):
        candidate = smaller
    return _attempt(settings, index, candidate)


def _run_tree(settings: ConstructionSettings, index: int, random: np.random.Generator) -> Attempt:
    """Run one try for a method of points."""
    layout = settings.tree
    if layout is None:
        assert settings.first_flows is not None
        layout = draw_layout(
            settings.stages,
            settings.first_flows,
            random,
            embedded=settings.embedded,
            first_same_as_last=settings.first_same_as_last,
        )
    system = ConditionSystem(settings.order, layout)
    guess = random_candidate(system, settings.width, random)
    candidate = solve_start(guess, settings.iterations, promising=settings.promising)
    left = 0
    while _acceptable(settings, candidate) and left <= settings.restarts:
        if _flows(settings, candidate.system.layout) == settings.flows:
            break
        accept = partial(_acceptable, settings)
        smaller = drop_flow(candidate, random, largest=settings.largest, accept=accept)
        if smaller is None:
            left += 1
            candidate = walk(candidate, random, largest=settings.largest)
        else:
            candidate, left = smaller, 0
    return _attempt(settings, index, candidate)


def _flows(settings: ConstructionSettings, layout: Layout) -> int:
    """Return the number of flows that is asked for: second results come on top."""
    return len(layout.parents) - settings.embedded


def _arrived(settings: ConstructionSettings, attempt: Attempt) -> bool:
    return (attempt.stages, attempt.flows) == (settings.stages, settings.flows)


def _acceptable(settings: ConstructionSettings, candidate: Candidate) -> bool:
    if not solved(candidate) or candidate.largest > settings.largest or not refinable(candidate):
        return False
    return not settings.full_rank or candidate.rank == count(settings.order, independent=True)


def _attempt(settings: ConstructionSettings, index: int, candidate: Candidate) -> Attempt:
    good = _acceptable(settings, candidate)
    layout, x = candidate.system.layout, tuple(candidate.x.tolist())
    if layout.rows is not None:
        return Attempt(index, layout.stages, good, candidate.f, x)
    flows = _flows(settings, layout)
    return Attempt(index, layout.stages, good, candidate.f, x, flows, layout)


def _refined(settings: ConstructionSettings, attempt: Attempt) -> Method | None:
    layout = attempt.tree or Layout.tableau(attempt.stages)
    system = ConditionSystem(settings.order, layout, settings.structure)
    candidate = Candidate(system, _array(attempt.x))
    size = f"{settings.stages} stages"
    if settings.flows is not None:
        size += f", {settings.flows} flows"
    try:
        return to_method(
            candidate,
            name=f"order {settings.order}, {size}, try {attempt.index}",
            source=f"construct, seed {settings.seed}, try {attempt.index}",
        )
    except NotExactError:
        return None


def _layout(record: dict[str, Any]) -> Layout:
    return Layout(
        tuple(record["parents"]),
        tuple(map(tuple, record["weights"])),
        tuple(record["stage_points"]),
        tuple(record["results"]),
    )


def _array(x: tuple[float, ...]) -> NDArray[np.float64]:
    return np.array(x, dtype=np.float64)


def _settings(
    order: int,
    stages: int,
    seed: int,
    largest: float,
    restarts: int,
    full_rank: bool,
    structure: Structure | None,
    first_stages: int | None,
    width: float | None,
    iterations: int | None,
    force: bool,
) -> ConstructionSettings:
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MOST_STAGES)
    full_rank = check_flag("full_rank", full_rank)
    if structure is None:
        structure = Structure.GENERAL if full_rank else likely_structure(order, stages)
    system = ConditionSystem.tableau(order, stages, structure=structure)
    if full_rank and system.structure:
        raise ValueError(f"structure must be GENERAL with full_rank, got {system.structure.name}")
    if not check_flag("force", force) and system.free.size < system.equations:
        kind = f" with structure {system.structure.name}" if system.structure else ""
        raise ValueError(
            f"stages = {stages} gives {system.free.size} unknowns for {system.equations} "
            f"independent conditions of order {order}{kind}; pass force=True to try all the same"
        )
    start = default_start(order, system.structure)
    if first_stages is None:
        first_stages = max(stages, start.stages)
    first_stages = check_integer("first_stages", first_stages, stages, MOST_STAGES)
    if width is None:
        width = start.width
    if iterations is None:
        iterations = start.iterations
    return ConstructionSettings(
        order,
        stages,
        check_integer("seed", seed, 0),
        system.structure,
        first_stages,
        check_real("width", width, positive=True, most=WIDEST),
        check_integer("iterations", iterations, 1, LARGEST_COUNT),
        start.promising,
        check_real("largest", largest, positive=True),
        check_integer("restarts", restarts, 0),
        full_rank,
    )


def _tree_settings(
    order: int,
    stages: int,
    seed: int,
    largest: float,
    restarts: int,
    full_rank: bool,
    structure: Structure | None,
    first_stages: int | None,
    width: float | None,
    iterations: int | None,
    force: bool,
    tree: Any,
    flows: int | None,
    first_flows: int | None,
    embedded: bool,
    first_same_as_last: bool,
) -> ConstructionSettings:
    order = check_order(order)
    stages = check_integer("stages", stages, 1, MOST_STAGES)
    for name, value in (("structure", structure), ("first_stages", first_stages)):
        if value:
            raise ValueError(f"{name} is for tableaux, got {value!r} with a tree")
    if flows is None and tree is None:
        raise ValueError("first_flows needs a number of flows to come down to")
    force = check_flag("force", force)
    given = flows if tree is None else None
    layout, most = check_points(order, stages, tree, given, embedded, force, first_same_as_last)
    if layout is not None:
        if first_flows is not None:
            raise ValueError(f"first_flows must be None with a tree, got {first_flows!r}")
        embedded = layout.pair
        first_flows = most - embedded
        least = len({START, *layout.stage_points, layout.results[0]}) - 1
        flows = first_flows if flows is None else check_integer("flows", flows, least, first_flows)
    else:
        flows, first_flows = most, most if first_flows is None else first_flows
    start = tree_start(order)
    return ConstructionSettings(
        order,
        stages,
        check_integer("seed", seed, 0),
        Structure.GENERAL,
        stages,
        check_real("width", start.width if width is None else width, positive=True, most=WIDEST),
        check_integer(
            "iterations", start.iterations if iterations is None else iterations, 1, LARGEST_COUNT
        ),
        start.promising,
        check_real("largest", largest, positive=True),
        check_integer("restarts", restarts, 0),
        check_flag("full_rank", full_rank),
        flows,
        check_integer("first_flows", first_flows, flows, 10 * MOST_STAGES),
        check_flag("embedded", embedded),
        layout,
        check_flag("first_same_as_last", first_same_as_last),
    )
