"""The time that compiled code runs between checks for interrupts."""

from itertools import pairwise

import pytest

from cg.integration.loop import drive
from cg.integration.loop.drive import StepBudget


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(drive.time, "perf_counter", lambda: now[0])
    return now


@pytest.mark.parametrize("seconds_a_step", [1e-7, 1e-3, 1.0])
def test_pauses_come_to_the_same_time(seconds_a_step, clock):
    chosen = StepBudget()
    sizes = []
    for _ in range(12):
        sizes.append(chosen.start())
        clock[0] += sizes[-1] * seconds_a_step
        chosen.stop(sizes[-1])
    assert sizes[0] == 1
    assert max(b / a for a, b in pairwise(sizes)) <= 8
    assert sizes[-1] == pytest.approx(max(1, 0.03 / seconds_a_step), abs=1)


def test_budget_after_short_runs(clock):
    chosen = StepBudget()
    for _ in range(100):  # trajectories of five steps
        steps = min(chosen.start(), 5)
        clock[0] += steps * 1e-4
        chosen.stop(steps)
    assert chosen.start() == pytest.approx(300, abs=1)


def test_steps_that_take_no_time_are_counted_in_32_bits(clock):
    chosen = StepBudget()
    for _ in range(50):
        chosen.stop(chosen.start())
    assert chosen.start() == 2**30
