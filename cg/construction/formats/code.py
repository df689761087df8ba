"""A step of an explicit method as a list of moves between slots, and its text in a language.

A slot is a variable that holds a point; slot 0 holds the initial point. A move is a flow from the
point in one slot to a point that is stored in another slot or replaces it. The moves to a stage
precede its evaluation of f. A slot is reused as soon as its point isn't needed any more, so that a
chain of flows takes a single slot. Moves are the same in every language; in Python a step is for
NumPy, or a pure function for JAX.
"""

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from importlib.resources import files
from itertools import accumulate

from cg.construction.formats.digits import Numbers
from cg.construction.layouts import START, PointTree, tree_of_rows
from cg.construction.methods.commutator_free import MuntheKaas
from cg.support.parsing import visible

_WIDTH = 96


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
    title: str  # one-line summary of the method
    source: str
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


Parts = Mapping[str, str]


@dataclass(frozen=True)
class Language:
    """Templates in which each ``@key@`` is a part; parts may contain keys of later ones."""

    templates: tuple[str, ...]  # names, see `text.template`, of those that follow each other
    mark: str  # begins a comment
    tables: Callable[[Program, Mapping[str, list[str]]], str]  # as text
    pair: Parts  # text for methods with a second result
    error: Parts  # text for methods with errors in the algebra,
    remarks: Mapping[int, str]  # and the part ``remark``, by the number of errors
    algebra: Parts  # text for methods that work in the algebra,
    manifold: Parts = field(default_factory=dict)  # and of others: by default empty texts

    def write(self, program: Program, flows: str) -> str:
        """Return the text of a file, with the text of the flows of a frame."""
        parts: dict[str, object] = dict.fromkeys([*self.pair, *self.error, "remark"], "")
        if program.second is not None:
            parts |= self.pair
        elif program.errors:
            parts |= {**self.error, "remark": self.remarks[len(program.errors)]}
        on_manifold = {**dict.fromkeys(self.algebra, ""), **self.manifold}
        parts |= self.algebra if program.on_algebra else on_manifold
        parts |= {
            "tables": self.tables(program, program.integer_tables()),
            "name": program.name,
            "NAME": program.name.upper(),
            "slots": program.slots,
            "stages": program.stages,
            "moves": len(program.moves),
            "rows": program.stages + (program.slots if program.on_algebra else 1),
            "result": program.result,
            "second_slot": program.second or 0,
            "errors": len(program.errors),
            "lower": program.lower_order,
            "flows": flows,
            # the last one, as users write it
            "heading": comment(f"{program.title}\n{program.source}", self.mark),
        }
        return fill(template(*self.templates), parts)


def identifier(name: str) -> str:
    """Return the name of a method as an identifier in lower case, such as ``rkmk8_5_3``."""
    text = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    if not text or text[0].isdigit():
        text = f"method_{text}".strip("_")
    return text[:40].rstrip("_")


def make_program(numbers: Numbers, title: str) -> Program:
    """Return the program of a step of an explicit method; ValueError for others."""
    method = numbers.method
    if not method.explicit:
        raise ValueError(
            f"format must be json, toml or latex for an implicit method, whose step isn't a "
            f"sequence of flows; {method.name or 'this one'} is"
        )
    tree, errors = _tree(numbers)
    tree = tree.without_repetitions()
    order, before = _sequence(tree)
    slots, count = _slots(tree, order, before)
    moves = tuple(
        Move(
            slots[tree.points[m].parent],
            slots[m],
            tuple((k, numbers.decimal(w)) for k, w in tree.points[m].weights.items()),
        )
        for m in order
    )
    c = [sum(tree.flat_row(at), Fraction(0)) for at in tree.stage_points]
    second = tree.embedded_result
    lower = None if method.embedded_order is None else min(method.order, method.embedded_order)
    return Program(
        identifier(method.name),
        title,
        method.source,
        count,
        moves,
        before,
        tuple(slots[at] for at in tree.stage_points),
        tuple(map(numbers.decimal, c)),
        slots[tree.result],
        None if second is None else slots[second],
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


def _sequence(tree: PointTree) -> tuple[list[int], tuple[int, ...]]:
    """Return the points in the order of their moves, and the number of moves before each stage."""
    order: dict[int, None] = {}  # an ordered set
    before = []
    for end in (*tree.stage_points, *tree.results):
        order.update(dict.fromkeys(tree.path(end)))
        before.append(len(order))
    return list(order), tuple(before[: len(tree.stage_points)])


def _slots(
    tree: PointTree, order: list[int], before: tuple[int, ...]
) -> tuple[dict[int, int], int]:
    """Return the slot of each point, reused when it isn't needed any more, and their number."""
    last: dict[int, int] = {}
    for k, m in enumerate(order):
        last[tree.points[m].parent] = k
    for at, count in zip(tree.stage_points, before, strict=True):
        last[at] = max(last.get(at, 0), count)
    for end in tree.results:
        last[end] = len(order)
    last[START] = len(order)
    slots = {START: 0}
    unused: list[int] = []
    count = 1
    ended: dict[int, list[int]] = {}
    for k, m in enumerate(order):
        unused.extend(slots[other] for other in ended.pop(k, ()))
        parent = slots[tree.points[m].parent]
        if parent in unused:
            slots[m] = parent
            unused.remove(parent)
        elif unused:
            slots[m] = unused.pop()
        else:
            slots[m] = count
            count += 1
        ended.setdefault(last[m], []).append(m)
    return slots, count


@cache
def template(*names: str) -> str:
    """Return the texts of files in the folder ``templates``, one after the other, for `fill`."""
    folder = files("cg.construction.formats") / "templates"
    return "".join((folder / f"{name}.in").read_text(encoding="utf-8") for name in names)


def fill(template: str, parts: Mapping[str, object]) -> str:
    """Return a template with each ``@key@``, also in earlier parts, replaced by its part."""
    for key, part in parts.items():
        template = template.replace(f"@{key}@", str(part))
    return template


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
    lines: list[str] = []
    line: list[str] = []
    length = 0
    for entry in entries:
        if line and length + len(entry) > _WIDTH:
            lines.append(", ".join(line))
            line, length = [], 0
        line.append(entry)
        length += len(entry) + 2
    lines.append(", ".join(line))
    return ",\n".join(indent + text for text in lines)


def array(declared: str, entries: Sequence[str]) -> str:
    """Return the definition of an array in C."""
    entries = entries or ["0"]  # C has no empty arrays
    return f"{declared}[{len(entries)}] = {{\n{wrapped(entries, '    ')}\n}};"


def reals(name: str, table: str, texts: Iterable[str]) -> str:
    """Return the definition of an array of real numbers, of the type that the header names."""
    values = [f"{name.upper()}_NUMBER({real(text)})" for text in texts]
    return array(f"static const {name.upper()}_REAL {name}_{table}", values)


_ON_MANIFOLD = {
    "call": "f, flow, t, y, h",
    "argument": "",
    "coordinates": "",
    "moved": "flow, points, fields",
    "evaluate": "        fields.append(_array(f(t + c * h, points[slot])))",
    "move": "        points[target] = flow(_combined(terms, fields, h), points[origin])",
}

_ALGEBRA = {
    "call": "f, flow, dexpinv, t, y, h",
    "argument": """    dexpinv : callable
        ``dexpinv(u, v)`` returns the derivative of the coordinates u of a point whose velocity
        has the coefficients v.
""",
    "coordinates": "    coordinates = [None] * SLOTS\n",
    "moved": "flow, points, coordinates, fields",
    "evaluate": """        field = _array(f(t + c * h, points[slot]))
        fields.append(field if slot == 0 else _array(dexpinv(coordinates[slot], field)))""",
    "move": """        coordinates[target] = _combined(terms, fields, h)
        points[target] = flow(coordinates[target], points[origin])""",
}

_PAIR = '''

def step_pair(@call@):
    """Return the point after a step, and the second result, of order @lower@.

    The arguments are those of `step`.
    """
    points, _ = _stages(@call@)
    return points[RESULT], points[SECOND]
'''

_ERROR = '''

def step_error(@call@):
    """Return the point after a step, and the coefficients of its error.

    The arguments are those of `step`. @remark@
    """
    points, fields = _stages(@call@)
    return points[RESULT], np.stack([_combined(enumerate(row), fields, h) for row in ERRORS])
'''

_ERROR_REMARKS = {
    1: "The error has shape (1, m): the field whose flow joins the two results.",
    2: """The errors have shape (2, m): e = errors[0] and e_3 = errors[1], from
    which the estimate is ``|e|**2 / sqrt(|e|**2 + 0.01 * |e_3|**2)``.""",
}


def _tables(program: Program, integers: Mapping[str, list[str]]) -> str:
    lines = [
        "# slots hold points; slot 0 holds the initial one",
        f"SLOTS = {program.slots}",
        f"RESULT = {program.result}",
    ]
    if program.second is not None:
        lines.append(f"SECOND = {program.second}")
    lines += [
        "# of each stage: abscissa, number of moves before it, slot",
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
        for row in program.errors:
            lines.append(f"    (\n{wrapped(row, '        ')},\n    ),")
        lines.append(")")
    return "\n".join(lines)


# the docstring comes first, since Python looks for an encoding in comments of two lines
PYTHON = Language(
    ("step.py",), mark="#", tables=_tables, pair={"output": _PAIR},
    error={"output": _ERROR}, remarks=_ERROR_REMARKS, algebra=_ALGEBRA, manifold=_ON_MANIFOLD,
)  # fmt: skip
