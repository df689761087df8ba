"""One page for each method of the catalogue, written when the site is built.

Pages are written to ``docs/methods`` if their content has changed.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Mapping
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any

import method_work
from matplotlib import pyplot

import cg
import cg.plot.methods
from cg.construction.catalogue.summary import summary_of
from cg.construction.formats import FORMATS
from cg.construction.methods.method import Method
from cg.construction.proofs import CertificationError, certificate_of, proved

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT))  # for the package benchmarks
FOLDER = Path(__file__).parent / "methods"
CITATIONS = Path(__file__).with_name("references.bib")
MAX_POINTS = 60  # larger trees are not drawn


def slug(name: str) -> str:
    """Return the name of a method's file."""
    return re.sub(r"\W+", "_", name).strip("_")


def kind_of(method: Method) -> str:
    """Return what kind of method it is, with a dash between the names of two people."""
    return summary_of(method).kind.replace("Crouch-", "Crouch–")


def order_of(method: Method) -> str:
    """Return the order, with that of the second result of a pair in brackets."""
    return (
        f"{method.order}({method.embedded_order})" if method.embedded_order else f"{method.order}"
    )


def proof(method: Method) -> tuple[str, str]:
    """Return what is proved of a method in a few words, and in sentences."""
    if isinstance(method, cg.MuntheKaas):
        residual = method.max_residual()
        return proved(method), (
            "A Munthe-Kaas method has the order of its tableau. The tableau satisfies the "
            f"conditions of rooted trees {f'to {residual:.0e}' if residual else 'exactly'}."
        )
    if method.approximate:
        return "no", "The order is nominal: the coefficients satisfy its conditions approximately."
    try:
        certificate = certificate_of(method)
    except CertificationError:
        return "no", "No proof is stored."
    details = certificate.dumps()
    return certificate.proved, (
        f"**{certificate.heading.capitalize()}**: {certificate.statement}. The order is not "
        f"{certificate.order + 1}. [How orders are proved](../certificates.md)\n\n"
        f"<details><summary>The certificate</summary>\n\n```toml\n{details}```\n\n</details>"
    )


@cache
def bibliography() -> dict[tuple[str, str], str]:
    """Return the entries of references.bib by the author and the year of their keys."""
    entries = CITATIONS.read_text(encoding="utf-8").strip().split("\n\n")
    keys = [re.match(r"@\w+\{(.+?)(\d{4}),", entry) for entry in entries]
    return {(key[1], key[2]): entry for key, entry in zip(keys, entries, strict=True) if key}


def citations(method: Method) -> list[str]:
    """Return the BibTeX entries of what the source of a method names, and of this package."""
    source = method.source or ""
    entries = [
        entry
        for (author, year), entry in bibliography().items()
        if author in source and (year in source or author == "Bazavov")
    ]
    kaas = bibliography()["Munthe-Kaas", "1999"]
    if isinstance(method, cg.MuntheKaas) and kaas not in entries:
        entries.append(kaas)
    own = (
        "@software{crouch-grossman,\n  author = {{The crouch-grossman developers}},\n"
        f"  title = {{crouch-grossman, method {method.name}}},\n"
        f"  version = {{{cg.__version__}}}, year = {{2026}}\n}}"
    )
    return [*entries, own]


def number(value: Fraction) -> str:
    """Return an exact number as a short quotient, or rounded to 17 digits."""
    text = str(value)
    return text if len(text) <= 13 else f"{float(value):.17g}"


def weights_of_flows(method: cg.MagnusMethod) -> str:
    """Return the weights of the flows of a Magnus method as a table, by node and bracket.

    A bracket of two combinations has two rows.
    """
    heads = [f"at c = {number(method.abscissae[0])}", *map(number, method.abscissae[1:])]
    heads += [f"bracket {j}" for j in range(1, len(method.brackets) + 1)]
    lines = [f"| flow | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    third = () if method.third_weights is None else (method.third_weights,)
    results = {f"bracket {j}, ": pair for j, pair in enumerate(method.brackets, 1)}
    results |= {"": method.weights, "second, ": method.embedded_weights or (), "third, ": third}
    for label, rows in results.items():
        for i, row in enumerate(rows, 1):
            padded = [number(a.value) for a in row] + [""] * (len(heads) - len(row))
            lines.append(f"| {label}{i} | {' | '.join(padded)} |")
    return "\n".join(lines)


def coefficients(method: Method) -> str:
    """Return the coefficients as a table: a tableau, or points or flows with their weights."""
    if isinstance(method, cg.MagnusMethod):
        return weights_of_flows(method)
    if isinstance(method, cg.Splitting):
        numbers = [number(x.value) for x in method.coefficients]
        pairs = zip(numbers[::2], [*numbers[1::2], ""], strict=True)
        return "\n".join(["| drift | kick |", "|---|---|", *(f"| {d} | {k} |" for d, k in pairs)])
    tableau = method.tableau if isinstance(method, cg.MuntheKaas) else method
    if isinstance(tableau, cg.Tableau):
        rows, weights = tableau.exact
        stages = range(1, method.stages + 1)
        lines = ["| stage | c | " + " | ".join(f"a, {j}" for j in stages) + " |"]
        lines.append("|---" * (method.stages + 2) + "|")
        for r, row in enumerate(rows):
            shown = (number(x) if x else "" for x in row)
            lines.append(f"| {r + 1} | {float(sum(row)):.6g} | " + " | ".join(shown) + " |")
        lines.append("| b | | " + " | ".join(number(x) for x in weights) + " |")
        if tableau.exact_embedded is not None:
            second = tableau.exact_embedded
            lines.append("| b̂ | | " + " | ".join(number(x) for x in second) + " |")
        return "\n".join(lines)
    lines = ["| point | from | weights on frozen fields | is |", "|---|---|---|---|"]
    for m, point in enumerate(method.points):
        here = [f"stage {k + 1}" for k, at in enumerate(method.stage_points) if at == m]
        here += ["the result"] * (m == method.result)
        here += ["the second result"] * (m == method.embedded_result)
        weights = ", ".join(f"{number(w)} F{k + 1}" for k, w in point.weights.items())
        start = "the start" if point.parent < 0 else f"point {point.parent + 1}"
        lines.append(f"| {m + 1} | {start} | {weights} | {', '.join(here)} |")
    return "\n".join(lines)


@cache
def measured() -> Mapping[str, dict[str, float]]:
    """Return the stored errors divided by tolerances of all pairs."""
    from benchmarks import page

    results, _ = page.read(ROOT / "benchmarks" / "results.json")
    return results["estimates"].numbers


def errors_in_tolerances(method: Method) -> str:
    """Return the errors of a pair divided by its tolerances, or "" if there are none stored."""
    stored = measured().get(method.name or "")
    if stored is None:
        return ""
    numbers = ", ".join(f"{what} {number:.2g}" for what, number in stored.items())
    return f"{numbers}: [random families](../benchmarks.md#error-estimates)"


def properties(method: Method) -> str:
    """Return a table of a method's properties."""
    rows = {
        "kind": kind_of(method),
        "order": order_of(method),
        "proved": proof(method)[0],
        "evaluations per step": method.stages,
        "flows per step": method.exponentials,
        "flows per step with the error estimate": method.pair_exponentials
        if method.pair_exponentials != method.exponentials
        else "",
        "principal error": f"{method.principal_error:.3g}",
        "largest residual through its order": f"{method.max_residual():.1e}",
        "error at the end divided by the tolerance": errors_in_tolerances(method),
        "source": method.source,
    }
    return "\n".join(
        [
            "| property | value |",
            "|---|---|",
            *(f"| {key} | {value} |" for key, value in rows.items() if value),
        ]
    )


def write(path: Path, text: str) -> None:
    """Write a file if its text has changed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def draw(path: Path, ax: Any) -> None:
    """Save the figure of axes, and close it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ax.figure.savefig(path, dpi=140, bbox_inches="tight")
    pyplot.close(ax.figure)


def stamp_of(method: Method) -> str:
    """Return a digest of everything that the page of a method depends on."""
    modules = [
        method_work,
        cg.plot.methods,
        cg.construction.formats,
        *method_work.parts(),
    ]
    parts = [Path(__file__), CITATIONS, *(Path(module.__file__) for module in modules)]
    texts = [path.read_bytes() for path in parts]
    texts += [cg.__version__.encode(), cg.export(method, "toml").encode()]
    texts += [kind_of(method).encode()]
    texts += [errors_in_tolerances(method).encode(), proof(method)[1].encode()]
    return hashlib.sha256(b"\0".join(texts)).hexdigest()


def exports(method: Method, name: str) -> str:
    """Write a method in all available formats, and return links to the files."""
    links = []
    for form, suffix in FORMATS.items():
        try:
            text = cg.export(method, form)
        except ValueError:  # steps of implicit methods
            continue
        file = FOLDER / "files" / form / f"{name}{suffix}"
        write(file, text)
        links.append(f"{{download}}`{form} <files/{form}/{file.name}>`")
    return ", ".join(links)


def page(method: Method) -> str:
    """Write the files of a method's page, and return its text."""
    name = slug(method.name)
    pictures = []
    linear, splits = isinstance(method, cg.MagnusMethod), isinstance(method, cg.Splitting)
    if not (linear or splits) and method.explicit and len(method.points) <= MAX_POINTS:
        draw(FOLDER / "pictures" / f"{name}_tree.png", cg.plot.points(method))
        pictures.append(
            "## Tree of points\n\nEach line is a flow; circles are stages, the square is the "
            "result.\n\n"
            f"![Tree of points of {method.name}](pictures/{name}_tree.png)"
        )
    if not (linear or splits):
        draw(FOLDER / "pictures" / f"{name}_region.png", cg.plot.stability_region(method))
        pictures.append(
            "## Stability\n\nIf flows commute, a step multiplies a solution of `y' = λ y` by "
            f"R(hλ); the coloured region is |R| ≤ 1.\n\n![Stability region of {method.name}]"
            f"(pictures/{name}_region.png)"
        )
    if not splits:
        pictures.append(method_work.section(FOLDER, name, method))
    use = f'cg.integrate(f, t_span, y0, frame=frame, method="{method.name}", h=h)'
    if method.embedded_order:
        use = f'cg.solve_ivp(f, t_span, y0, frame=frame, method="{method.name}")'
    if linear:
        use = use.replace("integrate(f", "solve_linear(f").replace("solve_ivp(f", "solve_linear(f")
    if splits:
        use = use.replace("integrate(f", "solve_ivp(f").replace("=frame", "=phase_space")
    sequence = "from top to bottom" if linear or splits else "from left to right"
    parts = [
        f"---\norphan: true\n---\n\n# {method.name}",
        properties(method),
        f"```python\n{use}\n```",
        f"## Order\n\n{proof(method)[1]}",
        "## Coefficients\n\nQuotients are exact, decimals rounded to 17 digits; the files below "
        f"have all digits. Flows follow each other {sequence}.\n\n" + coefficients(method),
        *pictures,
        f"## Files\n\n{exports(method, name)}",
        "## Cite\n\n```bibtex\n" + "\n\n".join(citations(method)) + "\n```",
    ]
    return "\n\n".join(parts) + "\n"


def index(methods: list[Method]) -> str:
    """Return the page that lists all methods."""
    heads = "method", "kind", "order", "evaluations", "flows", "principal error", "proved"
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for method in methods:
        cells = (
            f"[{method.name}]({slug(method.name)}.md)",
            kind_of(method),
            order_of(method),
            method.stages,
            summary_of(method).all_flows,
            f"{method.principal_error:.2g}",
            proof(method)[0],
        )
        rows.append(f"| {' | '.join(map(str, cells))} |")
    table = "\n".join(rows)
    return (
        "# All methods\n\nA click on a heading sorts the table. Numbers in brackets are the order "
        "of the second result of a pair, and the flows with the error estimate. Each method has a "
        "page with its coefficients, what is proved, its tree of points and stability region, its "
        "cost on two problems, files in several formats, and BibTeX. "
        "[The catalogue](../catalogue.md) says "
        f'which to use.\n\n<div class="sortable">\n\n{table}\n\n</div>\n'
    )


def generate(app: Any) -> None:
    """Write all pages; Sphinx calls this before it reads the sources."""
    methods = sorted(cg.methods.values(), key=lambda m: (m.order, m.exponentials, m.name))
    for method in methods:
        path, stamp = FOLDER / f"{slug(method.name)}.md", stamp_of(method)
        mark = FOLDER / "stamps" / slug(method.name)
        if not (path.exists() and mark.exists() and mark.read_text(encoding="utf-8") == stamp):
            write(path, page(method))
            write(mark, stamp)
    write(FOLDER / "index.md", index(methods))
    current = {f"{slug(method.name)}.md" for method in methods} | {"index.md"}
    for old in FOLDER.glob("*.md"):
        if old.name not in current:
            old.unlink()


def link_table(app: Any, page: str, content: list[str]) -> None:
    """Let the catalogue's table be sorted, and link it to the pages, which only the site has."""
    if page == "catalogue":
        before, table, after = re.split(r"<!-- (?:end of )?table -->\n", content[0])
        link = partial(re.sub, r"`(.+)`", lambda name: f"[{name[1]}](methods/{slug(name[1])}.md)")
        rows = "".join(map(link, table.splitlines(keepends=True)))
        content[0] = f'{before}<div class="sortable wide">\n\n{rows}\n</div>\n{after}'


def setup(app: Any) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("builder-inited", generate)
    app.connect("source-read", link_table)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
