"""The case templates specify units, which appear in their pictures."""

import pytest

from farhorizon.case.case import Case
from farhorizon.case.templates import template


@pytest.mark.parametrize(
    ("kind", "length", "time", "u"),
    [("heat", "m", "s", "degC"), ("elastic", "mm", "us", "mm"), ("diffusion", "m", "h", None)],
)
def test_units_of_templates(tmp_path, kind, length, time, u):
    path = tmp_path / "a.toml"
    path.write_text(template(kind), encoding="utf-8")
    named = Case.read(path).unit_names
    assert (named["length"], named["time"], named.get("u")) == (length, time, u)
