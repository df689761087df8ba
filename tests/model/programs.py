"""Random programs of calls of `cg`, as plain numbers and names, and the script that each one is.

The comparison runs the text of the script, so that a failure is printed as what was run.
"""

import hashlib
import importlib
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.model.reference import Task, curve
from tests.model.spaces import SPACES, Space, reals

FOLDER = tempfile.TemporaryDirectory()

SCRIPT = """import copy, ctypes, pickle, subprocess, tempfile
import numpy as np
import cg
{space.prelude}
frame = {space.expression}
y0, other = np.array({y0}), np.array({other})
rng, span = np.random.default_rng({self.seed}), ({self.start!r}, {until})
w = {follows} * rng.uniform(-1, 1, ({space.dim}, {size}))
rate, at = {rate!r}, np.array({at})
speed = {speed!r} * rng.uniform(-1, 1, {space.dim})
phase = rng.uniform(-3, 3, {space.dim}) - speed * span[0]
gain = rate * rng.uniform(-1, 1, ({space.dim}, {inputs}))
edge = {edge} * rng.uniform(-0.5, 0.5, {size})
room = {room} - float(edge @ y0.view(float).ravel())
parameters = np.array([0.8, 0.3])
"""
SAMPLES = """
times{k} = np.linspace({low!r}, {high!r}, {edges})
values{k} = {u.scale!r} * (np.random.default_rng({u.seed}).random({u.count}) - 0.5)
values{k}[{zeros}] = 0
gain[:, {k}] /= {u.scale!r}
samples{k} = cg.Samples(times{k}, values{k}, {kind})
mirrored{k} = cg.Samples(times{k}, values{k}[::-1], {kind})
moved = np.pad(np.full({edges} - 2, np.diff(times{k}).min() / 3), 1)
moved{k} = cg.Samples(times{k} + moved, values{k}[::-1], {kind})
members{k} = cg.Samples(
    times{k}, np.stack([values{k}, values{k}[::-1], values{k}]), {kind}, members=True)
swapped{k} = cg.Samples(
    times{k}, np.stack([values{k}[::-1], values{k}, values{k}[::-1]]), {kind}, members=True)
"""
FUNCTION = """
def python(t, y{further}):
    z = np.reshape(y{view}, (*np.shape(t), 1, -1))
    v = rate * np.sin((w * z).sum(-1) + np.multiply.outer(t, speed) + phase)
    v = v * np.prod(1 - 2 * (np.asarray(t)[..., None] >= at), -1)[..., None]
    v = (v{driven}) * np.sqrt(room + (z * edge).sum(-1))
    v = {mixed}
    return v.reshape(*np.shape(t), {returned})
f = python
"""
OF_POINT = """
def f(t, y{further}): return frame.field(python(t, y{further}), y)
"""
OF_TIME = """
def f(t{further}):
    return python(t, np.broadcast_to(y0, (*np.shape(t), *y0.shape)){further})
"""
IN_C = """
def table(array): return "{" + ", ".join(map(repr, [*np.ravel(array).tolist(), 0.0])) + "}"
source = f\"\"\"#include <math.h>
int f(double t, const double *y, double *v, void *data) {{
    const int n = {w.shape[1]}, dim = {len(w)}, inputs = {gain.shape[1]}, breaks = {len(at)};
    const double w[] = {table(w)}, at[] = {table(at)}, edge[] = {table(edge)};
    const double speed[] = {table(speed)}, phase[] = {table(phase)}, gain[] = {table(gain)};
    const double *p = data, *u = p + COUNT;
    double size = {rate}, root = {room}, turned[dim];
    for (int k = 0; k < breaks; k++) if (t >= at[k]) size = -size;
    for (int j = 0; j < n; j++) root += edge[j] * y[j];
    for (int i = 0; i < dim; i++) {{
        double angle = speed[i] * t + phase[i];
        for (int j = 0; j < n; j++) angle += w[i * n + j] * y[j];
        v[i] = size * sin(angle);
        for (int j = 0; j < inputs; j++) v[i] += gain[i * inputs + j] * u[j];
        turned[dim - 1 - i] = v[i] *= sqrt(root);
    }}
    for (int i = 0; i < dim && COUNT; i++) v[i] = p[0] * v[i] + p[1] * turned[i];
    return 0;
}}\"\"\"
library = tempfile.mkdtemp() + "/f.so"
subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-x", "c", "-o", library, "-", "-lm"],
               input=source, text=True, check=True)
f = cg.CompiledFunction(library, "f")
"""
IN_NUMBA = """
import numba
inner, doubles = ctypes.CDLL(library).f, ctypes.POINTER(ctypes.c_double)
inner.argtypes = [ctypes.c_double, doubles, doubles, ctypes.c_void_p]
real = numba.types.CPointer(numba.float64)
@numba.cfunc(numba.int32(numba.float64, real, real, numba.types.voidptr))
def f(t, y, v, data): return inner(t, y, v, data)
"""
PLANE = """
normal{k} = np.random.default_rng({zero.seed}).random({size}) - 0.5
normal{k} /= np.linalg.norm(normal{k})
level{k} = float(normal{k} @ y0.view(float).ravel()) + ({zero.place} - 0.5)
"""
EVENT = """
def event{k}(t, y{further}): return {body}
def jump{k}(t, y, *rest): return {zero.jump}
crossing{k} = cg.Event(event{k}, {zero.terminal}, {zero.direction}, {jump}, {period})
"""


class Record:
    """Numbers and names, of which those that aren't the default are printed."""

    def __repr__(self) -> str:
        values = {f.name: (getattr(self, f.name), f.default) for f in fields(self)}  # type: ignore[arg-type]
        changed = [f"{name}={value!r}" for name, (value, own) in values.items() if value != own]
        return f"{type(self).__name__}({', '.join(changed)})"


@dataclass(frozen=True, repr=False)
class Zero(Record):
    """An event: ``"time"`` at a share of the span, ``"plane"`` where a function of y is zero.

    ``"input"`` is a plane that the first input moves, ``"edge"`` is before the edge of f's domain,
    and ``"copy"`` the event before it with a function that is less by ``place``, 0, or 1e-10.
    With a period the function wraps, at its zeros and halfway between them.
    """

    kind: str = "plane"
    place: float = 0.3  # share of the span, the level of a plane plus 1/2, or the distance from it
    seed: int = 0  # of the plane's normal
    terminal: int = 0  # the number of the occurrence that ends the solution, 0 for none
    direction: int = 0
    jump: str = ""  # the name of the point that the solution jumps to, empty for none
    period: bool = False


@dataclass(frozen=True, repr=False)
class Input(Record):
    """Samples of a function of time; ``idle`` ones are zero but for a tenth at the end."""

    kind: str = "linear"
    count: int = 4  # of samples
    seed: int = 0  # of their values
    scale: float = 1.0  # of their values, which f divides by it
    idle: bool = False
    members: bool = False  # whether members of an ensemble have values of their own


@dataclass(frozen=True, repr=False)
class Program(Record):
    """Calls of `cg` for one problem, with everything that it involves.

    Times are shares of the span.
    """

    space: int = 0  # the number of the frame in `SPACES`
    seed: int = 0  # of the initial point and of the coefficients in f
    # f
    form: str = "state"  # what f depends on: "state" and time, "time" alone, or "constant"
    turns: float = 1.0  # the size of f times the span
    speed: float = 1.0  # of the phases of f: radians in the span, at most
    parameters: bool = False
    inputs: tuple[Input, ...] = ()
    breaks: tuple[float, ...] = ()  # times at which f changes its sign
    compiled: str = ""  # "c", or "numba", which calls the function in C; empty for Python
    rhs: str = "coefficients"
    linear: bool = False
    # the span
    start: float = 0.0
    length: float = 1.0  # negative backward in time
    endless: bool = False  # whether the span has no end, so that an event ends the solution
    # steps
    method: str = "auto"
    steps: float = 0.0  # number of equal steps, 0 to choose their sizes
    rtol: float = 1e-6
    atol: float = 1e-6
    arrays: str = ""  # which tolerances are arrays: "atol", or "rtol, atol"
    first_step: float = 0.0  # 0 for the default
    max_step: float = 0.0
    # what is asked for
    output: tuple[float, ...] | None = None  # times of output, None for the ends of steps
    dense: bool = False
    observe: bool = False
    events: tuple[Zero, ...] = ()
    derivatives: str = ""  # "forward" or "adjoint"
    callers: tuple[str, ...] = ()  # names of `compare.CALLERS`: other runs to compare with

    @property
    def frame(self) -> Space:
        return SPACES[self.space]

    @property
    def end(self) -> float:
        return self.start + self.length

    @property
    def edge(self) -> bool:
        """Whether f has a domain."""
        return any(zero.kind == "edge" for zero in self.events)

    @property
    def noisy(self) -> bool:
        """Whether there is noise, which isn't admitted backward in time."""
        return self.derivatives == "forward" and self.length > 0

    def at(self, share: float) -> float:
        """Return the time at a share of the span, to the bit the end for one."""
        return self.end if share == 1.0 else self.start + share * self.length

    def times(self, shares: Sequence[float]) -> list[float]:
        return sorted({self.at(s) for s in shares}, reverse=self.length < 0)

    def script(self) -> str:
        """Return the definitions of f, y0, frame, options and all that they need."""
        space, size = self.frame, reals(self.frame.base).size
        moving = 0.0 if self.form == "constant" else self.speed
        infinity = "np.inf" if self.length > 0 else "-np.inf"
        names = [f"u[{k}]" for k in range(len(self.inputs))] if len(self.inputs) > 1 else ["u"]
        further = ", u" * bool(self.inputs) + ", p" * self.parameters
        driven = [f" + np.multiply.outer({name}, gain[:, {k}])" for k, name in enumerate(names)]
        scale = self.inputs[0].scale if self.inputs else 1.0
        text = SCRIPT.format(
            self=self, space=space, size=size, y0=space.start(self.seed).tolist(),
            other=space.start(self.seed + (not self.edge and not self.endless)).tolist(),
            until=infinity if self.endless else repr(self.end), at=self.times(self.breaks),
            follows=float(self.form == "state"), rate=self.turns / (abs(self.length) or 1.0),
            speed=moving / (abs(self.length) or 1.0), inputs=len(self.inputs), edge=int(self.edge),
            room=0.3 if self.edge else 1.0,
        )  # fmt: skip
        text += "".join(self._samples(k, u) for k, u in enumerate(self.inputs))
        text += FUNCTION.format(
            further=further, driven="".join(driven[: len(self.inputs)]),
            view=".view(float)" * np.iscomplexobj(space.base),
            mixed="v * p[..., :1] + p[..., 1:] * v[..., ::-1]" if self.parameters else "v",
            returned=", ".join(map(str, space.returned)),
        )  # fmt: skip
        text += OF_POINT.format(further=further) if self.rhs == "derivative" else ""
        text += OF_TIME.format(further=further) if self.linear else ""
        text += IN_C.replace("COUNT", str(2 * self.parameters)) if self.compiled else ""
        text += IN_NUMBA if self.compiled == "numba" else ""
        for k, zero in enumerate(self.events):
            point = "np.ascontiguousarray(y).view(float).ravel()"
            body = {
                "time": f"t - {self.at(zero.place)!r}",
                "edge": f"float(room + edge @ {point}) - {zero.place!r}",
                "plane": f"float(normal{k} @ {point}) - level{k}",
                "copy": f"event{k - 1}(t, y{further}) - "
                        f"{(zero.place, 0.0, 1e-10)[zero.seed % 3]!r}",
            }  # fmt: skip
            body["input"] = f"{body['plane']} + {0.3 / scale!r} * {names[0]}"
            text += PLANE.format(k=k, zero=zero, size=size)
            jump = f"jump{k}" if zero.jump else None
            period, function = None, body[zero.kind]
            if zero.period:  # more than twice what the function changes between comparisons
                period = 0.6 * abs(self.length) if zero.kind == "time" else 3.0 + 2.0 * self.turns
                function = f"({function}) % {period!r}"
            text += EVENT.format(
                k=k, zero=zero, further=further, jump=jump, body=function, period=period
            )
        return f"{text}\noptions = dict({', '.join(self._options())})\n"

    def _samples(self, k: int, u: Input) -> str:
        low, high = sorted((self.start, self.start + self.length * (1 + 1e-3 * k)))
        zeros = f":{u.count - u.count // 10}" if u.idle else f"{u.count // 3}:{u.count // 2}"
        return SAMPLES.format(
            k=k, u=u, low=low, high=high, zeros=zeros,
            edges=u.count + (u.kind in ("averages", "causal")),
            kind="'averages', causal=True" if u.kind == "causal" else repr(u.kind),
        )  # fmt: skip

    def _options(self) -> list[str]:
        length, n = abs(self.length), self.frame.coordinates
        shape = self.frame.base.shape if self.frame.entries else (n,)
        varied = f" * np.resize([1.0, 0.3], {shape})"
        adaptive = [
            *(f"{name}={getattr(self, name)!r}{varied * (name in self.arrays)}"
              for name in ("rtol", "atol")),
            *(f"{name}={getattr(self, name) * length!r}"
              for name in ("first_step", "max_step") if getattr(self, name)),
        ]  # fmt: skip
        events = ", ".join(f"crossing{k}" for k in range(len(self.events)))
        given = {
            f"method={self.method!r}": self.method != "auto",
            f"t_eval={self.times(self.output or ())}": self.output is not None,
            "dense_output=True": self.dense,
            f"events=[{events}]": self.events,
            "breakpoints=at": self.breaks,
            f"inputs={self.named_inputs('samples')}": self.inputs,
            "parameters=parameters": self.parameters,
            "rhs='derivative'": self.rhs == "derivative" or self.frame.returned != (-1,),
            "linear=True": self.linear,
            f"derivatives={self.derivatives!r}": self.derivatives,
            f"control_derivatives=True, P0=0.1 * np.eye({n})": self.derivatives == "forward",
            f"noise=np.diag(np.arange(1.0, {n + 1}) / {length!r})": self.noisy,
        }
        sizes = [f"h={length / self.steps!r}"] if self.steps else adaptive
        return ["frame=frame", *sizes, *(text for text, value in given.items() if value)]

    def named_inputs(self, name: str) -> str:
        """Return the expression of ``inputs``; those that members have of their own have a name."""
        own = [f"{name if u.members else 'samples'}{k}" for k, u in enumerate(self.inputs)]
        return f"({', '.join(own)})" if len(own) > 1 else "".join(own)

    def build(self) -> dict[str, Any]:
        """Run the script, as a module that other processes can import; return its names."""
        text = self.script()
        name = f"program_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        if FOLDER.name not in sys.path:
            sys.path.append(FOLDER.name)
        Path(FOLDER.name, f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        tempfile.tempdir, own = FOLDER.name, tempfile.tempdir
        try:
            return vars(importlib.import_module(name))
        finally:
            tempfile.tempdir = own

    def task(self, names: dict[str, Any], step: float = 0.0, **changes: Any) -> Task:
        """Return the problem for the model, with arguments changed by a step along ``changes``."""

        def changed(name: str) -> np.ndarray:
            return reals(names[name]) + step * changes.get(name, 0.0)

        curves = [curve(u.kind, names[f"times{k}"], changed(f"values{k}"))
                  for k, u in enumerate(self.inputs)]  # fmt: skip
        task = Task(
            self.frame, names["python"],
            (self.start, self.start + 4 * self.length if self.endless else self.end),
            names["y0"], names["options"].get("events", ()), self.times(self.breaks), curves,
            [t for k in range(len(self.inputs)) for t in names[f"times{k}"].tolist()],
            (changed("parameters"),) if self.parameters else (),
        )  # fmt: skip
        return replace(task, y0=task.point(changed("y0")))
