"""Names of quantities on axes."""

import pytest

from farhorizon.pictures.style import counted_in
from farhorizon.pictures.words import axis_label, in_words


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("u", "displacement $u$"),
        ("u_x", "displacement $u_{x}$"),
        ("|u|", "displacement $|u|$"),
        ("v_y", "velocity $v_{y}$"),
        ("div v", r"divergence $\nabla \cdot v$"),
        ("stress_xy", r"stress $\sigma_{xy}$"),
        ("stress_von_mises", "von Mises stress"),
        ("energy_flux_x", "energy flux $S_{x}$"),
        ("position_x", "position $x$"),
        ("K_II", r"stress intensity $K_{\mathrm{II}}$"),
        ("damage", "damage"),
        ("my_own_field", "my own field"),
        ("w", "w"),
    ],
)
def test_names_are_read_as_words_and_symbols(name, text):
    assert in_words(name, {"u": "displacement"}) == text


def test_a_label_has_a_unit_where_there_is_one():
    assert axis_label("u_x", "u") == "$u_{x}$"
    with counted_in({"stress": "Pa"}):
        assert axis_label("stress_von_mises", "stress") == "von Mises stress (Pa)"
        assert axis_label("damage", "damage") == "damage"
