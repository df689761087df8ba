"""Reading stores of runs in tests."""

from pathlib import Path

from cg.construction.runs import Store


def stored_numbers(path: Path, run: int = 1) -> list[int]:
    """Return the numbers of the stored starts of a run."""
    with Store(path) as opened:
        return list(opened.run(run).numbers())


def starts_of_the_file_alone(path: Path) -> list[int]:
    """Return the numbers of starts that a copy of a store's file has, without its log."""
    copy = path.with_name("copy.db")
    copy.write_bytes(path.read_bytes())
    with Store(copy, read=True) as opened:
        return [run.starts for run in opened.runs()]
