"""Representations of methods in notebooks."""

from html import escape

from cg.construction.formats.latex import to_array
from cg.construction.methods.method import Method
from cg.construction.plots.text import draw_method
from cg.support.parsing import visible, visible_lines


def to_formula(method: Method) -> str:
    """Return a method as a LaTeX formula with few digits, in ``$`` signs."""
    return f"$\\displaystyle {to_array(method)}$"


def to_html(method: Method) -> str:
    """Return a method as HTML: a summary, and its tableau or points with few digits."""
    title = f"<b>{escape(visible(method.name) or 'without name')}</b>: "
    title += escape(method.description())
    source = f"<br><small>{escape(visible(method.source))}</small>" if method.source else ""
    drawing = escape(visible_lines(draw_method(method)))
    # MathJax leaves dollar signs of these classes alone
    return f'<div class="tex2jax_ignore mathjax_ignore">{title}{source}<pre>{drawing}</pre></div>'
