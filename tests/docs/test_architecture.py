"""The map in docs/architecture.md matches the repository."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")
PACKAGE, CONSTRUCTION, INTEGRATION, FORTRAN = (
    {
        folder.strip(): level
        for level, layer in enumerate(block.replace("\n", " ").split("→"))
        for folder in layer.split(",")
    }
    for block in re.findall(r"\n\n((?:    .*→.*\n)+)", PAGE)
)


def module_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in (ROOT / "cg").rglob("*.py")}


def imported(path):
    """Modules of cg that a file imports, also within functions and for type checkers."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            start = [*package, *filter(None, [node.module])]
            targets = [".".join([*start, alias.name]) for alias in node.names]
        else:
            continue
        for target in targets:
            module = target
            while module and module not in FILES:
                module = module.rpartition(".")[0]
            if module:
                yield module


IMPORTS = {module: {*imported(path)} - {module} for module, path in FILES.items()}


def test_paths_on_the_page_exist():
    paths = re.findall(r"`((?:cg|fortran|research|reproduce|benchmarks)/[^`]*)`", PAGE)
    assert len(paths) > 40
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_names_on_the_page_are_in_their_files():
    pairs = re.findall(r"`(\w+)`(?: and `(\w+)`)? (?:in|of) `([\w/.]+\.\w+)`", PAGE)
    assert len(pairs) > 20
    assert [
        (name, path)
        for *names, path in pairs
        for name in filter(None, names)
        if not re.search(rf"\b{name}\b", (ROOT / path).read_text("utf-8"))
    ] == []


def rooms_of(path):
    """Folders and files of a package, which have names of their own in its map."""
    files = {file.stem for file in path.glob("*.py")} - {"__init__", "__main__"}
    return files | {folder.parent.name for folder in path.glob("*/__init__.py")}


def test_map_lists_every_room_of_the_package():
    lines = re.findall(r"^      (?:  )?(\w+(?:/|\.py).*?)  ", PAGE, re.MULTILINE)
    listed = set(re.findall(r"(\w+)(?:/|\.py)", " ".join(lines)))
    assert rooms_of(ROOT / "cg") - {"conditions"} == set(PACKAGE) <= listed
    assert rooms_of(ROOT / "cg" / "construction") == set(CONSTRUCTION) <= listed
    assert rooms_of(ROOT / "cg" / "integration") == set(INTEGRATION) <= listed


@pytest.mark.parametrize(
    ("package", "layer"),
    [("cg.", PACKAGE), ("cg.construction.", CONSTRUCTION), ("cg.integration.", INTEGRATION)],
    ids=["package", "construction", "integration"],
)
def test_rooms_import_only_from_earlier_layers(package, layer):
    def folder_of(module):
        return module.removeprefix(package).split(".")[0] if module.startswith(package) else ""

    wrong = [
        (module, other)
        for module, others in IMPORTS.items()
        for other in others
        if folder_of(module) in layer and folder_of(other) in layer
        if folder_of(module) != folder_of(other)
        if layer[folder_of(other)] >= layer[folder_of(module)]
    ]
    assert wrong == []


def test_what_integrates_names_construction_where_users_ask_for_it_only():
    naming = {
        str(path.relative_to(ROOT))
        for folder in set(PACKAGE) - {"construction", "plot", "command"}
        for path in (ROOT / "cg" / folder).rglob("*.py")
        if '"cg.construction' in path.read_text("utf-8")
    }
    assert naming == {"cg/tables/stored.py", "cg/tables/table.py"}


def test_files_do_not_import_each_other_in_a_circle():
    assert len(IMPORTS["cg.integration.problem"]) > 10
    TopologicalSorter(IMPORTS).prepare()  # CycleError names the files of a circle


def test_folders_of_fortran_use_earlier_ones_only():
    texts = {path: path.read_text("utf-8") for path in ROOT.glob("fortran/*/*.f90*")}
    home = {m: path for path, text in texts.items() for m in re.findall(r"(?m)^module (\w+)", text)}
    for path, text in texts.items():
        for other in map(home.get, re.findall(r"(?m)^ +use (\w+)", text)):
            here, there = path.parent.name, other.parent.name if other else "support"
            assert here == there or FORTRAN[there] < FORTRAN[here]


def test_procedures_in_fortran_have_60_lines():
    """Declarations, comments and empty lines don't count, nor do procedures within others."""
    begins = re.compile(r"(?:[\w() ]+ )?(subroutine|function) (\w+)")
    uncounted = re.compile(r"use\b|implicit none|!|$|.*::")
    long = set()
    for path in ROOT.glob("fortran/*/*.f90"):
        counts = [("module", 0)]
        for line in map(str.strip, path.read_text("utf-8").splitlines()):
            if re.match("end (subroutine|function)", line):
                name, count = counts.pop()
                if count > 60:
                    long.add(f"{path.name}: {name}, {count}")
            elif found := begins.match(line):
                counts.append((found[2], 0))
            elif not uncounted.match(line):
                counts[-1] = counts[-1][0], counts[-1][1] + 1
        assert len(counts) == 1
    assert not long
