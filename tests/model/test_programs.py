"""Random programs of calls against the model; see `docs/integration.md`."""

import numpy as np
import pytest
from slow_cases import slow

import cg
from tests.model.__main__ import run
from tests.model.compare import check
from tests.model.drawing import admitted
from tests.model.programs import Input, Program, Zero
from tests.model.spaces import SPACES

COUNT = 10  # programs in one test


@pytest.mark.parametrize("part", [*range(20), *slow(*range(20, 40))])
def test_programs(part):
    outcomes, failed = run(0, range(COUNT * part, COUNT * (part + 1)), shrink=False)
    assert not failed
    # others have no definite answer; were these most of a test, it would compare little
    assert outcomes["compared"] >= 0.5 * COUNT, outcomes


@pytest.mark.parametrize("program", [
    Program(space=0, method="CF5(4)", parameters=True, callers=("in_jax",)),
    Program(space=0, method="RKMK5(4)", turns=0.3, form="time", length=-1.0, parameters=True,
            callers=("in_jax",)),
])  # fmt: skip
def test_in_jax(program):
    pytest.importorskip("diffrax")
    assert program == admitted(program)
    assert check(program) == "compared"


def test_output_does_not_change_which_events_are_found():
    """Two near zeros were sought along a cubic without output, along the interpolant with it."""
    program = Program(
        space=12, seed=34, turns=1.8, speed=5.0, start=1e5, length=-1.0, method="CF5(4)", steps=3.0,
        dense=True, observe=True, breaks=(0.5,), parameters=True, callers=("ensemble",),
        events=(Zero("plane", 0.1, 6, jump="other"), Zero("plane", 0.1, 10, 2, 1),
                Zero("copy", 0.9, 0, 2, -1)),
        inputs=(Input("hold", 5, 5, 1e-5),),
    )  # fmt: skip
    assert check(program) == "compared"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 201))
def test_many_programs(seed):
    outcomes, failed = run(seed, range(250))
    assert not failed
    assert outcomes["compared"] > 200


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.expression[10:40])
def test_fields_of_the_model_are_those_of_the_frames(space):
    names = {"cg": cg, "np": np}
    exec(space.prelude, names)
    frame = eval(space.expression, names)
    y = space.start(3)
    assert np.shape(y) == frame.point_shape
    assert frame.membership_error(y) < 1e-12
    if not space.phase and space.returned == (-1,):
        v = np.random.default_rng(1).standard_normal(space.dim)
        np.testing.assert_allclose(space.field(v, y), frame.field(v, y), atol=1e-14)
