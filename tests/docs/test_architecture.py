"""The map in docs/architecture.md matches the repository."""

import ast
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.no_core

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")
(LAYERS,) = (
    [
        [folder.strip() for folder in layer.split(",")]
        for layer in block.replace("\n", " ").split("→")
    ]
    for block in re.findall(r"\n\n((?:    .*→.*\n)+)", PAGE)
)
LAYER = {folder: level for level, folders in enumerate(LAYERS) for folder in folders}


def imported_folders(path):
    """Folders of cg that a module imports from."""
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            start = [*package, *(node.module or "").split(".")]
            targets = [[*filter(None, start), alias.name] for alias in node.names]
        else:
            continue
        yield from (target[1] for target in targets if target[0] == "cg" and target[1:])


def test_paths_on_the_page_exist():
    paths = re.findall(r"`((?:cg|fortran|research|reproduce|benchmarks)/[^`]*)`", PAGE)
    assert len(paths) > 40
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_map_lists_every_folder_of_the_package():
    listed = set(re.findall(r"^      (?:  )?(\w+)/ ", PAGE, re.MULTILINE))
    folders = {path.parent.name for path in (ROOT / "cg").glob("*/__init__.py")}
    assert folders <= listed
    assert folders == set(LAYER)


@pytest.mark.parametrize("folder", sorted(LAYER))
def test_folder_imports_only_from_earlier_layers(folder):
    for path in (ROOT / "cg" / folder).rglob("*.py"):
        others = {name for name in imported_folders(path) if name in LAYER and name != folder}
        assert {name for name in others if LAYER[name] >= LAYER[folder]} == set(), path
