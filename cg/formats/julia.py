"""A step in Julia: a module."""

from collections.abc import Mapping, Sequence

from cg.formats.language import Language
from cg.formats.program import Program
from cg.formats.text import wrapped

_MODULE = '''@heading@
module @Module@

# The module exports nothing, since Base has a function step: call @Module@.step.

# Slots hold points; slot 1 holds the initial one. Each stage has an abscissa, the number of moves
# before it, and a slot. Each move is a flow from one slot to another, along the weighted sum of
# the fields at stages. Numbers are strings, so that any type can be parsed from them.
const SLOTS = @slots@
@tables@

"""
    step(f, flow, @dexpinv@t, y, h)

Return the point after a step of size h. f(t, y) returns the coefficients of the frame's fields,
flow(v, y) the time-1 flow through y of the field with coefficients v.@dexpinv_remark@
Numbers have the type of h.
"""
step(f, flow, @dexpinv@t, y, h) = stages(f, flow, @dexpinv@t, y, h)[1][@result@]
@output@
function stages(f, flow, @dexpinv@t, y, h)
    T = typeof(float(h))
    c, weights = parse.(T, C), parse.(T, WEIGHTS)
    points = Vector{Any}(undef, SLOTS)
@coordinates@    fields = Vector{Any}(undef, length(c))
    points[1] = y
    done = 0
    for stage in 1:length(c)+1
        last = stage <= length(c) ? BEFORE[stage] : length(ORIGIN)
        for move in done+1:last
            terms = FIRST[move]:FIRST[move+1]-1
            v = combined(view(weights, terms), view(TERM_STAGE, terms), fields, h)
@keep@            points[TARGET[move]] = flow(v, points[ORIGIN[move]])
        end
        done = last
        stage <= length(c) || break
        fields[stage] = f(t + c[stage] * h, points[SLOT[stage]])
@derivative@    end
    return points, fields
end

function combined(weights, stages, fields, h)
    total = (h * weights[1]) .* fields[stages[1]]
    for k in 2:length(weights)
        total = total .+ (h * weights[k]) .* fields[stages[k]]
    end
    return total
end

end
'''

_ALGEBRA = {
    "dexpinv": "dexpinv, ",
    "dexpinv_remark": (
        "\ndexpinv(u, v) returns the derivative of the coordinates u of a point whose velocity\n"
        "has the coefficients v."
    ),
    "coordinates": "    coordinates = Vector{Any}(undef, SLOTS)\n",
    "keep": "            coordinates[TARGET[move]] = v\n",
    "derivative": (
        "        if SLOT[stage] > 1\n"
        "            fields[stage] = dexpinv(coordinates[SLOT[stage]], fields[stage])\n"
        "        end\n"
    ),
}

_PAIR = '''
"""
    step_pair(f, flow, @dexpinv@t, y, h)

Return the point after a step, and the second result, of order @lower@.
"""
function step_pair(f, flow, @dexpinv@t, y, h)
    points, _ = stages(f, flow, @dexpinv@t, y, h)
    return points[@result@], points[@second_slot@]
end
'''

_ERROR = '''
"""
    step_error(f, flow, @dexpinv@t, y, h)

Return the point after a step, and the coefficients of its error: @remark@
"""
function step_error(f, flow, @dexpinv@t, y, h)
    points, fields = stages(f, flow, @dexpinv@t, y, h)
    T = typeof(float(h))
    return points[@result@], [combined(parse.(T, row), 1:length(row), fields, h) for row in ERRORS]
end
'''

_ERROR_REMARKS = {
    1: "a vector with\nthe field whose flow joins the two results.",
    2: "e and e3, from which\nthe estimate is |e|^2 / sqrt(|e|^2 + 0.01 |e3|^2).",
}


def _tables(program: Program, integers: Mapping[str, list[str]]) -> str:
    lines = [
        *(_vector(name.upper(), values) for name, values in integers.items()),
        _vector("WEIGHTS", _texts(program.term_weights)),
        _vector("C", _texts(program.c)),
    ]
    if program.errors:
        rows = ",\n".join(f"[\n{wrapped(_texts(row), '    ')}\n]" for row in program.errors)
        lines.append(f"const ERRORS = [{rows}]")
    return "\n".join(lines)


def _texts(numbers: Sequence[str]) -> list[str]:
    return [f'"{number}"' for number in numbers]


def _vector(name: str, entries: Sequence[str]) -> str:
    return f"const {name} = [\n{wrapped(entries, '    ')}\n]"


JULIA = Language(
    _MODULE, mark="#", slot=1, term=1, tables=_tables, pair={"output": _PAIR},
    error={"output": _ERROR}, remarks=_ERROR_REMARKS, algebra=_ALGEBRA,
)  # fmt: skip
