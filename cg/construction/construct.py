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
from ..conditions import HIGHEST_ORDER, count
from ..method import Method
from ..parallel import as_finished, available_cores
from ..solve.system import ConditionSystem, Structure
from .candidate import Candidate, NotExactError, refinable, solved, to_method
from .drop import solve_start
from .eliminate import eliminate
from .start import default_start, likely_structure, random_candidate

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


@dataclass(frozen=True)
class Attempt:
    """One random start and how far down it came.

    Attributes
    ----------
    index : int
        With the seed it determines everything else.
    stages : int
        Fewest stages reached.
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
) -> Construction:
    """Construct an exact explicit method from random starts.

    Each try solves the order conditions from a random guess with enough stages and then
    eliminates stages along the solution set. The method returned is the one of the
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
        Try even where there are fewer unknowns than independent conditions.

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
    settings = _settings(
        order,
        stages,
        seed,
        largest,
        restarts,
        full_rank,
        structure,
        first_stages,
        width,
        iterations,
        force,
    )
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
            if attempt.solved and attempt.stages == settings.stages:
                method = _refined(settings, attempt)
                if method is not None:
                    return Construction(settings, method, attempt, attempt.index + 1)
    finally:
        if checkpoint_file:
            checkpoint_file.close()
    best = min((done[index] for index in range(tries)), key=lambda a: (not a.solved, a.stages, a.f))
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


def _acceptable(settings: ConstructionSettings, candidate: Candidate) -> bool:
    if not solved(candidate) or candidate.largest > settings.largest or not refinable(candidate):
        return False
    return not settings.full_rank or candidate.rank == count(settings.order, independent=True)


def _attempt(settings: ConstructionSettings, index: int, candidate: Candidate) -> Attempt:
    good = _acceptable(settings, candidate)
    return Attempt(index, candidate.system.stages, good, candidate.f, tuple(candidate.x.tolist()))


def _refined(settings: ConstructionSettings, attempt: Attempt) -> Method | None:
    system = ConditionSystem.tableau(settings.order, attempt.stages, structure=settings.structure)
    candidate = Candidate(system, _array(attempt.x))
    try:
        return to_method(
            candidate,
            name=f"order {settings.order}, {settings.stages} stages, try {attempt.index}",
            source=f"construct, seed {settings.seed}, try {attempt.index}",
        )
    except NotExactError:
        return None


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
    order = check_integer("order", order, 1)
    if order > HIGHEST_ORDER:
        raise ValueError(f"order must be at most {HIGHEST_ORDER} in this build, got {order}")
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
