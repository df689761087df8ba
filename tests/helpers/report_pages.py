"""Pages of reports: their data, and whether they are whole."""

import json
from html.parser import HTMLParser

from cg.reproduce.blocks import Context, Settings

VOID = {"meta", "link", "img", "br", "hr", "input"}


def context(folder, **changes):
    return Context(Settings(), folder, 2, **changes)


def read(out):
    def refuse(constant):
        raise ValueError(f"{constant} is no JSON")

    return json.loads((out / "results.json").read_text("utf-8"), parse_constant=refuse)


class Page(HTMLParser):
    """What a page loads, and whether its elements nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.loads, self.ids, self.links, self.tags = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        values = dict(attrs)
        for name, value in attrs:
            if name in ("src", "srcset", "data", "poster") or (tag == "link" and name == "href"):
                self.loads.append(value)
            if name in ("href", "xlink:href"):
                self.links.append(value)
        if "id" in values:
            self.ids.append(values["id"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_page(text):
    parsed = Page(text)
    assert parsed.open == []
    assert parsed.loads == []
    assert len(parsed.ids) == len(set(parsed.ids))
    assert all(link.startswith("#") and link[1:] in parsed.ids for link in parsed.links)
    for forbidden in ("http://", "https://", "@import", "<script", "url(//"):
        assert forbidden not in text
    return parsed
