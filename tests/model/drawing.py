"""What hypothesis draws: everything at once, without what the documentation refuses."""

from dataclasses import replace

from hypothesis import strategies as st

from tests.model.programs import FIXED, PAIRS, SPLITTINGS, Input, Program, Zero
from tests.model.spaces import SPACES

SHARES = (0.0, 0.03, 0.1, 0.25, 0.3, 0.5, 0.51, 0.7, 0.75, 0.97, 1.0)
OUTSIDE = ("CG4", "CF6d", "CF7(6)")  # stages outside the step are refused with inputs
LOW_ORDER = ("BS3(2)", "CG2(3)", "CG3(2)", "RKMK3(2)", "CF4(3)", "CG4(3)")
CALLERS = ("solve_ivp", "stepper", "ensemble", "variational", "adjoint", "linear")

zeros = st.builds(
    Zero,
    kind=st.sampled_from(("plane", "plane", "plane", "time", "copy")),
    place=st.sampled_from((0.1, 0.25, 0.3, 0.5, 0.55, 0.7, 0.9)),
    seed=st.integers(0, 20),
    terminal=st.sampled_from((0, 0, 0, 1, 2)),
    direction=st.sampled_from((0, 0, 1, -1)),
    jump=st.sampled_from(("", "", "start", "other")),
)

samples = st.builds(
    Input,
    kind=st.sampled_from(("hold", "linear", "cubic", "averages", "causal")),
    count=st.sampled_from((4, 5, 7, 12)),
    seed=st.integers(0, 20),
    scale=st.sampled_from((1.0, 1.0, 1e5, 1e-5)),
    idle=st.sampled_from((False, False, False, True)),
)


@st.composite
def programs(draw) -> Program:
    """Draw a program."""
    space = draw(st.integers(0, len(SPACES) - 1))
    frame = SPACES[space]
    start = draw(st.sampled_from((0.0, 0.0, 0.0, -2.0, 1.5, 1e5)))
    length = draw(st.sampled_from((1.0, 1.0, -1.0, 2.5, -2.5, 1e-6, 1e4, -1e4, 0.0)))
    events = tuple(draw(st.lists(zeros, max_size=3)))
    program = Program(
        space=space,
        seed=draw(st.integers(0, 50)),
        form=draw(st.sampled_from(("state", "state", "state", "time", "constant"))),
        turns=draw(st.sampled_from((0.0, 0.3, 1.0, 3.0, 8.0, 30.0))),
        speed=draw(st.sampled_from((0.0, 1.0, 5.0))),
        start=start,
        length=length if abs(length) > 1e-3 or start < 1e3 else 1.0,
        output=draw(st.none() | st.lists(st.sampled_from(SHARES), max_size=6).map(tuple)),
        dense=draw(st.booleans()),
        observe=draw(st.booleans()),
        events=events,
        breaks=tuple(draw(st.sets(st.sampled_from((0.3, 0.31, 0.5, 0.75)), max_size=2))),
        inputs=tuple(draw(st.lists(samples, max_size=2))),
        parameters=draw(st.booleans()),
        compiled=frame.compiled and draw(st.booleans()),
        caller=draw(st.sampled_from(CALLERS)),
    )
    return _admitted(draw, _with_method(draw, program))


def _with_method(draw, program: Program) -> Program:
    frame = program.frame
    methods = PAIRS
    if draw(st.integers(0, 3)) == 0:
        methods = FIXED + SPLITTINGS * frame.phase
        program = replace(program, steps=draw(st.sampled_from((3.0, 10.0, 20.3))))
    else:
        rtol, atol = draw(st.sampled_from(((1e-3, 1e-6), (1e-5, 1e-5), (1e-6, 1e-9), (1e-9, 1e-9))))
        program = replace(program, rtol=rtol, atol=atol)
    program = replace(program, method=draw(st.sampled_from(methods)))
    if program.method in LOW_ORDER and min(program.rtol, program.atol) < 1e-6:
        program = replace(program, rtol=1e-5, atol=1e-6)  # fewer steps
    return program


def _admitted(draw, program: Program) -> Program:
    """Return the program without what is refused, has no single answer, or takes long."""
    frame, changes = program.frame, {}
    inputs = tuple(replace(u, count=200) if u.idle else u for u in program.inputs)
    many = program.caller in ("ensemble", "variational", "adjoint")
    if not frame.compiled or many or abs(program.length) < 1e-3:  # flows and pieces take long
        inputs = tuple(replace(u, count=min(u.count, 5), idle=False) for u in program.inputs)
    changes["inputs"] = inputs
    if program.turns > 10.0 and program.form == "state":  # errors grow
        changes["turns"] = 2.0
    if not frame.brackets and program.method.startswith(("RKMK", "Radau")):
        changes["method"] = "CF5(4)"
    if program.method in SPLITTINGS and program.form == "state":  # friction
        changes["form"] = "time"
    if program.compiled:
        changes["parameters"] = False
    if frame.phase and abs(program.length) > 10.0:  # they move freely
        changes["length"] = program.length / 1e4
    if program.length == 0.0:
        changes |= {"output": None, "breaks": (), "inputs": (), "events": (), "steps": 0.0}
        changes["method"] = "auto"
    if program.caller == "linear":
        changes |= {"compiled": False, "form": "time", "steps": 0.0, "method": "auto"}
    terminal = program.length and any(zero.terminal == 1 for zero in program.events)
    if terminal and not program.steps and not program.inputs and draw(st.booleans()):
        changes |= {"endless": True, "breaks": ()}
    return replace(program, **changes)
