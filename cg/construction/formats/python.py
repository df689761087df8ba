"""A step in Python: for NumPy, or as a pure function for JAX."""

from collections.abc import Mapping

from cg.construction.formats.program import Language, Program, wrapped

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
