"""Calls of everything public that work, whose arguments `test_fuzz_arguments.py` exchanges."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import matplotlib.figure
import numpy as np

import cg
from cg import catalogue, conditions, construction, frames, plot
from cg import proofs as certification
from cg.analysis import diagnosis
from cg.method import low_storage, stability
from cg.support import quads
from cg.trees import ordered as trees
from research import impossibility


class Call(NamedTuple):
    """What is called, with arguments that are right, and the errors of its own."""

    function: Callable[..., Any]
    arguments: dict[str, Any]
    own: tuple[type[Exception], ...] = ()


RNG = np.random.default_rng(0)
PAIR, CG3, CF4 = cg.methods["CG4(3)"], cg.methods["CG3"], cg.methods["CF4"]
TREE = trees.OrderedTree.parse("[[]]")
SO3 = frames.SO3()
EULER = {"a": [[0.0, 0.0], [0.5, 0.0]], "b": [0.0, 1.0]}
X = np.linspace(0.1, 0.6, 6)
CANDIDATE = construction.pack_method(CG3)
SOLVED = cg.solve_ivp(lambda t, y: [0.1, 0.2, 0.3], (0, 1), np.eye(3), frame=SO3, dense_output=True)


def turning(t, y, *numbers):
    return np.stack([0.3 + 0.0 * t, -0.2 * np.cos(t), 0.1 + 0.0 * t], axis=-1)


def residual(x):
    return np.array([x[0] - 1.0, x[1] + 2.0])


def axes():
    return matplotlib.figure.Figure().add_subplot()


def constant_in_time(t, *args):
    return [0.1, 0.2, 0.3]


FUNCTION_EXAMPLES: dict[str, Call] = {
    "solve_linear": Call(
        cg.solve_linear,
        {
            "a": constant_in_time,
            "t_span": (0.0, 1.0),
            "y0": np.eye(3),
            "frame": SO3,
            "method": "CFM4",
            "h": 0.5,
            "t_eval": None,
            "dense_output": False,
            "args": None,
        },
    ),
    "MagnusMethod": Call(
        cg.MagnusMethod,
        {
            "nodes": ["1/2"],
            "weights": [[1]],
            "embedded": None,
            "third": None,
            "third_factor": 1,
            "name": "x",
            "source": "y",
        },
    ),
    "solve_ivp": Call(
        cg.solve_ivp,
        {
            "f": turning,
            "t_span": (0.0, 1.0),
            "y0": np.eye(3),
            "frame": SO3,
            "method": "CG4(3)",
            "rtol": 1e-3,
            "atol": 1e-3,
            "t_eval": [0.25, 0.5],
            "dense_output": True,
            "events": lambda t, y, *numbers: t - 0.7,
            "breakpoints": [0.5],
            "max_step": 0.5,
            "first_step": 0.1,
            "max_steps": 100,
            "parameters": [1.0, 2.0],
            "progress": lambda t, end: None,
        },
        (cg.ConvergenceError,),
    ),
    "solve_ivp, implicit": Call(
        cg.solve_ivp,
        {
            "f": turning,
            "t_span": (0.0, 0.5),
            "y0": np.eye(3),
            "frame": SO3,
            "method": "ImplicitMidpoint",
            "h": 0.25,
            "args": None,
            "stage_solver": "fixed-point",
        },
        (cg.ConvergenceError,),
    ),
    "solve_variational": Call(
        cg.solve_variational,
        {
            "f": turning,
            "t_span": (0.0, 1.0),
            "y0": np.eye(3),
            "frame": SO3,
            "jac": lambda t, y, *numbers: np.zeros((3, 3)),
            "df_dp": lambda t, y, *numbers: np.zeros((3, len(numbers[-1]))),
            "parameters": [0.5, 0.25],
            "P0": np.diag([1.0, 2.0, 3.0]),
            "control_derivatives": True,
            "method": "CG4(3)",
            "rtol": 1e-3,
            "atol": 1e-3,
            "t_eval": [0.25, 0.5],
            "dense_output": True,
            "events": lambda t, y, *numbers: t - 0.7,
            "breakpoints": [0.5],
        },
        (OverflowError,),
    ),
    "solve_variational_ensemble": Call(
        cg.solve_variational_ensemble,
        {
            "f": turning,
            "t_span": (0.0, 0.5),
            "y0": np.stack([np.eye(3)] * 2),
            "frame": SO3,
            "parameters": [[0.5, 0.25], [1.0, 0.25]],
            "P0": np.diag([1.0, 2.0, 3.0]),
            "method": "CG4(3)",
            "vectorized": False,
            "common_steps": False,
        },
    ),
    "integrate": Call(
        cg.integrate,
        {
            "f": turning,
            "t_span": (0.0, 0.5),
            "y0": np.eye(3),
            "frame": SO3,
            "method": "CG3",
            "h": 0.25,
            "stage_solver": "fixed-point",
            "save_every": 1,
            "args": (1.0,),
            "parameters": None,
            "progress": None,
        },
        (cg.ConvergenceError,),
    ),
    "solve_ensemble": Call(
        cg.solve_ensemble,
        {
            "f": turning,
            "t_span": (0.0, 0.5),
            "y0": np.stack([np.eye(3)] * 2),
            "frame": SO3,
            "method": "CF4",
            "h": 0.25,
            "t_eval": [0.25, 0.5],
            "dense_output": True,
            "events": lambda t, y, *numbers: t - 0.7,
            "breakpoints": [0.25],
            "parameters": [[1.0], [2.0]],
            "vectorized": False,
            "common_steps": False,
            "executor": None,
            "workers": 1,
            "out": np.zeros((2, 2, 3, 3)),
            "progress": None,
        },
        (OverflowError,),
    ),
    "Event": Call(
        cg.Event, {"function": abs, "terminal": 2, "direction": 1.0, "jump": lambda t, y: y}
    ),
    "Stepper": Call(
        cg.Stepper,
        {
            "f": turning,
            "t0": 0.0,
            "y0": np.eye(3),
            "t_bound": 1.0,
            "frame": SO3,
            "method": "CG4(3)",
            "rtol": 1e-3,
            "atol": 1e-3,
            "max_step": 0.5,
            "first_step": 0.1,
            "args": (1.0,),
            "parameters": [1.0, 2.0],
            "breakpoints": [0.5],
            "vectorized": False,
            "common_steps": False,
        },
    ),
    "search": Call(
        cg.search,
        {
            "order": 2,
            "stages": 2,
            "starts": 2,
            "seed": 1,
            "algorithm": "minimum-norm",
            "rows": "explicit",
            "width": 1.0,
            "maxfev": 50,
            "refine_below": 1e-15,
            "refine_maxfev": 3,
            "workers": 1,
            "executor": None,
            "store": None,
            "progress": None,
            "force": False,
            "tree": None,
            "flows": None,
            "embedded": False,
            "first_same_as_last": False,
        },
        (OSError,),
    ),
    "construct": Call(
        cg.construct,
        {
            "order": 3,
            "stages": 3,
            "seed": 1,
            "tries": 1,
            "largest": 3.0,
            "restarts": 1,
            "full_rank": False,
            "structure": cg.Structure.GENERAL,
            "first_stages": 3,
            "width": 1.0,
            "iterations": 20,
            "workers": 1,
            "executor": None,
            "store": None,
            "progress": None,
            "force": True,
            "tree": None,
            "flows": None,
            "first_flows": None,
            "embedded": False,
            "first_same_as_last": False,
        },
        (OSError,),
    ),
    "lift": Call(
        cg.lift,
        {
            "tableau": CG3,
            "order": 3,
            "embedded_order": None,
            "flows": None,
            "chains": None,
            "seed": 0,
            "tries": 2,
            "hits": 1,
            "reduce": False,
            "improve": False,
            "max_iterations": 50,
            "name": "",
            "source": "",
        },
        (cg.LiftError,),
    ),
    "certify": Call(
        cg.certify, {"method": "CG3", "order": 3, "small": False}, (cg.CertificationError,)
    ),
    "diagnose": Call(cg.diagnose, {"method": "CG3", "c": [0, Fraction(3, 4), Fraction(17, 24)]}),
    "export": Call(cg.export, {"method": CG3, "format": "python", "digits": 20}),
    "lmdif": Call(
        cg.lmdif,
        {
            "f": residual,
            "x0": [0.0, 0.0],
            "ftol": 1e-8,
            "xtol": 1e-8,
            "gtol": 0.0,
            "maxfev": 100,
            "epsfcn": 1e-16,
            "factor": 100.0,
            "diag": [1.0, 1.0],
        },
    ),
    "Tableau": Call(
        cg.Tableau,
        {
            "a": [[0, 0], ["1/2", 0]],
            "b": [0, 1],
            "name": "x",
            "source": "y",
            "b_embedded": [1, 0],
            "explicit": True,
            "nominal_order": 2,
            "nominal_residual": "1e-3",
        },
    ),
    "Tableau.from_packed": Call(
        cg.Tableau.from_packed, {"x": ["1/2", 0, 1], "stages": 2, "rows": "explicit", "digits": 9}
    ),
    "CommutatorFree": Call(
        cg.CommutatorFree,
        {
            "points": [(-1, {0: "1/2"}), (-1, {1: 1})],
            "stage_points": [-1, 0],
            "result": 1,
            "embedded_result": 0,
            "third": None,
            "name": "x",
            "source": "y",
            "nominal_order": None,
            "nominal_residual": None,
        },
    ),
    "MuntheKaas": Call(cg.MuntheKaas, {"tableau": CG3, "third": None, "name": "x", "source": "y"}),
    "methods[]": Call(cg.methods.__getitem__, {"name": "CG3"}, (KeyError,)),
    "Solution.sol": Call(SOLVED.sol, {"t": [0.25, 0.5]}),
    "digits": Call(CG3.digits, {"digits": 20, "embedded": False, "certificate": None}),
    "Method.largest_residual": Call(CG3.largest_residual, {"order": 3}),
    "Method.principal_error": Call(CG3.principal_error, {"order": 3}),
    "Method.satisfies": Call(CG3.satisfies, {"order": 3}),
    "Method.description": Call(CG3.description, {"complete": False}),
    "MuntheKaas.residuals": Call(
        catalogue.munthe_kaas["RKMK5(4)"].residuals, {"order": 3, "embedded": False}
    ),
    "Certificate.loads": Call(
        cg.Certificate.loads, {"text": cg.certify("CG3").dumps()}, (cg.CertificationError,)
    ),
    "certification.check": Call(
        certification.check,
        {"certificate": cg.certify("CG3"), "method": CG3},
        (cg.CertificationError,),
    ),
    "conditions.residuals": Call(conditions.residuals, {**EULER, "order": 3, "independent": False}),
    "conditions.residuals_exact": Call(
        conditions.residuals_exact, {**EULER, "order": 3, "independent": False}
    ),
    "conditions.weights": Call(conditions.weights, {**EULER, "order": 3, "independent": False}),
    "conditions.jacobian": Call(
        conditions.jacobian, {**EULER, "order": 3, "independent": False, "rows": None}
    ),
    "conditions.pack": Call(conditions.pack, {**EULER, "rows": None}),
    "conditions.unpack": Call(
        conditions.unpack, {"x": [0.5, 0.0, 1.0], "stages": 2, "rows": conditions.Rows.EXPLICIT}
    ),
    "conditions.count": Call(conditions.count, {"order": 4, "independent": True}),
    "conditions.count_classical": Call(conditions.count_classical, {"order": 4}),
    "conditions.condition_trees": Call(
        conditions.condition_trees, {"order": 4, "independent": True}
    ),
    "conditions.right_sides": Call(conditions.right_sides, {"order": 4, "independent": True}),
    "conditions.table_rows": Call(conditions.table_rows, {"order": 4}),
    "conditions.unknowns": Call(conditions.unknowns, {"stages": 4, "rows": "explicit"}),
    "conditions.check_rows": Call(conditions.check_rows, {"rows": "explicit"}),
    "conditions.residuals_of": Call(
        conditions.residuals_of,
        {"method": PAIR, "order": 3, "independent": False, "embedded": True},
    ),
    "conditions.exact_residuals_of": Call(
        conditions.exact_residuals_of,
        {"method": PAIR, "order": 3, "independent": False, "embedded": True},
    ),
    "conditions.weights_at": Call(
        conditions.weights_at, {"layout": CG3.layout, "x": X, "order": 3, "independent": False}
    ),
    "conditions.residuals_at": Call(
        conditions.residuals_at, {"layout": CG3.layout, "x": X, "order": 3, "independent": False}
    ),
    "conditions.jacobian_at": Call(
        conditions.jacobian_at, {"layout": CG3.layout, "x": X, "order": 3, "independent": False}
    ),
    "conditions.ball_residuals_of": Call(
        conditions.ball_residuals_of,
        {"method": CG3, "order": 3, "independent": False, "bits": 128},
    ),
    "OrderedTree.parse": Call(trees.OrderedTree.parse, {"text": "[[]]"}),
    "forest": Call(trees.forest, {"max_nodes": 4}),
    "quads.encode": Call(quads.encode, {"values": ["1/3", 2, 0.5]}),
    "quads.to_decimal": Call(quads.to_decimal, {"value": Fraction(1, 3), "digits": 9}),
    "quads.from_float": Call(quads.from_float, {"values": [1.0, 0.5]}),
    "stability.stability_function": Call(stability.stability_function, {"method": CG3}),
    "stability.stability_limits": Call(stability.stability_limits, {"method": CG3}),
    "stability.too_large": Call(stability.too_large, {"method": CG3}),
    "low_storage.from_two_registers": Call(
        low_storage.from_two_registers, {"a": [0, "-1/2"], "b": ["1/2", 1], "name": "x"}
    ),
    "low_storage.two_registers": Call(low_storage.two_registers, {"method": CG3}),
    "catalogue.loads": Call(catalogue.loads, {"text": catalogue.dumps(CG3)}),
    "catalogue.dumps": Call(catalogue.dumps, {"method": CG3}),
    "catalogue.dumps_json": Call(catalogue.dumps_json, {"method": CG3}),
    "catalogue.resolve_method": Call(catalogue.resolve_method, {"method": "CG3"}),
    "diagnosis.draw_tree": Call(diagnosis.draw_tree, {"tree": TREE}),
    "diagnosis.draw_points": Call(diagnosis.draw_points, {"method": CG3, "digits": 4}),
    "construction.compose": Call(
        construction.compose, {"methods": [CG3, CG3], "gammas": ["1/2", "1/2"], "name": "x"}
    ),
    "construction.triple_jump": Call(construction.triple_jump, {"order": 2, "digits": 9}),
    "construction.pack_method": Call(construction.pack_method, {"method": CG3, "order": 3}),
    "construction.correct": Call(
        construction.correct,
        {
            "candidate": CANDIDATE,
            "frozen": [1],
            "ftol": 1e-20,
            "damping": 1e-6,
            "max_iterations": 5,
            "accurate": None,
        },
    ),
    "construction.Goals": Call(
        construction.Goals,
        {"principal_error": 1.0, "coefficients": 0.0, "abscissae": 0.0, "bound": 1.5},
    ),
    "construction.walk": Call(
        construction.walk,
        {"candidate": CANDIDATE, "random": np.random.default_rng(1), "size": 0.3, "largest": 4.0},
    ),
    "construction.optimise": Call(
        construction.optimise,
        {
            "candidate": CANDIDATE,
            "goals": construction.Goals(),
            "frozen": [],
            "max_iterations": 1,
            "tolerance": 1e-3,
        },
    ),
    "impossibility.read_shape": Call(
        impossibility.read_shape,
        {"text": "tableau", "stages": 2},
        (impossibility.ImpossibilityError,),
    ),
    "hat": Call(frames.hat, {"v": [0.1, 0.2, 0.3]}),
    "vee": Call(frames.vee, {"matrix": frames.hat([0.1, 0.2, 0.3])}),
    "plot.convergence": Call(
        plot.convergence,
        {"h": [0.1, 0.05], "errors": [1e-3, 1e-4], "ax": axes(), "label": "x", "order": 3.0},
    ),
    "plot.work_precision": Call(
        plot.work_precision,
        {"work": [10, 20], "errors": [1e-3, 1e-4], "ax": axes(), "label": "x", "unit": "f"},
    ),
    "plot.trajectory_on_sphere": Call(
        plot.trajectory_on_sphere, {"y": np.eye(3), "ax": None, "label": "x", "color": "C0"}
    ),
    "plot.trajectory_of_axes": Call(
        plot.trajectory_of_axes, {"y": np.array([np.eye(3)] * 2), "ax": None, "triads": 2}
    ),
    "plot.tree": Call(plot.tree, {"tree": TREE, "ax": axes(), "title": True}),
    "plot.points": Call(plot.points, {"method": "CG3", "ax": axes()}),
    "plot.tableau": Call(plot.tableau, {"method": "CG3", "ax": axes(), "digits": 4}),
    "plot.stability_region": Call(
        plot.stability_region,
        {"method": "CG3", "ax": axes(), "x": (-3.0, 1.0), "y": (-2.0, 2.0)},
    ),
}
