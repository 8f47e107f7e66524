"""The page about calibration computes what it says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs/howto/calibrate.md"


def test_the_page_finds_what_it_hides(capsys):
    """Horizon and width to two digits from differences of runs, and an interval that holds the critical stretch."""
    text = PAGE.read_text(encoding="utf-8")
    assert len(text.split()) <= 500
    names = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), names)
    assert abs(names["found"].x - [2.2, 1.4]).max() < 0.01
    assert 0 < names["target"] < names["counts"].max()
    step = names["stretches"][1] / names["stretches"][0]
    assert names["fits"].min() / step < 0.085 < names["fits"].max() * step
    assert "critical stretch between" in capsys.readouterr().out
