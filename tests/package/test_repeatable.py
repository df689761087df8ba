"""Hypothesis draws the same examples on every run, except in the nightly profile."""

import os
import subprocess
import sys

PROPERTY = """
from pathlib import Path
from hypothesis import given, settings, strategies as st

@settings(max_examples=20)
@given(st.integers(0, 2**64))
def test_property(number):
    with Path("drawn").open("a") as file:
        file.write(f"{number}\\n")
    assert number < 1000
"""


def drawn(folder, *options):
    """Run a property that fails below this suite's settings; return what it drew and printed."""
    folder.mkdir()
    (folder / "test_property.py").write_text(PROPERTY)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "conftest", "-p", "no:cacheprovider", *options],
        cwd=folder,
        # where CI is set, the settings of hypothesis have other defaults
        env={**os.environ, "CI": "true", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    return (folder / "drawn").read_text(), done.stdout


def test_draws_repeat_except_in_the_nightly_profile(tmp_path):
    first, _ = drawn(tmp_path / "a")
    assert drawn(tmp_path / "b")[0] == first
    assert not (tmp_path / "a" / ".hypothesis" / "examples").exists()
    other, printed = drawn(tmp_path / "c", "--hypothesis-profile=nightly")
    assert other != first
    assert "@reproduce_failure" in printed
