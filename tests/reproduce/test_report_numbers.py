"""Printed numbers of the paper, digests of code, the display of progress."""

import hashlib
import io

import pytest

from cg.reproduce import fingerprint
from cg.reproduce.appendix_a import printed
from cg.reproduce.display import Display
from cg.reproduce.items import ITEMS

# of every printed digit of Appendix A, row by row: label, an equals sign, the digits
DIGITS = {
    "CG4a": (20, "226f637c8ef75d4c"),
    "CG5a": (54, "1dd7d84fb97ac0c0"),
    "CG6a": (152, "36443d7e89620d3f"),
}


@pytest.mark.parametrize("name", DIGITS)
def test_printed_digits_have_their_checksum(name):
    lines = [f"{label}={digits}" for label, digits in printed()[name].labelled()]
    total = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    assert (len(lines), total) == DIGITS[name]


def test_digests_change_with_files_and_arguments(tmp_path, monkeypatch):
    monkeypatch.setattr(fingerprint.cg, "__file__", str(tmp_path / "__init__.py"))
    path = tmp_path / "folder" / "module.py"
    path.parent.mkdir()
    digests = []
    for text, order in (("x = 1", 4), ("x = 1", 4), ("x = 1", 5), ("x = 2", 4)):
        path.write_text(text)
        fingerprint._of_package.cache_clear()
        digests.append(fingerprint.digest(order=order))
    fingerprint._of_package.cache_clear()
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_in_a_file_shows_the_remaining_time():
    clock, stream = Clock(), io.StringIO()
    items = [ITEMS["table3.2"], ITEMS["search4"]]
    display = Display(stream, items, clock=clock)
    update = display.begin(items[0])
    assert stream.getvalue() == ""
    for done in range(1, 11):
        clock.now = 20.0 * done
        update(done, 10)
    lines = stream.getvalue().splitlines()
    title = f"[1/2] {items[0].title}"
    # half a minute apart at least
    assert lines[0] == f"{title}: 2 of 10, 40 s, about 3 min left"
    assert len(lines) == 5
    display.finish(items[0], 200.0)
    assert stream.getvalue().splitlines()[-1] == f"{title}: 200.0 s"
    update = display.begin(items[1])
    clock.now += 40.0
    update(91, 100)  # the first of this run: 40 s for one, nine to go
    assert "91 of 100, 40 s, about 6 min left" in stream.getvalue().splitlines()[-1]
    assert "\r" not in stream.getvalue()


def test_progress_on_a_terminal_is_one_line():
    clock, stream = Clock(), Terminal()
    one = ITEMS["table3.2"]
    display = Display(stream, [one], clock=clock)
    update = display.begin(one)
    for done in range(1, 5):
        clock.now += 1.0
        update(done, 4)
    display.finish(one, 4.0)
    assert stream.getvalue().count("\n") == 1
    assert stream.getvalue().count("\r") == 6
    assert "2 of 4, 2 s, about 2 s left" in stream.getvalue()
