"""The example scripts of docs/gallery as modules."""

import importlib.util
import sys
from pathlib import Path

GALLERY = Path(__file__).resolve().parents[2] / "docs/gallery"
NAMES = sorted(path.stem for path in GALLERY.glob("*.py") if not path.stem.startswith("plot_"))


def load(name):
    """Return an example script as a new module."""
    spec = importlib.util.spec_from_file_location(name, GALLERY / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def example(name):
    """Return what has the frame, y0, f and invariants of an example."""
    module = load(name)
    return module.GradientFlow() if name == "gradient_flow" else module
