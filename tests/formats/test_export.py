"""Exported steps equal those of `cg.integrate`."""

import subprocess
import sys

import numpy as np
import pytest
from kinds import FROZEN, MUNTHE_KAAS
from python_steps import Step
from refusals import refuses
from slow_cases import slow

import cg
from cg.construction.catalogue import resolve_method
from cg.construction.formats.code import identifier
from cg.frames.base import Frame

START = (0.3, -0.4, 0.7)
TIME = 0.25
STEP = 0.375


def field(t, y):
    x, z, w = y[..., 0], y[..., 1], y[..., 2]
    return np.stack([0.3 + z * w - 0.5 * t, x * x - 0.2 * w, t * x + z], axis=-1)


class Heisenberg(Frame):
    """A group whose flows take additions and products alone, so that C has the same bits.

    Right-hand side, flow and dexp⁻¹ are written in C as they are here.
    """

    dim = 3
    point_shape = (3,)

    def field(self, v, y):
        turn = 0.5 * (y[..., 0] * v[..., 1] - y[..., 1] * v[..., 0])
        return np.stack([v[..., 0], v[..., 1], v[..., 2] + turn], axis=-1)

    def flow(self, v, y):
        return y + self.field(v, y)

    def membership_error(self, y):
        return np.zeros(np.shape(y)[:-1])

    def random_point(self, rng, size=()):
        return rng.standard_normal((*np.atleast_1d(size), 3))

    def _bracket(self, u, v):
        last = u[..., 1] * v[..., 0] - u[..., 0] * v[..., 1]
        return np.stack([0 * last, 0 * last, last], axis=-1)


def dexpinv(u, v):
    return np.array([v[0], v[1], v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1])])


C = """
static int field(double t, const double *y, double *f, void *data)
{
    (void)data;
    f[0] = 0.3 + y[1] * y[2] - 0.5 * t;
    f[1] = y[0] * y[0] - 0.2 * y[2];
    f[2] = t * y[0] + y[1];
    return 0;
}
static int flow(const double *v, double *y, void *data)
{
    double turn = 0.5 * (y[0] * v[1] - y[1] * v[0]);
    (void)data;
    y[0] = y[0] + v[0];
    y[1] = y[1] + v[1];
    y[2] = y[2] + (v[2] + turn);
    return 0;
}
static int dexpinv(const double *u, double *v, void *data)
{
    (void)data;
    v[2] = v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1]);
    return 0;
}
"""


ALL = [name for name, method in {**FROZEN, **MUNTHE_KAAS}.items() if method.explicit]
SOME = [
    "LieEuler", "CG2(3)", "CG4a", "CG4(3)b", "CF4", "CF5(4)", "CF5r", "DP5(4)", "BS3(2)",
    "RKMK4", "RKMK5(4)", "RKMK3(2)", "CF6(5)", "DOP853",
]  # fmt: skip


def ours(name):
    """Return the result of a step, and the second result or errors of a pair, as rows."""
    method = resolve_method(name)
    step = Step(field, Heisenberg(), method)
    start = np.array(START)
    if method.embedded_order is None:
        return [step(TIME, start, STEP)]
    if not isinstance(method, cg.MuntheKaas):
        return list(step.pair(TIME, start, STEP))
    point = step(TIME, start, STEP)
    return [point, *errors_of(method, step)]


def errors_of(method, step):
    """Return the coefficients of the errors, summed over the stages in their order."""
    rows = method.advancing_method.error_weights
    weights = [[STEP * float(weight) for weight in row] for row in rows]
    return [sum(w * v for w, v in zip(row, step.fields, strict=True)) for row in weights]


def agree(output, names):
    """Compare lines of hexadecimal numbers (%a in C) with the expected steps."""
    expected = [row for name in names for row in ours(name)]
    rows = [[float.fromhex(number) for number in line.split()] for line in output.splitlines()]
    assert len(rows) == len(expected)
    np.testing.assert_array_equal(rows, expected)


def on_algebra(method):
    return isinstance(method, cg.MuntheKaas)


def sums_of(method):
    """Return the weights of errors that an exported step returns in place of a second result."""
    return method.error_weights if on_algebra(method) else ()


def python_program(names):
    lines = ["import numpy as np", "def hexes(row):"]
    lines += ["    print(*[float(x).hex() for x in row])"]
    lines += [
        "def field(t, y):",
        "    return [0.3 + y[1] * y[2] - 0.5 * t, y[0] * y[0] - 0.2 * y[2], t * y[0] + y[1]]",
        "def flow(v, y):", "    turn = 0.5 * (y[0] * v[1] - y[1] * v[0])",
        "    return y + np.array([v[0], v[1], v[2] + turn])", "def dexpinv(u, v):",
        "    return np.array([v[0], v[1], v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1])])",
        f"y = np.array({START})",
    ]  # fmt: skip
    for name in names:
        method = resolve_method(name)
        functions = "field, flow, dexpinv" if on_algebra(method) else "field, flow"
        arguments = f"{functions}, {TIME}, y, {STEP}"
        lines += ["names = {}", f"exec({cg.export(name, 'python')!r}, names)"]
        if method.embedded_order is None:
            lines.append(f"hexes(names['step']({arguments}))")
        elif on_algebra(method):
            lines += [f"point, errors = names['step_error']({arguments})", "hexes(point)"]
            lines += ["for row in errors: hexes(row)"]
            lines.append(f"assert (names['step']({arguments}) == point).all()")
        else:
            lines += [f"for row in names['step_pair']({arguments}): hexes(row)"]
    lines += ["import sys", "assert 'cg' not in sys.modules"]
    return "\n".join(lines)


def output_of(*command, folder):
    """Run a program in a folder, without errors; return what it prints."""
    run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder)
    return run.stdout


def check_python(names, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(python_program(names), encoding="utf-8")
    agree(output_of(sys.executable, "-I", program, folder=tmp_path), names)


def c_program(names):
    lines = ["#include <stdio.h>", C]
    lines += ["static void hexes(const double *x)"]
    lines += ['{\n    printf("%a %a %a\\n", x[0], x[1], x[2]);\n}', "int main(void)", "{"]
    for name in names:
        method, prefix = resolve_method(name), identifier(name)
        functions = "field, flow, dexpinv" if on_algebra(method) else "field, flow"
        rows = len(sums_of(method)) or int(method.embedded_order is not None)
        second = "second, " if rows else ""
        lines += [
            "    {", f"        double y[3] = {{{START[0]}, {START[1]}, {START[2]}}};",
            f"        double second[6], work[{prefix.upper()}_WORK(3, 3)];",
            f"        if ({prefix}_step({functions}, 0, 3, 3, {TIME}, {STEP}, y, {second}work))",
            "            return 1;", "        hexes(y);",
            *(f"        hexes(second + {3 * k});" for k in range(rows)), "        (void)second;",
            "    }",
        ]  # fmt: skip
    return "\n".join([*lines, "    return 0;", "}"])


def check_c(names, folder):
    headers = []
    for name in names:
        header = folder / f"{identifier(name)}.h"
        header.write_text(cg.export(name, "c"), encoding="utf-8")
        headers.append(f'#include "{header.name}"\n')
    (folder / "program.c").write_text("".join(headers) + c_program(names), encoding="utf-8")
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    output_of("gcc", *flags, "program.c", "-o", "program", folder=folder)
    agree(output_of(folder / "program", folder=folder), names)


Q, R, S, E = cg.frames.UnitQuaternion, cg.frames.SO3, cg.frames.Sphere(2), cg.frames.Euclidean(3)
FRAMES = [
    R(), R("space"), Q(), Q("space"), Q(scalar_first=True), S, E, cg.frames.Power(S, 2),
    cg.frames.Product(E, Q("space", scalar_first=True), R("space"), cg.frames.Power(R(), 2), S),
]  # fmt: skip
FULL = [[2.0, 0.3, -0.1], [0.3, 1.5, 0.2], [-0.1, 0.2, 2.6]]
BODIES = [
    cg.frames.PhaseSpace(Q(), [1.0, 2.0, 2.5]), cg.frames.PhaseSpace(R(), FULL),
    cg.frames.PhaseSpace(Q(scalar_first=True), [2.0, 1.0, 1.0]),
    cg.frames.PhaseSpace(cg.frames.Product(E, R("space"), Q()), (FULL, 0.7, [3.0, 1.0, 2.0])),
]  # fmt: skip
CASES = [(name, frame) for frame in FRAMES for name in ("CF4", "RKMK4")]
CASES += [(name, frame) for frame in BODIES for name in ("Leapfrog", "BlanesMoan6")]


@pytest.mark.parametrize("kind", ["double", "float"])
@pytest.mark.parametrize(("name", "frame"), CASES, ids=repr)
def test_flows_of_frames_in_c(name, frame, kind, tmp_path):
    """Ten steps of a field that depends on the point; it is zero at first."""
    mechanical = frame in BODIES
    steps = 1 if mechanical and kind == "float" else 10
    prefix, start = identifier(name), frame.random_point(np.random.default_rng(5))
    macro = prefix.upper()
    (tmp_path / "step.h").write_text(cg.export(name, "c", frame=frame), encoding="utf-8")
    dexpinv = f", {prefix}_frame_dexpinv" if name == "RKMK4" else ""
    size, work = ("", "") if mechanical else (f"{macro}_N, {macro}_M,", ", work")
    functions = "f" if mechanical else f"f, {prefix}_frame_flow{dexpinv}"
    macros = f"""
#define {macro}_REAL float
#define {macro}_NUMBER(x) x##f
#define {macro}_MATH(function) function##f
"""
    (tmp_path / "program.c").write_text(f"""{macros if kind == "float" else ""}
#include <stdio.h>
#include "step.h"
static int f({kind} t, const {kind} *y, {kind} *v, void *data)
{{
    (void)data;
    for (int i = 0; i < {macro}_M; i++)
        v[i] = t * (y[(i + 1) % {macro}_N] - y[i % {macro}_N] / 2);
    return 0;
}}
int main(void)
{{
    {kind} y[] = {{{", ".join(f"({kind}){x!r}" for x in start.ravel().tolist())}}};
    {"" if mechanical else f"{kind} work[{macro}_WORK({macro}_N, {macro}_M)];"}
    int k;
    for (k = 0; k < {steps}; k++)
        if ({prefix}_step({functions}, 0, {size}
                ({kind})0.25 * ({kind})k, ({kind})0.25, y{work}))
            return 1;
    for (k = 0; k < {macro}_N; k++) printf("%.17g ", (double)y[k]);
    return 0;
}}
""", encoding="utf-8")  # fmt: skip
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    output_of("gcc", *flags, "program.c", "-o", "program", "-lm", folder=tmp_path)
    actual = [float(x) for x in output_of(tmp_path / "program", folder=tmp_path).split()]

    def f(t, y):
        y = y.ravel()
        return t * np.array(
            [y[(i + 1) % y.size] - 0.5 * y[i % y.size] for i in range(frame.rhs_dim)]
        )

    expected = cg.integrate(f, (0, 0.25 * steps), start, frame=frame, method=name, h=0.25).y[-1]
    bound, off = (1e-14, 1e-15) if kind == "double" else (1e-6, 5e-7)
    bound *= max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected.ravel(), rtol=0, atol=bound)
    assert frame.membership_error(np.reshape(actual, start.shape)) < off * max(
        1.0, np.abs(expected).max()
    )


@pytest.mark.parametrize(("method", "frame"), [
    (cg.Tableau([[], ["1/2"]], [0, 1], source="@flows@ @NAME@ */"), R()),
    (cg.Splitting([0, 1, 0], ["1/2", "1/2"], source="@flows@ @moves@ */"), BODIES[0]),
], ids=["flows", "drifts"])  # fmt: skip
def test_sources_are_no_part_of_templates(method, frame):
    assert cg.export(method, "c", frame=frame).splitlines()[1] == f"// {method.source}"


def test_frames_without_flows_in_c():
    for frame in (cg.frames.SE3(), cg.frames.GL(2), cg.frames.Product(E, cg.frames.SO(4))):
        with pytest.raises(ValueError, match="frame must be UnitQuaternion, SO3, "):
            cg.export("CF4", "c", frame=frame)
    with pytest.raises(ValueError, match="frame must be None unless format is 'c'"):
        cg.export("CF4", "python", frame=E)
    with pytest.raises(ValueError, match="without spheres"):
        cg.export("Leapfrog", "c", frame=cg.frames.PhaseSpace(S))
    rod = cg.frames.Joint("distance", (None, [0, 0, 0]), (0, [0, 0, 0]), length=1.0)
    for options in (
        {"gyroscopic": np.ones(3)}, {"joints": [rod]}, {"constraints": lambda q: [q @ q - 1]}
    ):  # fmt: skip
        with pytest.raises(ValueError, match="without gyroscopic forces, joints and constraints"):
            cg.export(
                "Leapfrog", "c", frame=cg.frames.PhaseSpace(cg.frames.Euclidean(3), 1.0, **options)
            )
    refuses(ValueError, "frame must be a PhaseSpace", cg.export, "Leapfrog", "c", frame=Q())
    refuses(TypeError, "frame must be a Frame", cg.export, "CF4", "c", frame="SO3")


@pytest.mark.parametrize("names", [SOME, *slow(ALL)], ids=["some", "all"])
@pytest.mark.parametrize("check", [check_python, check_c])
def test_methods(check, names, tmp_path):
    check(names, tmp_path)


NO_FLOWS = {
    "one stage": cg.Tableau([[]], [0], name="Still"),
    "two stages": cg.Tableau([[], [0]], [0, 0], name="Still"),
    "a pair": cg.Tableau([[]], [0], b_embedded=[1], name="Still"),
    "tiny": cg.Tableau([[], ["1e-400"]], ["-1e-9999", "1e-320"], name="Still"),
}


@pytest.mark.parametrize("what", NO_FLOWS)
def test_methods_without_flows(what, tmp_path):
    """Tables are empty for methods without flows."""
    for format, suffix in (("c", "c"), ("python", "py")):
        text = cg.export(NO_FLOWS[what], format)
        (tmp_path / f"still_step.{suffix}").write_text(text, encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-c"]
    output_of("gcc", *flags, "still_step.c", folder=tmp_path)
    names = {}
    exec((tmp_path / "still_step.py").read_text(encoding="utf-8"), names)
    point = names["step"](lambda t, y: [1.0], lambda v, y: y + v, 0.0, np.ones(1), 0.1)
    assert point == (1.1 if what == "a pair" else 1.0)


def swapped():
    """Return pairs whose second result has the higher order."""
    rows = cg.methods["CG2(3)"]
    yield cg.Tableau(rows.entries, rows.embedded_weights, b_embedded=rows.weights)
    flat = cg.methods["RKMK3(2)"].tableau
    tableau = cg.Tableau(flat.entries, flat.embedded_weights, b_embedded=flat.weights)
    yield cg.MuntheKaas(tableau)
    points = [(-1, {0: "1/3"}), (-1, {1: "2/3"}), (0, {0: "-1/12", 2: "3/4"})]
    yield cg.CommutatorFree([*points, (-1, {1: 1})], [-1, 0, 1], 3, embedded_result=2)


@pytest.mark.parametrize("method", list(swapped()), ids=lambda method: type(method).__name__)
def test_step_has_the_higher_order(method):
    assert method.embedded_order > method.order
    names = {}
    exec(cg.export(method, "python"), names)
    functions = [field, Heisenberg().flow]
    functions += [dexpinv] * on_algebra(method)
    start = np.array(START)
    actual = names["step"](*functions, TIME, start, STEP)
    step = Step(field, Heisenberg(), method)
    np.testing.assert_array_equal(actual, step(TIME, start, STEP))
    if on_algebra(method):
        point, error = names["step_error"](*functions, TIME, start, STEP)
        expected = errors_of(method, step)
        np.testing.assert_array_equal(error, expected)
    else:
        point, second = names["step_pair"](*functions, TIME, start, STEP)
        np.testing.assert_array_equal(second, step.pair(TIME, start, STEP)[1])
    np.testing.assert_array_equal(point, actual)


@pytest.mark.parametrize("name", ["CF4", "RKMK4"])
def test_python_step_of_symbols_of_casadi(name):
    ca = pytest.importorskip("casadi")
    names = {}
    exec(cg.export(name, "python"), names)
    y, h = ca.SX.sym("y", 3), ca.SX.sym("h")

    def field(t, y):
        return ca.vertcat(0.3 + y[1] * y[2] - 0.5 * t, y[0] * y[0] - 0.2 * y[2], t * y[0] + y[1])

    def flow(v, y):
        return y + ca.vertcat(v[0], v[1], v[2] + 0.5 * (y[0] * v[1] - y[1] * v[0]))

    def dexpinv(u, v):
        return ca.vertcat(v[0], v[1], v[2] - 0.5 * (u[1] * v[0] - u[0] * v[1]))

    functions = (field, flow, dexpinv) if name == "RKMK4" else (field, flow)
    step = ca.Function("step", [y, h], [names["step"](*functions, TIME, y, h)])
    np.testing.assert_allclose(step(START, STEP).full().ravel(), ours(name)[0], rtol=1e-15)
