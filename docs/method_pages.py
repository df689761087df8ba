"""One page for each method of the catalogue, written when the site is built.

Pages are written to ``docs/methods`` if their content has changed.
"""

from __future__ import annotations

import hashlib
import re
import sys
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import method_work
from matplotlib import pyplot

import cg
from cg.formats import FORMATS
from cg.method.method import Method
from cg.proofs import CertificationError, certificate_of

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT))  # for the package benchmarks
FOLDER = Path(__file__).parent / "methods"
KINDS = {
    "CG": "Crouch–Grossman methods",
    "CF": "Commutator-free methods",
    "lifted": "Lifted classical methods",
    "implicit": "Implicit methods",
    "other": "Low order",
}
MAX_POINTS = 60  # larger trees are not drawn


def slug(name: str) -> str:
    """Return the name of a method's file."""
    return re.sub(r"\W+", "_", name).strip("_")


def kind_of(method: Method) -> str:
    """Return the key in `KINDS` of a method."""
    if not method.explicit:
        return "implicit"
    for kind in ("CG", "CF"):
        if method.name and method.name.startswith(kind):
            return kind
    return "other" if method.name == "LieEuler" else "lifted"


def certificate_text(method: Method) -> str:
    """Return what is proved of a method."""
    try:
        text = str(certificate_of(method))
    except CertificationError:
        return "none"
    return text.partition(": ")[2].replace("[", "\\[").replace("]", "\\]")


def number(value: Fraction) -> str:
    """Return an exact number as a short quotient, or rounded to 17 digits."""
    text = str(value)
    return text if len(text) <= 13 else f"{float(value):.17g}"


def coefficients(method: Method) -> str:
    """Return the coefficients as a table: a tableau, or points with their weights."""
    if isinstance(method, cg.Tableau):
        rows, weights = method.exact
        stages = range(1, method.stages + 1)
        lines = ["| stage | c | " + " | ".join(f"a, {j}" for j in stages) + " |"]
        lines.append("|---" * (method.stages + 2) + "|")
        for r, row in enumerate(rows):
            shown = (number(x) if x else "" for x in row)
            lines.append(f"| {r + 1} | {float(sum(row)):.6g} | " + " | ".join(shown) + " |")
        lines.append("| b | | " + " | ".join(number(x) for x in weights) + " |")
        if method.exact_embedded is not None:
            second = method.exact_embedded
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
def measured() -> dict[str, dict[str, float]]:
    """Return the stored errors divided by tolerances of all pairs."""
    from benchmarks import estimates, page

    return estimates.stored(page.read(ROOT / "benchmarks" / "results.json")["estimates"])


def errors_in_tolerances(method: Method) -> str:
    """Return the errors of a pair divided by its tolerances, or "" if there are none stored."""
    stored = measured().get(method.name or "")
    if stored is None:
        return ""
    numbers = ", ".join(f"{what} {number:.2g}" for what, number in stored.items())
    return f"{numbers}: [ten problems and fifty spins](../benchmarks.md#error-estimates)"


def properties(method: Method) -> str:
    """Return a table of a method's properties."""
    pair = f"{method.order}({method.embedded_order})" if method.embedded_order else method.order
    rows = {
        "order": f"{pair}{' (nominal; see the catalogue)' if method.approximate else ''}",
        "evaluations per step": method.stages,
        "flows per step": method.exponentials,
        "principal error": f"{method.principal_error:.3g}",
        "largest residual through its order": f"{method.largest_residual():.1e}",
        "error at the end divided by the tolerance": errors_in_tolerances(method),
        "proved": certificate_text(method),
        "source": method.source,
    }
    return "\n".join(
        ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows.items() if value)]
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
    modules = [method_work, cg.plot.methods, cg.formats, *method_work.parts()]
    parts = [Path(__file__), *(Path(module.__file__) for module in modules)]
    texts = [path.read_bytes() for path in parts]
    texts += [cg.__version__.encode(), cg.export(method, "toml").encode()]
    texts.append(errors_in_tolerances(method).encode())
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
    if method.explicit and len(method.points) <= MAX_POINTS:
        draw(FOLDER / "pictures" / f"{name}_tree.png", cg.plot.points(method))
        pictures.append(
            "## Tree of points\n\nEach line is a flow; circles are stages, the square is the "
            "result.\n\n"
            f"![Tree of points of {method.name}](pictures/{name}_tree.png)"
        )
    draw(FOLDER / "pictures" / f"{name}_region.png", cg.plot.stability_region(method))
    pictures.append(
        "## Stability\n\nIf flows commute, a step multiplies a solution of `y' = λ y` by R(hλ); "
        f"the coloured region is |R| ≤ 1.\n\n![Stability region of {method.name}]"
        f"(pictures/{name}_region.png)"
    )
    pictures.append(method_work.section(FOLDER, name, method))
    use = f'cg.integrate(f, t_span, y0, frame=frame, method="{method.name}", h=h)'
    if method.embedded_order:
        use = f'cg.solve_ivp(f, t_span, y0, frame=frame, method="{method.name}")'
    parts = [
        f"# {method.name}",
        properties(method),
        f"```python\n{use}\n```",
        "## Coefficients\n\nQuotients are exact, decimals rounded to 17 digits; the files below "
        "have all digits. Flows follow each other from left to right.\n\n" + coefficients(method),
        *pictures,
        f"## Files\n\n{exports(method, name)}",
    ]
    return "\n\n".join(parts) + "\n"


def index(methods: list[Method]) -> str:
    """Return the page that lists all methods."""
    lines = [
        "# All methods",
        "Each method has a page with its coefficients, tree of points, stability region, "
        "certificate, source, and files in several formats. [The catalogue](../catalogue.md) "
        "says which to use.",
    ]
    for kind, title in KINDS.items():
        lines.append(f"## {title}")
        rows = ["| method | order | evaluations | flows |", "|---|---|---|---|"]
        for method in methods:
            if kind_of(method) == kind:
                pair = f"({method.embedded_order})" if method.embedded_order else ""
                rows.append(
                    f"| [{method.name}]({slug(method.name)}.md) | {method.order}{pair} | "
                    f"{method.stages} | {method.exponentials} |"
                )
        lines.append("\n".join(rows))
    names = "\n".join(slug(method.name) for method in methods)
    lines.append(f"```{{toctree}}\n:hidden:\n\n{names}\n```")
    return "\n\n".join(lines) + "\n"


def claims() -> str:
    """Return a table of the paper's claims with verdicts and interpretations."""
    from cg.reproduce.sections.claims import CLAIMS, VERDICTS

    counts = [sum(claim.default_verdict == verdict for claim in CLAIMS) for verdict in VERDICTS]
    passed, failed, other = counts
    lines = [
        f"Of {len(CLAIMS)} claims {passed} pass, {failed} fail, and {other} are not reproducible.",
        "",
        "| section | claim, in our words | verdict |",
        "|---|---|---|",
    ]
    for claim in CLAIMS:
        verdict = (
            claim.default_verdict
            if claim.default_verdict == VERDICTS[0]
            else f"**{claim.default_verdict}**"
        )
        reading = f" *{claim.interpretation}*" if claim.interpretation else ""
        lines.append(f"| {claim.section} | {claim.text}{reading} | {verdict} |")
    return "\n".join(lines) + "\n"


def generate(app: Any) -> None:
    """Write all pages; Sphinx calls this before it reads the sources."""
    write(FOLDER / "claims.md", claims())
    methods = sorted(cg.methods.values(), key=lambda m: (m.order, m.exponentials, m.name))
    for method in methods:
        path, stamp = FOLDER / f"{slug(method.name)}.md", stamp_of(method)
        mark = FOLDER / "stamps" / slug(method.name)
        if not (path.exists() and mark.exists() and mark.read_text(encoding="utf-8") == stamp):
            write(path, page(method))
            write(mark, stamp)
    write(FOLDER / "index.md", index(methods))
    current = {f"{slug(method.name)}.md" for method in methods} | {"index.md", "claims.md"}
    for old in FOLDER.glob("*.md"):
        if old.name not in current:
            old.unlink()


def setup(app: Any) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
