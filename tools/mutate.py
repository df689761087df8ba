"""Change the package in small ways, one at a time, and see whether tests fail.

Usage: ``python tools/mutate.py --output FILE [--sample N] [--seed S] [MODULE ...]``

A mutant is one module with one operator, constant or statement changed. It exists only in the
memory of the process that tests it: an import hook compiles the changed syntax tree, and no file
is touched. Each mutant gets the tests that should see it (`TESTS`), which end at the first
failure. One line of JSON a mutant goes to FILE as soon as it is known; mutants that are there
already aren't run again.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import os
import random
import resource
import runpy
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).parents[1]
CPU_SECONDS = 120
WALL_SECONDS = 900

CERTIFICATION = "values certify_weights krawczyk flat_rows orthogonality certify"
INTEGRATION = "integration_loop integration_input events solve_ensemble solve_ivp integrate"
# Cases that take long, and see what others see
LONG = "not Stiefel and not Coadjoint and not second_way and not spacecraft and not slopes"
TESTS = {  # module: files of tests in the order in which they are run
    "cg.trees.ordered": "trees values conditions",
    "cg.conditions": "bad_input conditions point_conditions points",
    "cg.conditions.counts": "bad_input conditions trees",
    "cg.conditions.exact": "bad_input conditions point_conditions points",
    "cg.structure.points": "points point_conditions",
    "cg.method.tableau": "tableau points catalogue",
    "cg.method.commutator_free": "points catalogue",
    "cg.integration.arguments": "integration_input bad_input solve_ivp adaptive integrate",
    "cg.integration.step.callbacks": f"{INTEGRATION} implicit order_on_frames munthe_kaas",
    "cg.integration.default_method": "solve_ivp adaptive integrate",
    "cg.integration.rhs.compiled": "compiled compiled_adaptive solve_ensemble",
    "cg.integration.loop.dense": "integration_loop events dense solve_ensemble",
    "cg.integration.ensemble": "solve_ensemble ensemble_executors progress",
    "cg.integration.rhs.events": "events jumps compiled_adaptive solve_ensemble",
    "cg.integration.step.implicit": "implicit implicit_methods solve_ensemble",
    "cg.integration.step.interpolant": "values integration_loop dense events munthe_kaas",
    "cg.integration.ivp": "solve_ivp integration_input events integrate progress",
    "cg.integration.step.paths": "integrate registers munthe_kaas order_on_frames",
    "cg.integration.step.plan": f"values {INTEGRATION} adaptive lift",
    "cg.integration.problem": "integration_input solve_ivp solve_ensemble adaptive",
    "cg.integration.rhs.python": "python_field integration_input solve_ensemble",
    "cg.integration.results": "values solve_ivp solve_ensemble",
    "cg.integration.loop.run": f"{INTEGRATION} adaptive limits",
    "cg.integration.stepper": "stepper",
    "cg.proofs.krawczyk": "values krawczyk certify",
    "cg.proofs.find": CERTIFICATION,
    "cg.proofs.prove": CERTIFICATION,
    "cg.proofs.statement": CERTIFICATION,
    "cg.proofs.violated": CERTIFICATION,
    "cg.proofs.zero": CERTIFICATION,
    "cg.proofs.weights": "certify_weights points krawczyk certify",
    "cg.proofs.systems": CERTIFICATION,
    "cg.proofs.dependent.identities": "orthogonality flat_rows certify",
    "cg.proofs.certificate": "values hostile_text certify krawczyk",
    "cg.proofs.digits": "krawczyk certify tableau points",
    "cg.proofs.dependent.words": CERTIFICATION,
    "cg.frames.power": "frame_product compiled gradient_flow problems frames",
    "cg.frames.local_coordinates": "frame_coordinates frame_digits frame_growth",
    "cg.frames.matrix_functions": "frame_digits frame_growth frame_coordinates frames",
    "cg.problems.lattice": "gradient_flow problems",
    "cg.problems.gradient_flow": "gradient_flow problems",
    "cg.problems.extrapolation": "problems",
    "cg.problems.reaction_wheels": "problems",
    "cg.problems.forced_rigid_body": "problems",
    "cg.method.munthe_kaas": "munthe_kaas munthe_kaas_methods",
    "cg.frames.dexpinv": "munthe_kaas brackets munthe_kaas_methods",
    "benchmarks.work_curves": "benchmarks",
}

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "sum": "max", "abs": "float"}


class Mutator(ast.NodeTransformer):
    """Count the places where something can change, and change the one that is wanted.

    What isn't executed, or is only read by people, stays: annotations, texts, messages of errors.
    """

    def __init__(self, wanted: int | None = None) -> None:
        self.wanted = wanted
        self.found: list[dict[str, Any]] = []

    def _offer(self, node: ast.AST, *others: ast.AST) -> ast.AST:
        for other in others:
            number = len(self.found)
            line = getattr(node, "lineno", 0)
            change = f"{ast.unparse(node)} → {ast.unparse(other) or 'nothing'}"
            self.found.append({"number": number, "line": line, "change": change})
            if number == self.wanted:
                return ast.copy_location(other, node)
        return node

    def _arguments_only(self, node: ast.FunctionDef) -> ast.AST:
        node.body = [self.visit(statement) for statement in node.body]
        defaults = node.args.defaults
        node.args.defaults = [self.visit(default) for default in defaults]
        node.args.kw_defaults = [d and self.visit(d) for d in node.args.kw_defaults]
        return node

    visit_FunctionDef = _arguments_only

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        if any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets):
            return node
        return self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return self._offer(node, ast.Pass())

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        if isinstance(node.value, ast.Constant):
            return node
        offered = self._offer(node, ast.Pass())
        return self.generic_visit(node) if offered is node else offered

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        other = ARITHMETIC.get(type(node.op))
        changed = [ast.AugAssign(node.target, other(), node.value)] if other else []
        offered = self._offer(node, ast.Pass(), *changed)
        if offered is node:
            node.value = self.visit(node.value)
        return offered

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        others = [
            ast.Compare(node.left, [*node.ops[:k], other(), *node.ops[k + 1 :]], node.comparators)
            for k, op in enumerate(node.ops)
            for other in COMPARISONS[type(op)]
        ]
        offered = self._offer(node, *others)
        return self.generic_visit(node) if offered is node else offered

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        other = ARITHMETIC.get(type(node.op))
        text = any(
            isinstance(side, ast.JoinedStr)
            or (isinstance(side, ast.Constant) and isinstance(side.value, str))
            for side in (node.left, node.right)
        )
        if other is not None and not text:
            offered = self._offer(node, ast.BinOp(node.left, other(), node.right))
            if offered is not node:
                return offered
        return self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        offered = self._offer(node, ast.BoolOp(op, node.values))
        return self.generic_visit(node) if offered is node else offered

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        offered = self._offer(node, node.operand)
        return self.generic_visit(node) if offered is node else offered

    def _test(self, node: ast.If | ast.IfExp | ast.While) -> ast.AST:
        if isinstance(node.test, ast.Name | ast.Call | ast.Attribute):
            kept = node.test
            offered = self._offer(kept, ast.UnaryOp(ast.Not(), kept))
            node.test = offered if offered is not kept else self.visit(kept)  # type: ignore[assignment]
        else:
            node.test = self.visit(node.test)
        for part in ("body", "orelse"):
            value = getattr(node, part)
            made = [self.visit(s) for s in value] if isinstance(value, list) else self.visit(value)
            setattr(node, part, made)
        return node

    visit_If = visit_IfExp = visit_While = _test

    def visit_Break(self, node: ast.Break) -> ast.AST:
        return self._offer(node, ast.Continue())

    def visit_Continue(self, node: ast.Continue) -> ast.AST:
        return self._offer(node, ast.Break())

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if isinstance(node.ctx, ast.Load) and node.id in NAMES:
            return self._offer(node, ast.Name(NAMES[node.id], ast.Load()))
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        value = node.value
        if isinstance(value, bool):
            return self._offer(node, ast.Constant(not value))
        if isinstance(value, int):
            return self._offer(node, ast.Constant(value + 1))
        if isinstance(value, float):
            return self._offer(node, ast.Constant(value * 1.5 if value else 1.0))
        return node


def mutants(path: Path) -> list[dict[str, Any]]:
    """Return number, line, the text of the line and the change of each mutant of a file."""
    text = path.read_text("utf-8")
    lines = text.splitlines()
    mutator = Mutator()
    mutator.visit(ast.parse(text))
    return [{**mutant, "code": lines[mutant["line"] - 1].strip()} for mutant in mutator.found]


class Loader(importlib.machinery.SourceFileLoader):
    """Loads a module with one change."""

    number: int

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of the mutant; no file of bytecode is read or written."""
        tree = Mutator(self.number).visit(ast.parse(Path(self.path).read_text("utf-8")))
        return compile(ast.fix_missing_locations(tree), self.path, "exec")


class Finder(importlib.abc.MetaPathFinder):
    """Finds the one module that is changed."""

    def __init__(self, module: str, number: int) -> None:
        self.module, self.number = module, number

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """Return the module's own spec with a loader that changes it."""
        if fullname != self.module:
            return None
        for finder in sys.meta_path:
            if finder is not self and (spec := finder.find_spec(fullname, path, target)):
                spec.loader = Loader(fullname, str(file_of(fullname)))
                spec.loader.number = self.number
                return spec
        return None


class WithoutShrinking:
    """Makes hypothesis stop at the first failure."""

    def pytest_sessionstart(self) -> None:
        """Replace the profile that conftest.py has loaded."""
        import hypothesis

        hypothesis.settings.register_profile(
            "mutants", phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate]
        )
        hypothesis.settings.load_profile("mutants")


def file_of(module: str) -> Path:
    """Return the file of a module."""
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def tests_of(module: str) -> list[str]:
    """Return the files of tests of a module that exist."""
    files = [(ROOT / "tests").glob(f"*/test_{name}.py") for name in TESTS[module].split()]
    return [str(file) for found in files for file in found]


def run_child(module: str, number: int | None, log: Path) -> None:
    """Run a module's tests on one mutant, or on the module itself, and end the process."""
    os.setsid()
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
    import pytest

    if number is not None:
        sys.meta_path.insert(0, Finder(module, number))
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow"]
    options += ["-k", LONG]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    code = pytest.main([*options, *tests_of(module)], plugins=[WithoutShrinking()])
    sys.stdout.flush()
    os._exit(int(code))


def outcome(module: str, number: int | None, log: Path) -> str:
    """Return "survived", "killed", or "killed by the limit of time"."""
    pid = os.fork()
    if pid == 0:
        try:
            run_child(module, number, log)
        finally:
            os._exit(3)
    end = time.monotonic() + WALL_SECONDS
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            if os.WIFSIGNALED(status):
                limit = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
                return "killed by the limit of time" if limit else "killed"
            code = os.WEXITSTATUS(status)
            return {0: "survived", 4: "no tests", 5: "no tests"}.get(code, "killed")
        time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return "killed by the limit of time"


def first_failure(log: Path) -> str:
    """Return the name of the test that failed."""
    lines = log.read_text("utf-8", errors="replace").splitlines()
    named = [line for line in lines if line.startswith(("FAILED ", "ERROR "))]
    return named[0].split(" ")[1].removeprefix("tests/") if named else ""


def sampled(module: str, size: int, seed: int) -> list[dict[str, Any]]:
    """Return some mutants of a module; a larger sample begins with a smaller one."""
    found = mutants(file_of(module))
    random.Random(f"{seed} {module}").shuffle(found)
    return found[:size]


def preload() -> None:
    """Import what all mutants share, so that each process has it from its start."""
    import flint  # noqa: F401
    import hypothesis  # noqa: F401
    import matplotlib  # noqa: F401
    import numpy as np  # noqa: F401
    import pytest  # noqa: F401
    import scipy.integrate
    import scipy.linalg
    import scipy.optimize  # noqa: F401


def run(
    modules: Sequence[str], size: int, seed: int, output: Path, kept: Any
) -> Iterator[dict[str, Any]]:
    """Test mutants that aren't kept in `output` yet; yield each with what became of it."""
    known = {(record["module"], record["number"], record["change"]) for record in kept.records}
    log = output.with_suffix(".log")
    for module in modules:
        todo = [
            mutant
            for mutant in sampled(module, size, seed)
            if (module, mutant["number"], mutant["change"]) not in known
        ]
        if todo and (found := outcome(module, None, log)) != "survived":
            print(f"{module}: {found} without a change, see {log}", file=sys.stderr, flush=True)
            continue
        for mutant in todo:
            begin = time.monotonic()
            result = outcome(module, mutant["number"], log)
            yield {
                "module": module,
                **mutant,
                "outcome": result,
                "by": first_failure(log) if result == "killed" else "",
                "seconds": round(time.monotonic() - begin, 1),
            }


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="by default all that tests are named for")
    parser.add_argument("--sample", type=int, default=20, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--list", action="store_true", help="print how many there are, and end")
    options = parser.parse_args()
    modules = options.modules or [module for module in TESTS if file_of(module).exists()]
    if options.list:
        for module in modules:
            print(f"{module}: {len(mutants(file_of(module)))}")
        return
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    preload()
    # by its file: modules of the package that are imported here can't be mutated
    kept_class = runpy.run_path(str(ROOT / "reproduce" / "kept.py"))["Kept"]
    with closing(kept_class(options.output)) as kept:
        for record in run(modules, options.sample, options.seed, options.output, kept):
            kept.append(record)
            print(
                f"{record['module']}:{record['line']} {record['outcome']}: {record['change']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
