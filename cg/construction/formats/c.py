"""A step in C: a header file."""

import numpy as np

from cg.construction.formats.code import (
    Program,
    array,
    comment,
    fill,
    identifier,
    reals,
    template,
    write,
)
from cg.construction.formats.digits import Numbers
from cg.frames.base import Frame
from cg.frames.inertia import rows_times
from cg.frames.phase_space import PhaseSpace
from cg.support.shared_numbers import BlockKind, BlockOption


def to_c(program: Program, frame: Frame | None) -> str:
    """Return a header with the step, and the flow of a frame unless that is None."""
    flows = ""
    if frame is not None:
        flows = _Flows(frame).text(template("frame_flow.h"), program.name, program.on_algebra)
    return write(program, ["top.h", "step.h"], "//", _tables(program), flows)


def with_free_motion(numbers: Numbers, frame: PhaseSpace) -> str:
    """Return the header of a step of a splitting method for mechanical systems."""
    flows, name = _Flows(frame), identifier(numbers.method.name)
    if frame.gyroscopic is not None or frame.jointed:
        raise ValueError(
            "frame must be a phase space without gyroscopic forces, joints and constraints, got "
            f"{frame!r}"
        )
    values = [numbers.decimal(value) for value in numbers.values]
    tables = [reals(name, "d", values[::2]), reals(name, "k", values[1::2])]
    lines, motion = [], None
    for k, body in enumerate(frame._bodies):
        first, size = body.vectors.start, body.vectors.stop - body.vectors.start
        if body.sphere:
            raise ValueError(f"frame must be a phase space without spheres, got {frame!r}")
        if body.top is None:
            constants, v = rows_times(np.eye(size), body.inverse), f"v[{first} + i]"
            lines.append(f"""for (int i = 0; i < {size}; i++) {{
        {v} = 0;
        for (int k = 0; k < {size}; k++)
            {v} = {v} + time * @name@_body{k}[{size} * i + k] * p[{first} + k];
    }}
    {flows.moves[k]}""")
        else:
            constants, motion = np.concatenate([body.top[:9], body.top[18:]]), "free_motion.h"
            lines.append(
                f"@name@_turn_freely(@name@_body{k}, time, p + {first}, q);\n    {flows.turns[k]}"
            )
        tables.append(reals(name, f"body{k}", map(repr, constants.ravel().tolist())))
    nodes, weights = np.polynomial.legendre.leggauss(14)
    gauss = [reals(name, "node", map(repr, (nodes[7:] ** 2).tolist()))]
    gauss += [reals(name, "weight", map(repr, weights[7:].tolist()))]
    text = fill(template("top.h", "splitting.h"), {
        "drift": "\n".join(f"    {line}" for line in lines),
        "tables": "\n".join(tables),
        "stages": str(numbers.method.stages),
        "free_motion": fill(template(motion), {"gauss": "\n".join(gauss)}) if motion else "",
    })  # fmt: skip
    heading = comment(numbers.heading, "//")
    return fill(flows.text(text, name, False), {"heading": heading})


class _Flows:
    """The flows of the blocks of a frame: rotations, unit vectors and vectors."""

    def __init__(self, frame: Frame) -> None:
        self.frame = repr(frame)
        self.moves: list[str] = []  # along the vector v
        self.turns: list[str] = []  # by the quaternion q
        self._changes, self._kinds, y, v = [], set(), 0, 0
        for kind, n, options, *_ in frame.compiled_blocks() or [(0, 0, 0)]:
            side = 1 if options & BlockOption.SPACE_AXES or kind == BlockKind.SPHERE else -1
            match kind:
                case BlockKind.EUCLIDEAN:
                    move = f"for (int i = 0; i < {n}; i++) y[{y} + i] = y[{y} + i] + v[{v} + i];"
                    size = dim = n
                case BlockKind.QUATERNION:
                    first = bool(options & BlockOption.SCALAR_FIRST)
                    vector, scalar = y + first, y + 3 * (not first)
                    move = f"@name@_turn(q, {side}, y + {vector}, y + {scalar});"
                    size, dim = 4, 3
                case BlockKind.SO3 | BlockKind.SPHERE:
                    size, dim = (9, 3) if kind == BlockKind.SO3 else (3, 3)
                    steps = "1, 3" if kind == BlockKind.SO3 and side > 0 else "3, 1"
                    move = f"@name@_rotate(q, {side}, {size // 3}, {steps}, y + {y});"
                case _:
                    raise ValueError(
                        "frame must be UnitQuaternion, SO3, Sphere(2), Euclidean, or a product or "
                        f"power of these, got {frame!r}"
                    )
            self.turns.append(move)
            if kind != BlockKind.EUCLIDEAN:
                move = f"@name@_quaternion(v + {v}, q);\n    {move}"
                self._changes.append(f"@name@_rotation_dexpinv(u + {v}, {side}, v + {v});")
            self.moves.append(move)
            self._kinds.add(kind)
            y, v = y + size, v + dim
        self._size, self._dim = y, v

    def text(self, text: str, name: str, on_algebra: bool) -> str:
        """Return a text with the flows."""
        conditions = {"algebra"} if on_algebra else set()
        if self._kinds - {BlockKind.EUCLIDEAN}:
            conditions |= {"rotations", "dexpinv"} if on_algebra else {"rotations"}
        if BlockKind.QUATERNION in self._kinds:
            conditions.add("quaternions")
        if self._kinds & {BlockKind.SO3, BlockKind.SPHERE}:
            conditions.add("vectors")
        return fill(text, {
            "moves": "\n".join(f"    {line}" for line in self.moves),
            "changes": "".join(f"    {line}\n" for line in self._changes),
            "rotations": fill(template("rotations.h"), {}, conditions),
            "n": self._size, "m": self._dim, "frame": self.frame,
            "name": name, "NAME": name.upper(),
        }, conditions)  # fmt: skip


def _tables(program: Program) -> str:
    weights = tuple(weight for move in program.moves for _, weight in move.terms)
    numbers = {"weight": weights, "c": program.c}
    if program.errors:
        numbers["error"] = tuple(weight for row in program.errors for weight in row)
    lines = [
        "/* Slots hold points; slot 0 holds the initial one. Each stage has an abscissa c, the",
        "   number of moves before it, and a slot. Each move is a flow from one slot to another,",
        "   along the weighted sum of the fields at stages. */",
    ]
    tables = program.integer_tables().items()
    lines += [array(f"static const int {program.name}_{name}", table) for name, table in tables]
    lines += [reals(program.name, name, texts) for name, texts in numbers.items()]
    return "\n".join(lines)
