"""Random programs of calls of `cg`: what hypothesis draws, and the script that each one is.

A `Program` consists of plain numbers and names. Its `script` is the text of the functions and
arguments; the comparison runs this text, so that a failure is printed as what was run.
"""

import ctypes
import hashlib
import sys
import types
from dataclasses import dataclass, fields

import numpy as np

from tests.model.reference import Crossing, Task, curve
from tests.model.spaces import SPACES, Space

PAIRS = (
    "auto", "BS3(2)", "CF4(3)", "CF5(4)", "CF6(5)", "CG2(3)", "CG3(2)", "CG4(3)", "CG5(4)",
    "CG6(5)", "DP5(4)", "DVERK6(5)", "DOP853", "Verner7(6)", "RKMK3(2)", "RKMK5(4)", "RKMK8(5,3)",
    "RadauIIA5",
)  # fmt: skip
FIXED = (
    "LieEuler", "CG2", "CG3", "CF3", "CF4", "CF4b", "CG4b", "CF5(4)", "CF5r", "RKMK4", "RKMK5(4)",
    "RKMK8(5,3)", "ImplicitMidpoint", "DICG4b",
)  # fmt: skip
SPLITTINGS = ("Leapfrog", "McLachlan2", "BlanesMoan4", "BlanesMoan6")

DOUBLES = ctypes.POINTER(ctypes.c_double)

C_SOURCE = """
#include <math.h>
int f(double t, const double *y, double *v, void *data)
{
    const int n = %d, dim = %d, inputs = %d, breaks = %d;
    const double at[] = {%s};
    const double *w = data, *speed = w + dim * n, *phase = speed + dim, *gain = phase + dim;
    const double *size = gain + dim * inputs, *u = size + 1;
    double sign = 1;
    for (int k = 0; k < breaks; k++)
        if (t >= at[k]) sign = -sign;
    for (int i = 0; i < dim; i++) {
        double angle = speed[i] * t + phase[i];
        for (int j = 0; j < n; j++) angle += w[i * n + j] * y[j];
        v[i] = sign * size[0] * sin(angle);
        for (int j = 0; j < inputs; j++) v[i] += gain[i * inputs + j] * u[j];
    }
    return 0;
}
"""

COMPILED = """
with tempfile.TemporaryDirectory() as folder:
    subprocess.run(
        ["gcc", "-O1", "-shared", "-fPIC", "-x", "c", "-o", f"{folder}/f.so", "-", "-lm"],
        input=C_SOURCE, text=True, check=True,
    )
    function = ctypes.CDLL(f"{folder}/f.so").f
doubles = ctypes.POINTER(ctypes.c_double)
function.argtypes = [ctypes.c_double, doubles, doubles, ctypes.c_void_p]
"""


@dataclass(frozen=True)
class Zero:
    """An event: ``"time"`` at a share of the span, ``"plane"`` where a function of y is zero.

    ``"copy"`` is the event before it, with a function that is less by ``place``, 0, or 1e-10.
    """

    kind: str
    place: float
    seed: int
    terminal: int
    direction: int
    jump: str


@dataclass(frozen=True)
class Input:
    """Samples of a function of time; ``idle`` ones are zero but for a tenth at the end."""

    kind: str
    count: int
    seed: int
    scale: float
    idle: bool = False


@dataclass(frozen=True)
class Program:
    """One call of `cg`, with everything that it involves. Times are shares of the span."""

    space: int = 0
    seed: int = 0
    form: str = "state"
    turns: float = 1.0
    speed: float = 1.0
    start: float = 0.0
    length: float = 1.0
    endless: bool = False
    method: str = "auto"
    steps: float = 0.0
    rtol: float = 1e-6
    atol: float = 1e-6
    output: tuple[float, ...] | None = None
    dense: bool = False
    observe: bool = False
    events: tuple[Zero, ...] = ()
    breaks: tuple[float, ...] = ()
    inputs: tuple[Input, ...] = ()
    parameters: bool = False
    compiled: bool = False
    caller: str = "solve_ivp"

    @property
    def frame(self) -> Space:
        return SPACES[self.space]

    @property
    def end(self) -> float:
        return self.start + self.length

    def at(self, share: float) -> float:
        """Return the time at a share of the span, to the bit the end for one."""
        return self.end if share == 1.0 else self.start + share * self.length

    def times(self, shares) -> list[float]:
        return sorted({self.at(s) for s in shares}, reverse=self.length < 0)

    def __repr__(self) -> str:
        changed = [
            f"{f.name}={getattr(self, f.name)!r}"
            for f in fields(self)
            if getattr(self, f.name) != f.default
        ]
        return f"Program({', '.join(changed)})"

    def script(self) -> str:
        """Return the definitions of f, y0, frame, options and all that they need."""
        space, n = self.frame, self.frame.base.view(float).size
        parts = ["import numpy as np", "import cg", ""]
        if self.compiled:
            parts[:1] = ["import ctypes, subprocess, tempfile", "import numpy as np"]
        point = space.start(self.seed)
        other = space.start(self.seed + 1)
        parts += [
            *filter(None, [space.prelude]),
            f"frame = {space.expression}",
            f"y0 = np.array({point.tolist()})",
            f"other = np.array({other.tolist()})",
            f"rng = np.random.default_rng({self.seed})",
            f"w = {float(self.form == 'state')} * rng.uniform(-1, 1, ({space.dim}, {n}))",
            f"speed = {self._speed()!r} * rng.uniform(-1, 1, {space.dim})",
            f"phase = rng.uniform(-3, 3, {space.dim}) - speed * {self.start!r}",
            f"gain = {self._rate()!r} * rng.uniform(-1, 1, ({space.dim}, {len(self.inputs)}))",
            f"at = np.array({self.times(self.breaks)})",
            *self._samples(),
            *self._function(),
            *(line for k in range(len(self.events)) for line in self._event(k)),
            f"span = ({self.start!r}, {'np.inf' if self.endless else repr(self.end)})".replace(
                "np.inf", "np.inf" if self.length > 0 else "-np.inf"
            ),
            f"options = dict({', '.join(self._options())})",
        ]
        return "\n".join(parts)

    def _rate(self) -> float:
        return self.turns / (abs(self.length) or 1.0)

    def _speed(self) -> float:
        return 0.0 if self.form == "constant" else self.speed / (abs(self.length) or 1.0)

    def _samples(self) -> list[str]:
        lines = []
        for k, samples in enumerate(self.inputs):
            edges = samples.count + (samples.kind in ("averages", "causal"))
            low, high = sorted((self.start, self.start + self.length * (1 + 1e-3 * k)))
            kind = "averages" if samples.kind == "causal" else samples.kind
            count = samples.count
            zeros = f":{count - count // 10}" if samples.idle else f"{count // 3}:{count // 2}"
            lines += [
                f"times{k} = np.linspace({low!r}, {high!r}, {edges})",
                f"values{k} = np.random.default_rng({samples.seed}).random({samples.count}) - 0.5",
                f"values{k}[{zeros}] = 0",
                f"samples{k} = cg.Samples(times{k}, {samples.scale!r} * values{k}, {kind!r}"
                f"{', causal=True' if samples.kind == 'causal' else ''})",
                f"gain[:, {k}] /= {samples.scale!r}",
            ]
        return lines

    def _function(self) -> list[str]:
        if self.compiled:
            at = self.times(self.breaks)
            sizes = self.frame.base.view(float).size, self.frame.dim, len(self.inputs), len(at)
            source = C_SOURCE % (*sizes, ", ".join(map(repr, at or [0.0])))
            return [
                f'C_SOURCE = """{source}"""{COMPILED}f = function',
                "parameters = np.concatenate([w.ravel(), speed, phase, gain.ravel(), "
                f"[{self._rate()!r}]])",
            ]
        lines = [
            f"def f(t, y{', u' if self.inputs else ''}{', p' if self.parameters else ''}):",
            "    z = np.ascontiguousarray(y).view(float).reshape(*np.shape(t), 1, -1)",
            "    v = np.sin((w * z).sum(-1) + np.multiply.outer(t, speed) + phase)",
            f"    v = {self._rate()!r} * v"
            + (" * np.prod(1 - 2 * (np.asarray(t)[..., None] >= at), -1)[..., None]"
               if self.breaks else ""),
        ]  # fmt: skip
        names = ["u"] if len(self.inputs) == 1 else [f"u[{k}]" for k in range(len(self.inputs))]
        lines += [f"    v = v + np.multiply.outer({n}, gain[:, {k}])" for k, n in enumerate(names)]
        if self.parameters:
            lines += ["    v = v * p[..., :1] + p[..., 1:] * v[..., ::-1]"]
        shape = ", ".join(map(str, self.frame.returned))
        lines += [f"    return v.reshape(*np.shape(t), {shape})"]
        lines += ["parameters = np.array([0.8, 0.3])"]
        return lines

    def _event(self, k: int) -> list[str]:
        zero = self.events[k]
        body = f"t - {self.at(zero.place)!r}"
        if zero.kind == "plane":
            lines = [
                f"normal{k} = np.random.default_rng({zero.seed}).random(y0.view(float).size) - 0.5",
                f"normal{k} /= np.linalg.norm(normal{k})",
                f"level{k} = float(normal{k} @ y0.view(float).ravel()) + {zero.place - 0.5!r}",
            ]
            body = f"float(normal{k} @ np.ascontiguousarray(y).view(float).ravel()) - level{k}"
        else:
            lines = []
        if zero.kind == "copy" and k:
            body = f"event{k - 1}(t, y) - {(zero.place, 0.0, 1e-10)[zero.seed % 3]!r}"
        target = {"start": "y0", "other": "other"}.get(zero.jump)
        jump = f"def jump{k}(t, y, *rest): return {target}" if target else f"jump{k} = None"
        return [*lines, f"def event{k}(t, y, *rest): return {body}", jump]

    def _options(self) -> list[str]:
        items = ["frame=frame"]
        if self.method != "auto":
            items.append(f"method={self.method!r}")
        if self.steps:
            items.append(f"h={abs(self.length) / self.steps!r}")
        else:
            items.append(f"rtol={self.rtol!r}")
            items.append(f"atol={self.atol!r}")
        if self.frame.returned != (-1,):
            items.append("rhs='derivative'")
        if self.output is not None:
            items.append(f"t_eval={self.times(self.output)}")
        if self.dense:
            items.append("dense_output=True")
        if self.events:
            names = [
                f"cg.Event(event{k}, terminal={zero.terminal}, direction={zero.direction}, "
                f"jump=jump{k})"
                for k, zero in enumerate(self.events)
            ]
            items.append(f"events=[{', '.join(names)}]")
        if self.breaks:
            items.append("breakpoints=at")
        if self.inputs:
            names = [f"samples{k}" for k in range(len(self.inputs))]
            items.append(f"inputs=({', '.join(names)}{',' if len(names) > 1 else ''})")
        if self.parameters or self.compiled:
            items.append("parameters=parameters")
        return items

    def build(self) -> dict:
        """Return the names of the script, in a module that pickles can refer to."""
        text = self.script()
        name = f"program_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        module = types.ModuleType(name)
        module.__dict__["__name__"] = name
        exec(compile(text, name, "exec"), module.__dict__)
        sys.modules[name] = module
        return module.__dict__

    def task(self, names: dict) -> Task:
        """Return the same problem for the model."""
        curves, knots = [], []
        for k, samples in enumerate(self.inputs):
            times, values = names[f"times{k}"], samples.scale * names[f"values{k}"]
            kind = "averages" if samples.kind == "causal" else samples.kind
            curves.append(curve(kind, times, values, samples.kind == "causal"))
            knots += times.tolist()
        function = names["f"]
        if self.compiled:
            function = _in_python(function, self.frame.dim)
        return Task(
            self.frame, function,
            (self.start, self.start + 20 * self.length if self.endless else self.end),
            names["y0"],
            [
                Crossing(names[f"event{k}"], zero.terminal, zero.direction, names[f"jump{k}"])
                for k, zero in enumerate(self.events)
            ],
            self.times(self.breaks), curves, knots,
            (names["parameters"],) if self.parameters or self.compiled else (),
        )  # fmt: skip


def _in_python(function, dim):
    def f(t, y, *rest):
        values = [np.ravel(np.array(value, dtype=float)) for value in (rest[-1], *_flat(rest[:-1]))]
        data, point, v = np.concatenate(values), np.ascontiguousarray(y), np.empty(dim)
        function(t, point.ctypes.data_as(DOUBLES), v.ctypes.data_as(DOUBLES), data.ctypes.data)
        return v

    return f


def _flat(inputs):
    return inputs[0] if inputs and isinstance(inputs[0], tuple) else inputs
