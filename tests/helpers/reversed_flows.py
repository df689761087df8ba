"""Makes all steps apply the flows of each path in the reverse order: what a test must see."""

from dataclasses import replace

from cg.integration.step import plan
from cg.integration.step.paths import Path, paths_of


def reversed_paths(method):
    paths = paths_of(method)
    # rows that share their first flows would be cut up
    assert len(paths.paths) == len({*paths.stages, paths.result, paths.embedded} - {0})
    return replace(paths, paths=tuple(Path(p.origin, p.flows[::-1]) for p in paths.paths))


def reverse_flows(monkeypatch):
    monkeypatch.setattr(plan, "paths_of", reversed_paths)
    monkeypatch.setattr(plan, "_plans", lambda method: {})  # none is prepared yet
