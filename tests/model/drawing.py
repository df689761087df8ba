"""Random programs: everything at once, without what the documentation refuses; and simpler ones."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from random import Random
from typing import Any

from tests.model.programs import Input, Program, Zero
from tests.model.spaces import SPACES

PAIRS = (
    "auto", "BS3(2)", "CF4(3)", "CF5(4)", "CF6(5)", "CG2(3)", "CG3(2)", "CG4(3)", "CG5(4)",
    "CG6(5)", "DP5(4)", "DVERK6(5)", "DOP853", "Verner7(6)", "RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)",
    "RadauIIA5",
)  # fmt: skip
LOW_ORDER = ("BS3(2)", "CG2(3)", "CG3(2)", "RKMK3(2)", "CF4(3)", "CG4(3)")
FIXED = (
    "LieEuler", "CG2", "CG3", "CF3", "CF4", "CF4b", "CG4b", "CF5(4)", "CF5r", "RKMK4", "RKMK5(4)",
    "RKMK8(5,3)", "ImplicitMidpoint", "DICG4b",
)  # fmt: skip
SPLITTINGS = ("Leapfrog", "McLachlan2", "BlanesMoan4", "BlanesMoan6")
CALLERS = (
    "stepper_steps", "stepper_advances", "ensemble", "stepper_of_members", "in_processes",
    "in_scipy",
)  # fmt: skip
SHARES = (0.0, 0.03, 0.1, 0.25, 0.3, 0.5, 0.51, 0.7, 0.75, 0.97, 1.0)


def program(seed: int, index: int) -> Program:
    """Return a program; each can be drawn alone."""
    rng = Random(f"{seed} {index}")

    def one(*values: Any) -> Any:
        return rng.choice(values)

    def some(max_count: int, item: Callable[[], Any]) -> tuple[Any, ...]:
        return tuple(item() for _ in range(rng.randint(0, max_count)))

    def zero() -> Zero:
        return Zero(
            kind=one("plane", "plane", "plane", "time", "copy", "input"),
            place=one(0.1, 0.25, 0.3, 0.5, 0.55, 0.7, 0.9),
            seed=rng.randint(0, 20),
            terminal=one(0, 0, 0, 1, 2),
            direction=one(0, 0, 1, -1),
            jump=one("", "", "y0", "other"),
            period=one(False, False, False, True),
        )

    def samples() -> Input:
        return Input(
            kind=one("hold", "linear", "cubic", "averages", "causal"),
            count=one(4, 5, 7, 12),
            seed=rng.randint(0, 20),
            scale=one(1.0, 1.0, 1e5, 1e-5),
            idle=one(False, False, False, True),
            members=one(False, True),
        )

    space, fixed = rng.randrange(len(SPACES)), one(False, False, False, True)
    start, length = one(0.0, 0.0, -2.0, 1.5, 1e5), one(1.0, -1.0, 2.5, -2.5, 1e-6, 1e4, -1e4, 0.0)
    rtol, atol = one((1e-3, 1e-6), (1e-5, 1e-5), (1e-6, 1e-9), (1e-9, 1e-9))
    return admitted(Program(
        space=space, seed=rng.randint(0, 50), start=start,
        length=length if abs(length) > 1e-3 or start < 1e3 else 1.0,
        form=one("state", "state", "state", "time", "constant"),
        turns=one(0.0, 0.3, 1.0, 3.0, 8.0, 30.0), speed=one(0.0, 1.0, 5.0),
        endless=one(False, True),
        method=one(*(FIXED + SPLITTINGS * (5 * SPACES[space].phase) if fixed else PAIRS)),
        steps=one(3.0, 10.0, 20.3) if fixed else 0.0,
        rtol=rtol, atol=atol, arrays=one("", "", "atol", "rtol, atol"),
        first_step=one(0.0, 0.0, 1e-3, 0.4), max_step=one(0.0, 0.0, 0.13),
        output=one(None, some(6, lambda: one(*SHARES))),
        dense=one(False, True), observe=one(False, True),
        events=(*some(3, zero), *one((), (), (), (Zero("edge"),))),
        breaks=one((), (0.3,), (0.31, 0.75), (0.5, 0.31)), inputs=some(2, samples),
        parameters=one(False, True), compiled=one("", "", "", "c", "c", one("c", "numba")),
        rhs=one("coefficients", "coefficients", "derivative"),
        linear=one(False, False, False, True), derivatives=one("", "", "forward", "adjoint"),
        # compiling for JAX takes seconds, so that few programs do; `test_in_jax` has others
        callers=some(1, lambda: one(*CALLERS)) if rng.random() > 0.001 else ("in_jax",),
    ))  # fmt: skip


def admitted(program: Program) -> Program:
    """Return the program without what is refused, has no single answer, or takes long.

    The order of the changes matters: callers and the length of the span decide first, then the
    method, what f depends on, derivatives, inputs, and events, which depend on all of these. Each
    condition is that of the program as the changes before have left it.
    """
    frame, callers = program.frame, sorted(program.callers)
    real = frame.base.dtype.kind != "c" and not frame.phase and frame.returned == (-1,)
    in_jax = real and not frame.prelude and "Coadjoint" not in frame.expression
    in_scipy = not frame.phase and frame.returned == (-1,)
    for host, takes in (("in_jax", in_jax), ("in_scipy", in_scipy)):
        if host in callers and (not takes or program.length == 0):
            callers.remove(host)
    hosted = "in_jax" in callers or "in_scipy" in callers

    def change(condition: Any, **changes: Any) -> None:
        """Change fields of the program if a condition holds."""
        nonlocal program
        program = replace(program, **changes) if condition else program

    change(not frame.compiled, compiled="")
    change(hosted, events=(), breaks=(), inputs=(), compiled="", steps=0.0)
    change(hosted, arrays="", linear=False)
    change("in_jax" in callers and program.method not in PAIRS[1:-1], method="CF5(4)")
    change("in_scipy" in callers and program.method not in PAIRS[:-1], method="auto")
    change(program.steps, first_step=0.0, max_step=0.0, arrays="", rtol=1e-6, atol=1e-6)
    change(program.length == 0.0, output=None, breaks=(), inputs=(), events=(), steps=0.0)
    change(program.length == 0.0, method="auto", first_step=0.0, max_step=0.0)
    slow = program.method in LOW_ORDER and min(program.rtol, program.atol) < 1e-5
    change(slow, rtol=1e-4, atol=1e-5)
    change(program.turns > 10.0 and program.form == "state", turns=2.0)  # errors grow
    change(not frame.brackets and program.method.startswith(("RKMK", "Radau")), method="CF5(4)")
    change(program.method in SPLITTINGS and program.form == "state", form="time")  # friction
    change(frame.phase and abs(program.length) > 10.0, length=program.length / 1e4)  # free motion
    plain = not frame.phase and frame.returned == (-1,) and program.method != "RadauIIA5"
    plain = plain and not any(zero.kind == "edge" for zero in program.events)
    change(program.linear, linear=plain)
    change(program.linear, compiled="", form="time" if program.form == "state" else program.form)
    change(program.linear or program.compiled or not plain, rhs="coefficients")
    change(hosted or "Stiefel" in program.frame.expression, rhs="coefficients")
    jointed = "joints" in frame.expression  # of which long steps fail, and tangents are constrained
    change(jointed and program.method in SPLITTINGS, method="Leapfrog")
    change(jointed and program.steps, turns=min(program.turns, 1.0))
    change(jointed, derivatives="")
    smooth = frame.brackets and program.method != "RadauIIA5" and program.length != 0
    change(not smooth or program.method in SPLITTINGS or hosted, derivatives="")
    change(program.linear and program.derivatives, derivatives="adjoint")
    rough = program.start == 1e5 or abs(program.start) > 1e5 * abs(program.length)  # large phases
    change(rough and program.derivatives == "forward" and program.rtol < 1e-6, rtol=1e-6, atol=1e-6)
    change(program.derivatives == "adjoint", events=(), output=program.output or None)
    if program.derivatives == "adjoint":
        callers = [caller for caller in callers if caller not in ("ensemble", "in_processes")]
    inputs = program.inputs
    if abs(program.length) < 1e-3 or program.derivatives or callers or not frame.compiled:  # slow
        inputs = tuple(replace(u, count=min(u.count, 5), idle=False) for u in inputs)
    inputs = tuple(replace(u, count=200) if u.idle else u for u in inputs)
    events = [zero for zero in program.events if zero.kind != "edge" or not program.steps]
    edge = any(zero.kind == "edge" for zero in events)
    finite = program.steps or inputs or program.length == 0
    endless = program.endless and not finite and any(zero.terminal == 1 for zero in events)
    continuous = inputs and inputs[0].kind in ("linear", "cubic", "averages")
    for k, zero in enumerate(events):
        if (zero.kind == "input" and not continuous) or (
            zero.kind == "copy" and (k == 0 or events[k - 1].period)
        ):
            events[k] = replace(zero, kind="plane")
        if zero.period and (endless or zero.kind == "copy"):
            events[k] = replace(events[k], period=False)
        if zero.jump == "other" and edge:
            events[k] = replace(events[k], jump="y0")
        # no contact rests at y0, where copies may have zeros of their originals, nor does an input
        # lead to one, before which events would follow each other ever faster
        for j in range(k + 1) if events[k].jump == "y0" or program.turns == 0.0 else ():
            near = events[j].place in ((0.5, 0.55) if continuous else (0.5,))
            events[j] = replace(events[j], place=0.3 if near else events[j].place)
        if zero.kind == "edge":
            events[k] = Zero("edge", 0.1, terminal=1)
    change(endless, breaks=(), turns=min(program.turns, 8.0))
    return replace(
        program, events=tuple(events), inputs=inputs, endless=endless, callers=tuple(callers)
    )


def simpler(record: Any) -> Iterator[Any]:
    """Yield a program, or what it contains, with one thing less or as by default."""
    for field in fields(record):
        value = getattr(record, field.name)
        options = [field.default, 0.0 if isinstance(value, float) else field.default]
        if isinstance(value, tuple):
            options += [value[:k] + value[k + 1 :] for k in range(len(value))]
            options += [
                (*value[:k], item, *value[k + 1 :])
                for k, whole in enumerate(value) if is_dataclass(whole) for item in simpler(whole)
            ]  # fmt: skip
        for option in options:
            if option != value and len(repr(new := replace(record, **{field.name: option}))) < len(
                repr(record)
            ):
                yield new


def simplest(program: Program, fails: Callable[[Program], bool], trials: int = 150) -> Program:
    """Return a program that fails, of which no simpler one does, or not within some trials."""
    for candidate in map(admitted, simpler(program)):
        if trials > 0 and len(repr(candidate)) < len(repr(program)):
            trials -= 1
            if fails(candidate):
                return simplest(candidate, fails, trials)
    return program
