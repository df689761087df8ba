"""Print the oldest admitted version of each dependency of the package and its tests."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def oldest() -> list[str]:
    """Return the requirements of ``pyproject.toml`` with the lowest version of each."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    requirements = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    return [requirement.replace(">=", "==") for requirement in requirements]


if __name__ == "__main__":
    print(*oldest(), sep="\n")
