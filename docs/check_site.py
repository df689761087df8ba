"""Check a built site: links lead somewhere, and its search finds what people look for.

``python docs/check_site.py FOLDER``; links that leave the site are not followed.
"""

from __future__ import annotations

import json
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.search.en import SearchEnglish

# words, and a page among those that a search for each must give
SOUGHT = {
    "quaternion": "howto/spacecraft",
    "attitude": "howto/gyro",
    "munthe": "rkmk",
    "conditions": "mathematics/index",
    "gyro": "howto/gyro",
    "vortices": "howto/vortices",
    "tableau": "mathematics/index",
    "cython": "howto/compiled",
    "tutorial": "start/first_steps",
    "stepper": "howto/output",
    "sensitivity": "howto/covariance",
    "gradient": "howto/jax",
    "JAX": "howto/jax",
    "hold": "howto/spacecraft",
    "saturation": "howto/spacecraft",
    "jacfwd": "howto/jax",
    "GPU": "howto/batch",
    "parallel": "howto/monte_carlo",
    "quadrotor": "howto/quadrotor",
    "args": "start/from_solve_ivp",
    "normalise": "start/why",
    "normalize": "start/why",
}


class Page(HTMLParser):
    """Links out of a page, and places in it that links may lead to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag leads to, and what it is called."""
        given = dict(attrs)
        self.places |= {value for key in ("id", "name") if (value := given.get(key))}
        key = {"a": "href", "link": "href", "img": "src", "script": "src"}.get(tag)
        if key and (link := given.get(key)):
            self.links.append(link)


def broken(folder: Path) -> list[str]:
    """Return a line for each link that leads nowhere."""
    root = folder.resolve()
    pages = {path.resolve(): Page(path) for path in root.rglob("*.html")}
    found = []
    for path, page in pages.items():
        if path.parent.name in {"_static", "mathjax"}:
            continue
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            if not target.exists() or root not in (target, *target.parents):
                found.append(f"{path.relative_to(root)}: {link} is not there")
            elif place and target in pages and place not in pages[target].places:
                found.append(f"{path.relative_to(root)}: {link} has no such place")
    return found


def not_found(folder: Path) -> list[str]:
    """Return a line for each word of `SOUGHT` by which its page isn't found."""
    text = (folder / "searchindex.js").read_text(encoding="utf-8")
    data = json.loads(text[text.index("(") + 1 : text.rindex(")")])
    stem = SearchEnglish({}).stem
    found = []
    for word, page in SOUGHT.items():
        hits: set[int] = set()
        for table in (data["terms"], data["titleterms"]):
            listed = table.get(stem(word.lower()), [])
            hits |= {listed} if isinstance(listed, int) else set(listed)
        if page not in {data["docnames"][hit] for hit in hits}:
            found.append(f"a search for {word} doesn't find {page}")
    return found


if __name__ == "__main__":
    site = Path(sys.argv[1])
    lines = broken(site) + not_found(site)
    print("\n".join(lines) or "links lead somewhere, and what is sought is found")
    sys.exit(bool(lines))
