"""Pictures of the media of the nodes of a case."""

import farhorizon.case.preview as drawing
from farhorizon.case.case import Case
from farhorizon.pictures.style import counted_in

DISC = """
[lattice]
spacing = "1 mm"
lower = ["-6 mm", "-6 mm"]
upper = ["6 mm", "6 mm"]
[units]
length = "mm"
time = "us"
pressure = "GPa"
[model]
type = "elastic"
young = "70 GPa"
density = "2700 kg/m^3"
kernel = { horizon = "2 mm" }
[[material]]
region = { disc = { radius = "3 mm" } }
young = "210 GPa"
density = "7850 kg/m^3"
[boundary]
all = { type = "fixed" }
[run]
until = "1 us"
"""


def test_constants_are_named_in_words_with_units(tmp_path, monkeypatch):
    seen, case = {}, Case(DISC)
    monkeypatch.setattr(
        drawing, "field_panels", lambda _panels, _axes, path, look: seen.update({path.name: look.label})
    )
    with counted_in(case.unit_names):
        drawing.draw_geometry(case, case.run(), tmp_path)
    assert seen == {
        "case-young.png": "Young's modulus $E$ (GPa)",
        "case-density.png": r"density $\rho$ (GPa us²/mm²)".replace("us", "\N{MICRO SIGN}s"),
    }
