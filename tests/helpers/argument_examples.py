"""Calls of everything public that work, whose arguments `test_fuzz_arguments.py` exchanges."""

import inspect
from collections.abc import Callable
from fractions import Fraction
from importlib.util import find_spec
from typing import Any, NamedTuple

import matplotlib.figure
import numpy as np

import cg
from cg import conditions, frames, plot
from cg.construction import candidate, catalogue, eliminate, optimise
from cg.construction import proofs as certification
from cg.construction.methods import low_storage, stability
from cg.construction.plots import text as drawing
from cg.construction.trees import ordered as trees
from cg.support import quads
from research import impossibility


class Call(NamedTuple):
    """A function with arguments that are right, and the errors of its errors."""

    function: Callable[..., Any]
    arguments: dict[str, Any]
    errors: tuple[type[Exception], ...] = ()


def call(function: Callable[..., Any], /, *errors: type[Exception], **arguments: Any) -> Call:
    """Return a call whose other arguments have their defaults."""
    parameters = inspect.signature(function).parameters.values()
    defaults = {p.name: p.default for p in parameters if p.default is not p.empty}
    return Call(function, defaults | arguments, errors)


def by_name(calls: list[Call]) -> dict[str, Call]:
    """Return calls by the module and the name of their functions."""
    named = {}
    for one in calls:
        module = one.function.__module__.removeprefix("cg.")
        name = f"{module}.{one.function.__qualname__}"
        named[f"{name}, again" if name in named else name] = one
    return named


RNG = np.random.default_rng(0)
PAIR, CG3, CF4 = cg.methods["CG4(3)"], cg.methods["CG3"], cg.methods["CF4"]
CERTIFICATE = cg.certify("CG3")
TREE = trees.OrderedTree.parse("[[]]")
SO3 = frames.SO3()
X = np.linspace(0.1, 0.6, 6)
CANDIDATE = candidate.pack_method(CG3)
SOLVED = cg.solve_ivp(lambda t, y: [0.1, 0.2, 0.3], (0, 1), np.eye(3), frame=SO3, dense_output=True)


def turning(t, y, *numbers):
    return np.stack([0.3 + 0.0 * t, -0.2 * np.cos(t), 0.1 + 0.0 * t], axis=-1)


def event(t, y, *numbers):
    return t - 0.7


def stay(t, y, *numbers):
    return y


def jac(t, y, *numbers):
    return np.zeros((3, 3))


def df_dp(t, y, *numbers):
    return np.zeros((3, len(numbers[-1])))


def residual(x):
    return np.array([x[0] - 1.0, x[1] + 2.0])


def axes():
    return matplotlib.figure.Figure().add_subplot()


def constant_in_time(t, *args):
    return [0.1, 0.2, 0.3]


EULER = {"a": [[0.0, 0.0], [0.5, 0.0]], "b": [0.0, 1.0], "order": 3}
AT_X = {"a": CG3.layout, "b": X, "order": 3}
SHORT = {"f": turning, "t_span": (0.0, 0.5), "y0": np.eye(3), "frame": SO3}
TWO = SHORT | {"y0": np.stack([np.eye(3)] * 2)}
LONG = SHORT | {"t_span": (0.0, 1.0)}
CONTROL = {"method": "CG4(3)", "rtol": 1e-3, "atol": 1e-3}
OUTPUT = {"t_eval": [0.25, 0.5], "dense_output": True, "events": event}
LIMITS = {"max_step": 0.5, "first_step": 0.1}
RUNS = {"seed": 1, "workers": 1}

# fmt: off
FUNCTION_EXAMPLES: dict[str, Call] = by_name([
    call(cg.solve_linear, f=constant_in_time, t_span=(0.0, 1.0), y0=np.eye(3), frame=SO3,
         method="CFM4", h=0.5),
    call(cg.solve_linear, f=lambda t, *args: np.full((len(t), 3), 0.1), t_span=(0.0, 1.0),
         y0=np.eye(3), frame=SO3, vectorized=True),
    call(cg.solve_linear_ensemble, f=lambda t, row: 0.1 * row, t_span=(0.0, 1.0), y0=np.eye(3),
         frame=SO3, parameters=np.ones((2, 3)), method="CFM4", h=0.5),
    call(cg.solve_ivp, cg.ConvergenceError, **LONG, **CONTROL, **OUTPUT, **LIMITS,
         breakpoints=[0.5], max_steps=100, parameters=[1.0, 2.0], progress=lambda t, end: None),
    call(cg.solve_ivp, cg.ConvergenceError, **SHORT, method="ImplicitMidpoint", h=0.25,
         stage_solver="fixed-point"),
    call(cg.solve_ivp, cg.ConvergenceError, **SHORT, method="RadauIIA5", rtol=1e-3,
         jac=lambda t, y, *numbers: np.zeros((3, 3))),
    call(cg.solve_variational, OverflowError, **LONG, **CONTROL, **OUTPUT, jac=jac, df_dp=df_dp,
         parameters=[0.5, 0.25], P0=np.diag([1.0, 2.0, 3.0]), control_derivatives=True,
         breakpoints=[0.5], noise=np.eye(3)),
    call(cg.solve_variational, **SHORT, derivatives="adjoint", rtol=1e-3),
    call(cg.solve_linear, f=constant_in_time, t_span=(0.0, 1.0), y0=np.eye(3), frame=SO3,
         derivatives="adjoint", parameters=[0.5, 0.25, 1.0],
         df_dp=jac),
    call(cg.solve_variational_ensemble, **TWO, parameters=[[0.5, 0.25], [1.0, 0.25]],
         P0=np.diag([1.0, 2.0, 3.0]), method="CG4(3)", max_steps=100),
    call(cg.integrate, cg.ConvergenceError, **SHORT, method="CG3", h=0.25,
         stage_solver="fixed-point", args=(1.0,)),
    call(cg.solve_ensemble, OverflowError, **TWO, **OUTPUT, method="CF4", h=0.25,
         breakpoints=[0.25], parameters=[[1.0], [2.0]], workers=1, out=np.zeros((2, 2, 3, 3))),
    call(cg.solve_ivp, **SHORT, inputs=cg.Samples([0.0, 0.5], [1.0, 2.0])),
    call(cg.Samples, times=[0.0, 0.5, 1.0], values=[[1.0, 2.0, 3.0]], kind="hold", end=2.0,
         causal=False, members=True),
    call(cg.Event, function=abs, terminal=2, direction=1.0, jump=stay, period=6.0),
    call(cg.Stepper, f=turning, t0=0.0, y0=np.eye(3), t_bound=1.0, frame=SO3, **CONTROL, **LIMITS,
         args=(1.0,), parameters=[1.0, 2.0], breakpoints=[0.5]),
    call(cg.search, OSError, order=2, stages=2, starts=2, **RUNS, maxfev=50, refine_below=1e-15,
         refine_maxfev=3, abscissae=(0.0, 1.0), bound=2.0, minimise="principal_error",
         hold={"a[2,1]": "1/2"}),
    call(cg.construct, OSError, order=3, stages=3, **RUNS, tries=1, largest=3.0, restarts=1,
         first_stages=3, width=1.0, iterations=20, force=True, abscissae=(0.0, 1.0),
         hold={"c[2]": "1/2"}),
    call(cg.lift, cg.LiftError, tableau=CG3, order=3, tries=2, hits=1, max_iterations=50),
    call(cg.certify, cg.CertificationError, method="CG3", order=3),
    call(cg.diagnose, method="CG3", c=[0, Fraction(3, 4), Fraction(17, 24)]),
    call(cg.export, method=CG3, format="python", digits=20),
    call(cg.lmdif, f=residual, x0=[0.0, 0.0], ftol=1e-8, xtol=1e-8, gtol=0.0, maxfev=100,
         epsfcn=1e-16, factor=100.0, diag=[1.0, 1.0]),
    call(cg.MagnusMethod, nodes=["1/2"], weights=[[1]], third_factor=1, name="x", source="y"),
    call(cg.Splitting, drifts=[0, 1, 0], kicks=["1/2", "1/2"], name="x", source="y"),
    call(cg.Tableau, a=[[0, 0], ["1/2", 0]], b=[0, 1], name="x", source="y", b_embedded=[1, 0],
         explicit=True, nominal_order=2, nominal_residual="1e-3"),
    call(cg.CommutatorFree, points=[(-1, {0: "1/2"}), (-1, {1: 1})], stage_points=[-1, 0],
         result=1, embedded_result=0, name="x", source="y"),
    call(cg.MuntheKaas, tableau=CG3, name="x", source="y"),
    call(cg.methods.__getitem__, KeyError, name="CG3"),
    call(SOLVED.sol.__call__, t=[0.25, 0.5]),
    call(cg.digits, method="CG3", digits=20),
    call(CG3.largest_residual, order=3),
    call(CG3.satisfies, order=3),
    call(CG3.description),
    call(cg.methods["RKMK5(4)"].residuals, order=3),
    call(cg.Certificate.loads, cg.CertificationError, text=CERTIFICATE.dumps()),
    call(certification.check, cg.CertificationError, certificate=CERTIFICATE, method=CG3),
    call(conditions.residuals, **EULER, arithmetic="exact"),
    call(conditions.weights, **EULER),
    call(conditions.jacobian, **EULER),
    call(conditions.pack, a=EULER["a"], b=EULER["b"]),
    call(conditions.unpack, x=[0.5, 0.0, 1.0], stages=2),
    *([call(conditions.equations, method=2, order=2)] if find_spec("sympy") else []),
    call(conditions.count, order=4, independent=True),
    call(conditions.condition_trees, order=4, independent=True),
    call(conditions.right_sides, order=4, independent=True),
    call(conditions.table_rows, order=4),
    call(conditions.unknowns, stages=4, rows="explicit"),
    call(conditions.check_rows, rows="explicit"),
    call(conditions.residuals, a=PAIR, order=3, embedded=True, arithmetic="exact"),
    call(conditions.weights, **AT_X),
    call(conditions.residuals, **AT_X),
    call(conditions.jacobian, **AT_X),
    call(conditions.residuals, a=CG3, order=3, arithmetic="balls", bits=128),
    call(trees.OrderedTree.parse, text="[[]]"),
    call(trees.forest, max_nodes=4),
    call(quads.encode, values=["1/3", 2, 0.5]),
    call(quads.to_decimal, value=Fraction(1, 3), digits=9),
    call(quads.from_float, values=[1.0, 0.5]),
    call(stability.stability_function, method=CG3),
    call(stability.stability_limits, method=CG3),
    call(stability.too_large, method=CG3),
    call(low_storage.from_two_registers, a=[0, "-1/2"], b=["1/2", 1], name="x"),
    call(low_storage.two_registers, method=CG3),
    call(catalogue.loads, text=catalogue.dumps(CG3)),
    call(catalogue.dumps, method=CG3),
    call(catalogue.dumps_json, method=CG3),
    call(catalogue.resolve_method, method="CG3"),
    call(drawing.draw_tree, tree=TREE),
    call(drawing.draw_points, method=CG3, digits=4),
    call(candidate.pack_method, method=CG3, order=3),
    call(candidate.correct, candidate=CANDIDATE, frozen=[1], ftol=1e-20, damping=1e-6,
         max_iterations=5),
    call(optimise.Goals, principal_error=1.0, interval=(0.0, 1.0), bound=1.5),
    call(eliminate.walk, candidate=CANDIDATE, random=RNG, size=0.3, largest=4.0),
    call(optimise.optimise, candidate=CANDIDATE, goals=optimise.Goals(), frozen=[],
         max_iterations=1, tolerance=1e-3),
    call(impossibility.read_shape, impossibility.ImpossibilityError, text="tableau", stages=2),
    call(frames.hat, v=[0.1, 0.2, 0.3]),
    call(frames.vee, matrix=frames.hat([0.1, 0.2, 0.3])),
    call(plot.convergence, h=[0.1, 0.05], errors=[1e-3, 1e-4], ax=axes(), label="x", order=3.0),
    call(plot.work_precision, work=[10, 20], errors=[1e-3, 1e-4], ax=axes(), label="x", unit="f"),
    call(plot.trajectory_on_sphere, y=np.eye(3), label="x", color="C0"),
    call(plot.bloch, y=np.eye(2, dtype=complex), label="x", color="C0"),
    call(plot.bands, t=[0.0, 1.0], values=np.eye(2), ax=axes(), label="x"),
    call(plot.invariants, solution=SOLVED, functions={"first": lambda y: y[:, 0, 0]}, ax=axes()),
    call(frames.check, frame=SO3, rng=np.random.default_rng(0)),
    call(plot.trajectory_of_axes, y=np.array([np.eye(3)] * 2), triads=2),
    call(plot.attitude, y=np.array([np.eye(3)] * 2), show="rate", t=[0.0, 1.0]),
    call(plot.tree, tree=TREE, ax=axes(), title=True),
    call(plot.points, method="CG3", ax=axes()),
    call(plot.tableau, method="CG3", ax=axes(), digits=4),
    call(plot.stability_region, method="CG3", ax=axes(), x=(-3.0, 1.0), y=(-2.0, 2.0)),
])
# fmt: on
