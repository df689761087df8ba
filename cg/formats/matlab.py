"""A step in MATLAB or Octave: a function file."""

from collections.abc import Mapping, Sequence

from cg.formats.language import Language
from cg.formats.program import Program
from cg.formats.text import wrapped

_FUNCTION = """function [y@returns@] = @name@_step(f, flow, @dexpinv@t, y, h)
% Return the point after a step of size h. f(t, y) returns the coefficients of the fields as a
% column, flow(v, y) the time-1 flow through y of the field with coefficients v.@algebra@@remark@
%
@heading@

% Slots hold points; slot 1 holds the initial one. Each stage has an abscissa c, the number of
% moves before it, and a slot. Each move is a flow from one slot to another, along the weighted sum
% of the fields at stages.
@tables@

points = cell(1, @slots@);
points{1} = y;
@coordinates@done = 0;
for stage = 1:numel(c) + 1
  if stage <= numel(c)
    last = before(stage);
  else
    last = numel(origin);
  end
  for move = done + 1:last
    for k = first(move):first(move + 1) - 1
      if k == first(move)
        v = (h * weight(k)) * fields(:, term_stage(k));
      else
        v = v + (h * weight(k)) * fields(:, term_stage(k));
      end
    end
@keep@    points{target(move)} = flow(v, points{origin(move)});
  end
  done = last;
  if stage > numel(c)
    break
  end
  field = f(t + c(stage) * h, points{slot(stage)});
@derivative@  if stage == 1
    fields = zeros(numel(field), numel(c));
  end
  fields(:, stage) = field;
end
y = points{@result@};
@output@end
"""

_DEXPINV = """
% dexpinv(u, v) returns the derivative of the coordinates u of a point whose velocity has the
% coefficients v."""

_ALGEBRA = {
    "dexpinv": "dexpinv, ",
    "algebra": _DEXPINV,
    "coordinates": "coordinates = cell(1, @slots@);\n",
    "keep": "    coordinates{target(move)} = v;\n",
    "derivative": (
        "  if slot(stage) > 1\n    field = dexpinv(coordinates{slot(stage)}, field);\n  end\n"
    ),
}

_PAIR = {
    "returns": ", second",
    "output": "second = points{@second_slot@};\n",
    "remark": "\n% second is the other result, of order @lower@.",
}

_ERROR = """error_of_step = zeros(size(fields, 1), size(error_weight, 1));
for k = 1:size(error_weight, 1)
  e = (h * error_weight(k, 1)) * fields(:, 1);
  for j = 2:numel(c)
    e = e + (h * error_weight(k, j)) * fields(:, j);
  end
  error_of_step(:, k) = e;
end
"""

_ERROR_REMARKS = {
    1: """
% error_of_step has the coefficients of its error, the field whose flow joins the two results.""",
    2: """
% error_of_step has the coefficients of its error, e and e_3 in columns; the estimate is
% |e|^2 / sqrt(|e|^2 + 0.01 |e_3|^2).""",
}


def _tables(program: Program, integers: Mapping[str, list[str]]) -> str:
    lines = [
        *(_row(name, values) for name, values in integers.items()),
        _row("weight", program.term_weights),
        _row("c", program.c),
    ]
    if program.errors:
        rows = "; ...\n".join(wrapped(row, "  ", end=" ...") for row in program.errors)
        lines.append(f"error_weight = [ ...\n{rows}];")
    return "\n".join(lines)


def _row(name: str, entries: Sequence[str]) -> str:
    return f"{name} = [ ...\n{wrapped(entries, '  ', end=' ...')}];"


MATLAB = Language(
    _FUNCTION, mark="%", slot=1, term=1, tables=_tables, pair=_PAIR,
    error={"returns": ", error_of_step", "output": _ERROR}, remarks=_ERROR_REMARKS,
    algebra=_ALGEBRA,
)  # fmt: skip
