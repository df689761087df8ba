"""Methods that follow other paths: with the flows of each in the reverse order, for example."""

from dataclasses import dataclass, replace

from cg.construction.methods.compile import error_exponent, table_of_paths
from cg.construction.methods.method import Method
from cg.construction.methods.paths import MethodPaths, Path, paths_of


@dataclass(frozen=True)
class WithPaths:
    method: Method
    paths: MethodPaths

    def table(self):
        pair = self.method.embedded_order is not None
        return table_of_paths(self.method, self.paths, error_exponent(self.method) * pair)


def reversed_flows(method):
    """The method with the flows of each path in the reverse order: what a test must see."""
    paths = paths_of(method)
    whole = []  # the flows from the start to the end of each path
    for path in paths.paths:
        whole.append((whole[path.origin - 1] if path.origin else ()) + path.flows)
    reverse = replace(paths, paths=tuple(Path(0, flows[::-1]) for flows in whole))
    return WithPaths(method, reverse)


def without_registers(method):
    return WithPaths(method, replace(paths_of(method), registers=None))


def as_they_are(method):
    return WithPaths(method, paths_of(method))
