"""The progress line of searches and constructions, also after an interrupt."""

import io
import itertools
import re

import pytest
from terminals import Terminal

import cg
from cg.command import main
from cg.construction.attempt import run_attempt
from cg.construction.runs import Failure, ProgressLine, stored_run
from cg.construction.runs.progress import duration

SEARCH = {"order": 3, "stages": 3, "seed": 5, "starts": 12, "workers": 1}
LINE = re.compile(
    r"(?P<done>\d+) of (?P<total>\d+) (?P<pieces>\w+), (?P<rate>\S+) a second, "
    r"best f (?P<f>[\d.e+-]+)(?P<size>[^,]*), (?P<solved>\d+) solved"
    r"(, (?P<failed>\d+) failed)?(, (?P<left>.*) left)?"
)


def line(stream, **options):
    """Return a line whose clock advances by a second at each reading."""
    return ProgressLine(stream, clock=itertools.count().__next__, **options)


def parse_lines(text):
    matches = [LINE.fullmatch(part) for part in text.splitlines()]
    assert all(matches), text
    return [match.groupdict() for match in matches]


def expected(starts):
    """Return the smallest f and the number of exact ones after each start."""
    sizes = [(start.quad or start.double).f for start in starts]
    best = itertools.accumulate(sizes, min)
    return [f"{f:.1e}" for f in best], list(itertools.accumulate(start.exact for start in starts))


class TestSearch:
    def test_rate_best_and_solved(self):
        stream = io.StringIO()
        result = cg.search(**SEARCH, progress=line(stream, every=0))
        lines = parse_lines(stream.getvalue())
        best, solved = expected(result.starts)
        assert 0 < solved[-1] < 12
        assert [one["f"] for one in lines] == best
        assert [int(one["solved"]) for one in lines] == solved
        assert [one["rate"] for one in lines] == ["1"] * 12
        assert lines[0]["left"] == "11 s"
        assert lines[-1]["left"] is None
        assert result == cg.search(**SEARCH)

    def test_stored_starts_count_except_in_rate(self, path):
        begun = cg.search(**{**SEARCH, "starts": 6}, store=path)
        with stored_run(path, "search", vars(begun.settings)) as run:
            run.fail(Failure(11, "Killed"))
        stream = io.StringIO()
        result = cg.search(**SEARCH, store=path, progress=line(stream, every=0))
        lines = parse_lines(stream.getvalue())
        best, solved = expected(result.starts)
        assert [int(one["done"]) for one in lines] == [8, 9, 10, 11, 12]
        assert [one["f"] for one in lines] == best[6:]
        assert [int(one["solved"]) for one in lines] == solved[6:]
        assert {one["failed"] for one in lines} == {"1"}
        assert lines[0]["rate"] == "1"
        assert lines[0]["left"] == "4 s"

    def test_file_has_line_every_thirty_seconds_and_last_one(self):
        stream = io.StringIO()
        cg.search(**{**SEARCH, "starts": 70}, progress=line(stream))
        assert [int(one["done"]) for one in parse_lines(stream.getvalue())] == [30, 60, 70]

    def test_short_run_writes_nothing_to_file(self):
        stream = io.StringIO()
        cg.search(**SEARCH, progress=line(stream))
        assert stream.getvalue() == ""

    def test_terminal_has_one_line(self):
        stream = Terminal()
        cg.search(**SEARCH, progress=line(stream))
        text = stream.getvalue()
        assert text.count("\n") == 1
        assert text.endswith("\n")
        assert len(parse_lines("\n".join(text.rstrip("\n").split("\r\x1b[K")[1:]))) == 12

    def test_true_writes_to_standard_error(self, capsys, monkeypatch):
        monkeypatch.setattr(cg.construction.runs.progress, "_REPORT", 0.0)
        cg.search(**SEARCH, progress=True)
        captured = capsys.readouterr()
        assert len(parse_lines(captured.err)) == 12
        assert captured.out == ""
        cg.search(**SEARCH, progress=False)
        assert capsys.readouterr().err == ""

    def test_function_is_called_with_counts(self):
        calls = []
        cg.search(**SEARCH, progress=lambda *now: calls.append(now))
        assert calls == [(done, 12) for done in range(1, 13)]
        for call in (cg.search, cg.construct):
            with pytest.raises(TypeError, match="progress must be callable, got 'yes'; True asks"):
                call(3, 3, seed=1, progress="yes", **({"starts": 1} if call is cg.search else {}))


class TestConstruction:
    def test_best_try_has_fewest_stages(self):
        stream, calls = io.StringIO(), []
        settings = {"order": 5, "stages": 8, "seed": 1, "tries": 3, "workers": 1, "restarts": 0}
        settings |= {"iterations": 60}
        construction = cg.construct(**settings, progress=lambda *counts: calls.append(counts))
        assert calls == [(done, 3) for done in range(1, 4)]
        attempts = [run_attempt(construction.settings, index) for index in range(3)]
        cg.construct(**settings, progress=line(stream, every=0))
        lines = parse_lines(stream.getvalue())
        assert {one["pieces"] for one in lines} == {"tries"}
        for number, one in enumerate(lines, 1):
            best = min(attempts[:number], key=lambda a: (not a.solved, a.stages, a.f))
            assert one["f"] == f"{best.f:.1e}"
            assert one["size"] == f" with {best.stages} stages"
            hits = sum(a.solved and a.stages == 8 for a in attempts[:number])
            assert int(one["solved"]) == hits


class TestCommand:
    ARGUMENTS = ("search", "--order", "3", "--stages", "3", "--seed", "5", "--starts", "12")

    def test_command_writes_lines(self, capsys, monkeypatch):
        monkeypatch.setattr(cg.construction.runs.progress, "_REPORT", 0.0)
        assert main([*self.ARGUMENTS, "--workers", "1"]) == 0
        best, solved = expected(cg.search(**SEARCH).starts)
        lines = parse_lines(capsys.readouterr().err)
        assert [one["f"] for one in lines] == best
        assert [int(one["solved"]) for one in lines] == solved
        assert main([*self.ARGUMENTS, "--quiet"]) == 0
        assert capsys.readouterr().err == ""
        assert main(["construct", "--order", "3", "--stages", "3"]) == 0
        assert parse_lines(capsys.readouterr().err)[0]["pieces"] == "tries"

    def test_interrupt_says_how_to_continue(self, capsys, monkeypatch, path):
        def interrupted(*_, **__):
            raise KeyboardInterrupt
            yield

        monkeypatch.setattr(cg.construction.runs.long_run, "completed", interrupted)
        assert main([*self.ARGUMENTS, "--store", str(path)]) == 130
        assert capsys.readouterr().err.splitlines()[-1] == (
            f"crouch-grossman: interrupted; finished results are in {path}; run the same search "
            "again to continue, on any executor"
        )
        assert main([*self.ARGUMENTS]) == 130
        assert capsys.readouterr().err.splitlines()[-1] == (
            "crouch-grossman: interrupted; with --store FILE the same command would continue from "
            "here"
        )


@pytest.mark.parametrize(("seconds", "text"), [
    (0.2, "0 s"), (59.4, "59 s"), (60, "1 min"), (3600, "1 h 0 min"), (7900, "2 h 12 min")
])  # fmt: skip
def test_durations(seconds, text):
    assert duration(seconds) == text
