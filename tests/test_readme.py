"""What the README shows can be run as it stands."""

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_the_python_in_the_readme_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 3
    names = {}
    for block in blocks:
        exec(compile(block, str(README), "exec"), names)
    assert names["run"].success
    assert names["frame"].membership_error(names["run"].y).max() < 1e-14
    assert names["found"]
    assert names["five"].order == 5
    assert names["proof"].order == names["method"].order == 6
    assert "The end of t_span was reached" in capsys.readouterr().out
