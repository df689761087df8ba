"""A step of an explicit method as a list of moves between slots, and its text in a language.

A slot is a variable that holds a point; slot 0 holds the initial point. A move is a flow from the
point in one slot to a point that is stored in another slot or replaces it. The moves to a stage
precede its evaluation of f. Slots hold the points that `PathBuilder` keeps, so that a chain of
flows takes a single slot. Moves are the same in every language; in Python a step is for NumPy, or a
pure function for JAX.
"""

import re
import textwrap
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib.resources import files
from itertools import accumulate

from cg.construction.formats.digits import Numbers
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.paths import PathBuilder
from cg.construction.points import PointTree, tree_of_rows
from cg.support.parsing import visible

_WIDTH = 96
_SECTION = re.compile(r"@if (\w+)@\n?(.*?)@end \1@\n?", re.DOTALL)  # of a template


@dataclass(frozen=True)
class Move:
    """A flow from the point in slot `origin` to slot `target`, along the sum of `terms`."""

    origin: int
    target: int
    terms: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Program:
    """The moves and evaluations of a step; slots and stages are counted from 0."""

    name: str  # an identifier in lower case
    heading: str  # a summary and the source of the method
    slots: int  # number of slots
    moves: tuple[Move, ...]
    before: tuple[int, ...]  # number of moves before each stage; the others follow the last stage
    stage_slots: tuple[int, ...]  # slot at which each stage is evaluated
    c: tuple[str, ...]  # abscissae
    result: int  # slot of the result; for a pair, of the result of higher order
    second: int | None  # slot of the other result, if the error is the distance of the results
    errors: tuple[tuple[str, ...], ...]  # weights of the stages in errors in the algebra
    lower_order: int | None  # order of the less accurate result of a pair
    on_algebra: bool  # whether dexp⁻¹ makes derivatives of coordinates of the fields at stages

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.c)

    def integer_tables(self) -> dict[str, list[str]]:
        """Return the integers of the moves by array."""
        tables = {
            "before": self.before,
            "slot": self.stage_slots,
            "origin": (move.origin for move in self.moves),
            "target": (move.target for move in self.moves),
            "first": accumulate((len(move.terms) for move in self.moves), initial=0),
            "term_stage": (stage for move in self.moves for stage, _ in move.terms),
        }
        return {name: list(map(str, values)) for name, values in tables.items()}


def write(
    program: Program, templates: Sequence[str], mark: str, tables: str, flows: str = ""
) -> str:
    """Return the text of a file of templates, in which `mark` begins a comment.

    It has the tables of the moves, and the text of the flows of a frame.
    """
    conditions = {"algebra"} if program.on_algebra else set()
    if program.second is not None:
        conditions.add("pair")
    elif program.errors:
        conditions.add("error")
    substitutions = {
        "tables": tables,
        "name": program.name,
        "NAME": program.name.upper(),
        "slots": program.slots,
        "stages": program.stages,
        "moves": len(program.moves),
        "rows": program.stages + (program.slots if program.on_algebra else 1),
        "result": program.result,
        "second_slot": program.second,
        "errors": len(program.errors),
        "lower": program.lower_order,
        "flows": flows,
        # last, so that text of the user that looks like ``@name@`` stays as it is
        "heading": comment(program.heading, mark),
    }
    return fill(template(*templates), substitutions, conditions)


def identifier(name: str) -> str:
    """Return the name of a method as an identifier in lower case, such as ``rkmk8_5_3``."""
    text = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    if not text or text[0].isdigit():
        text = f"method_{text}".strip("_")
    return text[:40].rstrip("_")


def make_program(numbers: Numbers) -> Program:
    """Return the program of a step of an explicit method; ValueError for others."""
    method = numbers.method
    if not method.explicit:
        raise ValueError(
            f"format must be json, toml or latex for an implicit method, whose step isn't a "
            f"sequence of flows; {method.name or 'this one'} is"
        )
    tree, errors = _tree(numbers)
    tree = tree.without_repetitions()
    builder, before, ends = PathBuilder(tree, explicit=True), [], []
    for end in (*tree.stage_points, *tree.results):
        ends.append(builder.path_to(end))
        before.append(sum(len(path.flows) for path in builder.paths))
    moves = []
    for slot, path in enumerate(builder.paths, 1):
        origin = path.origin
        for flow in path.flows:
            moves.append(Move(origin, slot, tuple((k, numbers.decimal(w)) for k, w in flow)))
            origin = slot
    c = [sum(tree.flat_row(at), Fraction(0)) for at in tree.stage_points]
    lower = None if method.embedded_order is None else min(method.order, method.embedded_order)
    return Program(
        identifier(method.name),
        numbers.heading,
        len(builder.paths) + 1,
        tuple(moves),
        tuple(before[: method.stages]),
        tuple(ends[: method.stages]),
        tuple(map(numbers.decimal, c)),
        ends[method.stages],
        None if tree.embedded_result is None else ends[-1],
        tuple(tuple(map(numbers.decimal, row)) for row in errors),
        lower,
        isinstance(method, MuntheKaas),
    )


def _tree(numbers: Numbers) -> tuple[PointTree, list[list[Fraction]]]:
    """Return the points of a step to the result of higher order, and the weights of its errors."""
    method = numbers.method
    better = (method.embedded_order or 0) > method.order
    if isinstance(method, MuntheKaas):
        rows = [list(map(Fraction, row)) for row in method.layout.full_rows(numbers.values)]
        b, *others = rows[method.stages :]
        if better:
            b, others = others[0], [b]
        if method.third_weights is not None:
            others.append([weight.value for weight in method.third_weights])
        errors = [[x - y for x, y in zip(b, other, strict=True)] for other in others]
        return tree_of_rows(rows[: method.stages], b, flat=True), errors
    tree = method.layout.tree(numbers.values)
    results = tree.results[::-1] if better else tree.results
    return PointTree(tree.points, tree.stage_points, *results), []


@cache
def template(*names: str) -> str:
    """Return the texts of files in the folder ``templates``, one after the other, for `fill`."""
    folder = files("cg.construction.formats") / "templates"
    return "".join((folder / f"{name}.in").read_text(encoding="utf-8") for name in names)


def fill(text: str, substitutions: Mapping[str, object], conditions: Container[str] = ()) -> str:
    """Return a template with each ``@key@``, also in earlier ones, replaced by its substitution.

    Text between ``@if name@`` and ``@end name@`` stays if the name is one of `conditions`.
    """
    while section := _SECTION.search(text):
        kept = section[2] if section[1] in conditions else ""
        text = text[: section.start()] + kept + text[section.end() :]
    for key, value in substitutions.items():
        text = text.replace(f"@{key}@", str(value))
    return text


def comment(text: str, mark: str) -> str:
    """Return a text as comment lines, none of which ends in a line continuation."""
    lines = []
    for paragraph in text.splitlines():
        lines += textwrap.wrap(visible(paragraph), _WIDTH) or [""]
    # in C a backslash, also written ??/, continues a comment on the next line
    ends = (" ." if line.endswith(("\\", "??/")) else "" for line in lines)
    return "\n".join(f"{mark} {line}{end}".rstrip() for line, end in zip(lines, ends, strict=True))


def real(number: str) -> str:
    """Return a decimal number as a real literal, with a point or an exponent."""
    return number if "." in number or "e" in number else f"{number}.0"


def wrapped(entries: Iterable[str], indent: str) -> str:
    """Return the entries of a list over lines of limited length."""
    lines = textwrap.wrap(", ".join(entries), _WIDTH, break_on_hyphens=False)
    return textwrap.indent("\n".join(lines), indent)


def array(declared: str, entries: Sequence[str]) -> str:
    """Return the definition of an array in C."""
    entries = entries or ["0"]  # C has no empty arrays
    return f"{declared}[{len(entries)}] = {{\n{wrapped(entries, '    ')}\n}};"


def reals(name: str, table: str, texts: Iterable[str]) -> str:
    """Return the definition of an array of real numbers, of the type that the header names."""
    values = [f"{name.upper()}_NUMBER({real(text)})" for text in texts]
    return array(f"static const {name.upper()}_REAL {name}_{table}", values)


def to_python(program: Program) -> str:
    """Return a module of Python with the step."""
    integers = program.integer_tables()
    lines = [
        "# slots hold points; slot 0 holds the initial one",
        f"SLOTS = {program.slots}",
        f"RESULT = {program.result}",
    ]
    if program.second is not None:
        lines.append(f"SECOND = {program.second}")
    lines += [
        "# rows of the stages: abscissa, number of moves before it, slot",
        f"C = (\n{wrapped(program.c, '    ')},\n)",
        f"BEFORE = (\n{wrapped(integers['before'], '    ')},\n)",
        f"STAGE_SLOTS = (\n{wrapped(integers['slot'], '    ')},\n)",
        "# moves: from slot, to slot, (stage, weight) of the fields whose sum the flow is along",
        "MOVES = (",
    ]
    for move in program.moves:
        terms = wrapped((f"({stage}, {weight})" for stage, weight in move.terms), "        ")
        lines.append(f"    ({move.origin}, {move.target}, (\n{terms},\n    )),")
    lines.append(")")
    if program.errors:
        lines += ["# weights of the stages in the errors", "ERRORS = ("]
        lines += [f"    (\n{wrapped(row, '        ')},\n    )," for row in program.errors]
        lines.append(")")
    # the docstring comes first, since Python looks for an encoding in comments of two lines
    return write(program, ["step.py"], "#", "\n".join(lines))
