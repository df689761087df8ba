"""What a language needs to write a step: a template, and its parts that depend on the method."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cg.construction.formats.program import Program
from cg.construction.formats.text import comment, fill, template

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

    def write(self, program: Program) -> str:
        """Return the text of a file."""
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
            "heading": comment(program.heading, self.mark),
        }
        return fill(template(*self.templates), parts)
