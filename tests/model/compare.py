"""Runs of a program, compared with the model and with each other.

Each run is a text that is executed behind the program's script. `Difference` contains this text,
so that both together show what differs.
"""

import concurrent.futures
import concurrent.futures.process
import multiprocessing
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import numpy as np

from tests.model import scripts
from tests.model.accuracy import (
    EVENTS,
    Case,
    Difference,
    Unclear,
    accurate,
    bound_of,
    near,
    raise_if_singular,
)
from tests.model.derivatives import derivatives, in_jax
from tests.model.drawing import SPLITTINGS
from tests.model.programs import Program
from tests.model.reference import solve
from tests.model.scripts import CALL

COUNTS = "steps", "nrejected"
DERIVATIVES = ("transition", "sensitivity", "covariance")
EVALUATIONS = ("nfev", "nexp", "njev", "nlu")


def check(program: Program) -> str:
    """Compare a program with the model; return "compared", or why there is no answer."""
    try:
        names = program.build()
        case = Case(program, names, solve(program.task(names)))
    except ArithmeticError:
        return "the model has no solution"
    except ModuleNotFoundError as error:  # numba is an extra
        return str(error)
    if program.endless and not case.path.terminated:
        return "no event ends it"
    outcome = "compared"
    with warnings.catch_warnings():
        warnings.simplefilter("error" if not program.steps else "ignore")
        # stages beyond the domain of f; what is normal to a sphere by rounding
        warnings.filterwarnings("ignore", "invalid value encountered in sqrt")
        warnings.filterwarnings("ignore", "f returns derivatives with a part")
        try:
            case.solution, case.bound = case.solve(), bound_of(case)
        except Unclear as reason:
            return str(reason)
        # where the solution fails callers may raise what it returns
        callers = [CALLERS[name] for name in program.callers if case.solution.success]
        for compare in (*ALWAYS, *callers):
            try:
                compare(case)
            except Unclear as reason:
                outcome = str(reason)
    return outcome


# Comparisons of runs with each other


def same(ours: Any, theirs: Any, names: Sequence[str], code: str) -> None:
    """Raise unless attributes are equal to the bit."""
    for name in names:
        pair = [getattr(solution, name) for solution in (ours, theirs)]
        a, b = (value if isinstance(value, list) else [value] for value in pair)
        if len(a) != len(b) or not all(map(np.array_equal, a, b)):
            lines = f"{CALL}\nprint(s.{name})\n{code}\nprint(s.{name})"
            raise Difference(name, f"{name} is {pair[0]}, in the other run {pair[1]}", lines)


def alone(case: Case) -> None:
    accurate(case, case.solution, CALL)


def observed(case: Case) -> None:
    """Numbers at output times in place of points; and as many calls of f as ``nfev`` says."""
    if not case.program.observe:
        return
    code = scripts.OBSERVED.replace("STORE", "'all'" if case.program.derivatives else "'observed'")
    code = code.replace("NAME", "f" if case.program.compiled else "counted")
    run, solution = case.run(code), case.solution
    s = run["s"]
    own = [run["observe"](t, y) for t, y in zip(solution.t, solution.y, strict=True)]
    if not np.array_equal(s.observed, np.array(own).reshape(s.observed.shape)):
        raise Difference("observed", "observed isn't the function of the points", code)
    same(solution, s, ("t", "nfev", *EVENTS, *COUNTS), code)
    calls = run["calls"][0]
    # calls of compiled functions aren't seen, differences and the search for friction not counted,
    # and f is evaluated again for the message of a failure
    exempt = case.program.compiled or case.program.derivatives == "forward" or not s.success
    if calls != s.nfev and not exempt and case.program.method not in SPLITTINGS:
        raise Difference("nfev", f"nfev is {s.nfev}, there are {calls} calls", code)


def same_without_output(case: Case) -> None:
    program, solution = case.program, case.solution
    if program.output is None and not program.dense:
        return
    code = CALL.replace("**options", "**{**options, 't_eval': None, 'dense_output': False}")
    plain = case.solve(code)
    same(solution, plain, (*EVENTS, *COUNTS), code)
    of_events = {t for times in plain.t_events or () for t in times}
    at_steps = {t: y for t, y in zip(plain.t, plain.y, strict=True) if t not in of_events}
    for t, y in zip(solution.t, solution.y, strict=True):
        if t in at_steps and not np.array_equal(y, at_steps[t]):
            text = f"the point at the end of a step, {t!r}, changes with output"
            raise Difference("output", text, CALL)


def with_fixed_steps(case: Case) -> None:
    """`integrate` takes the steps of `solve_ivp`."""
    if not case.program.steps:
        return
    code = CALL.replace("solve_ivp", "integrate")
    same(case.solution, case.solve(code), ("t", "y", "nfev", "nexp", *DERIVATIVES), code)


def stepper_steps(case: Case) -> None:
    """Steps of a `Stepper`, copied, pickled and continued, are those of `solve_ivp`."""
    if any(zero.jump and zero.terminal for zero in case.program.events):
        return  # a stepper makes the last jump too
    code = f"COPIES, DENSE = {case.program.compiled == 'numba'}, False\n"
    code += scripts.STEPPER + scripts.STEPS
    plain = case.solve(f"{scripts.STEPPING}s = cg.solve_ivp(g, span, y0, **stepping)")
    run = case.run(code)
    grid = np.linspace(*case.path.task.span, int(case.program.steps) + 1)
    stops = (*case.path.task.breakpoints, *case.path.task.knots, *grid)
    ends = (*case.path.jumps, case.path.end) if case.path.terminated else case.path.jumps
    met = any(abs(t - stop) < 1e-9 * case.length for t in ends for stop in stops)
    # a stepper keeps the interpolant of a step at whose end the solution jumps or ends
    same(plain, run["s"], EVENTS if met else (*EVENTS, *EVALUATIONS, "nrejected"), code)
    t, y = np.array(run["t"]), np.array(run["y"])
    if not np.array_equal(plain.y, y):
        lines = f"{CALL}\nprint(s.y)\n{code}\nprint(y)"
        raise Difference("y", "points of a Stepper differ", lines)
    if not np.array_equal(plain.t, t):
        lines = f"{CALL}\nprint(s.t)\n{code}\nprint(t)"
        raise Difference("t", "times of a Stepper differ", lines)


def stepper_advances(case: Case) -> None:
    """A `Stepper` advances to times, restarts there, then earlier, then from another point."""
    program, task = case.program, case.path.task
    if program.steps or program.length == 0 or case.jumps():
        return  # other fixed steps have no bound; with jumps, `stepper_of_members` restarts
    if any(zero.terminal for zero in program.events):
        return  # `advance` may stop before its goal
    times = [program.at(share) for share in (0.31, 0.77, 1.0)]
    code = scripts.STEPPER + scripts.GOALS.replace("GOALS", str(times))
    near(case, times, case.run(code)["y"], code)
    earlier = f"s.restart(t={times[0]!r}, y=y[0])\ns.advance({times[1]!r})\ny = [s.y]\n"
    near(case, [times[1]], case.run(code + earlier)["y"], code + earlier)
    rest = tuple(0.9 * value for value in task.rest)
    changed = f"t={times[0]!r}, y=other{', parameters=0.9 * parameters' * program.parameters}"
    code += f"s.restart({changed})\ns.advance({times[2]!r})\ny = [s.y]\n"
    moved = solve(replace(
        task, span=(times[0], times[2]), y0=case.names["other"], rest=rest, events=()
    ))  # fmt: skip
    other = replace(case, path=moved, program=replace(program, events=()))
    near(other, [times[2]], case.run(code)["y"], code)


def stepper_of_members(case: Case) -> None:
    """Members of a `Stepper` are those of `solve_ensemble`, and of single steppers."""
    program, events = case.program, case.program.events
    if program.steps and program.turns > 2.0 and program.frame.phase:
        raise Unclear("momenta along points of spheres are errors of long steps, and are refused")
    ways = ("", *scripts.VECTORIZED[: not program.compiled])
    ways += scripts.EVENTS_TOGETHER[: len(ways)] if events else ()
    way = ways[program.seed % len(ways)]
    copied = program.compiled == "numba" or "many" in way
    # an edge ends the third part, and the last one would begin there
    goals = [program.at(share) for share in (0.31, 0.77, 0.77, 1.0)[: 4 - program.edge]]
    values = copied, program.dense or program.endless, EVALUATIONS, EVENTS if events else (), goals
    begin = f"{_data_of_members(program)}COPIES, DENSE, EVALUATIONS, EVENTS, GOALS = {values}\n"
    last_jump = any(zero.jump and zero.terminal for zero in events)  # a single stepper makes it too
    for code in (
        scripts.COMMON_STEPS * (not case.jumps()),  # refused
        scripts.OWN_STEPS * (not program.endless),
        scripts.SINGLE * (program.length != 0 and not last_jump),
    ):
        case.run(begin + code.replace("WAY", way))


@cache
def pool() -> concurrent.futures.Executor:
    return concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))


def in_processes(case: Case) -> None:
    """Members are integrated by another process."""
    if case.program.compiled == "numba":  # which can't be pickled
        return
    try:
        pool().submit(int)
    except concurrent.futures.process.BrokenProcessPool:  # by a program before
        pool.cache_clear()
    case.names["pool"] = pool()
    ensemble(case, (", executor=pool",), (), scripts.POOL)


def in_scipy(case: Case) -> None:
    """The solver of a frame for SciPy's loop."""
    raise_if_singular(case)  # derivatives have as few digits
    program = case.program
    times = program.times((0.0, 0.2, 0.37, 0.8, 1.0))
    code = scripts.SCIPY.replace("TIMES", str(times))
    code = code.replace("REST", "(parameters,)" if program.parameters else "()")
    near(case, 2 * times, case.run(code)["y"], code)


def _data_of_members(program: Program) -> str:
    """Return the code of options of three members, of which the second has its own."""
    code = f"{scripts.TOGETHER}several, second, swapped = dict(options), dict(options), {{}}\n"
    for name, of in (("members", "several"), ("mirrored", "second"), ("swapped", "swapped")):
        if program.inputs:
            code += f"{of}['inputs'] = {program.named_inputs(name)}\n"
    if program.parameters:
        code += f"second['parameters'] = {1.0 if program.endless else 0.9} * parameters\n"
        code += "several['parameters'] = np.stack([parameters, second['parameters'], parameters])\n"
        code += "swapped['parameters'] = several['parameters'][[1, 0, 1]]\n"
    return code


def ensemble(
    case: Case,
    ways: Sequence[str] = ("", ", workers=2", *scripts.VECTORIZED, *scripts.EVENTS_TOGETHER),
    common: Sequence[str] = (
        ", common_steps=True",
        ", common_steps=True, vectorized=True",
        " | many, common_steps=True",
    ),
    begin: str = "",
) -> None:
    """Members of an ensemble are equal to single solutions, however they are computed.

    Of the ways to compute them some are chosen at random, and other ones by other programs.
    """
    program, rng = case.program, Random(case.program.seed)
    code = begin + _data_of_members(program)
    ways, common = ([way for way in each if (program.events or "many" not in way)
                     and not (program.compiled and "vectorized" in way)]
                    for each in (ways, common))  # fmt: skip
    if program.endless and program.output is None and not program.dense:
        code += "several['t_eval'] = [span[0]]\n"
    apart = program.inputs and program.seed % 2 == 1  # a list of inputs, with times of their own
    if apart:
        code += f"second['inputs'] = {program.named_inputs('moved')}\n"
        code += "several['inputs'] = [each['inputs'] for each in (options, second, options)]\n"
    single = case.solve(code + CALL.replace("y0, **options", "other, **second"))
    code += "s = cg.solve_ensemble(f, span, np.stack([y0, other, y0]), **several"
    for way in rng.sample(ways, min(2, len(ways))):
        s = case.solve(f"{code}{way})")
        if "vectorized" in way and program.derivatives:  # differences of other roundings
            accurate(case, s[0], f"{code}{way})[0]")
            continue
        for i, own in enumerate((case.solution, single, case.solution)):
            # without times of output an ensemble stores the ends alone
            compared = ("t", "y", *DERIVATIVES, *EVALUATIONS) if program.output is not None else ()
            same(own, s[i], (*compared, *EVENTS, *COUNTS), f"{code}{way})[{i}]")
            if own.status == 0 and not np.array_equal(s[i].y[-1:], own.y[-1:]):
                text = f"the end of member {i} differs"
                raise Difference("end", text, f"{code}{way})\nprint(s.y)")
    if case.jumps() or apart:
        return  # refused with common steps
    for way in rng.sample(common, min(1, len(common))):
        s = case.solve(f"{code}{way})")
        same(s[0], s[2], ("t", "y", *EVENTS), f"{code}{way})")
        if not program.endless:
            accurate(case, s[0], f"{code}{way})[0]")


ALWAYS = alone, observed, same_without_output, with_fixed_steps, derivatives
CALLERS = {
    caller.__name__: caller
    for caller in (
        stepper_steps,
        stepper_advances,
        ensemble,
        stepper_of_members,
        in_processes,
        in_scipy,
        in_jax,
    )
}
