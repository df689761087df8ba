"""Makes all steps apply the flows of each path in the reverse order: what a test must see."""

from dataclasses import replace

from cg.integration.step import plan
from cg.integration.step.paths import Path, paths_of


def reversed_paths(method):
    paths = paths_of(method)
    whole = []  # the flows from the start to the end of each path
    for path in paths.paths:
        whole.append((whole[path.origin - 1] if path.origin else ()) + path.flows)
    return replace(paths, paths=tuple(Path(0, flows[::-1]) for flows in whole))


def reverse_flows(monkeypatch):
    monkeypatch.setattr(plan, "paths_of", reversed_paths)
    monkeypatch.setattr(plan, "_plans_on", lambda frame: {})  # none is prepared yet
