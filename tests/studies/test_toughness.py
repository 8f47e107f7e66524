"""Critical stretches of fracture energies, from cracks that run: bonds' own sum, another strip, bad input."""

import pytest

import farhorizon as fh
from farhorizon.studies.toughness import calibrated_stretch, spent_energy

MATERIALS = {
    "state-based": {"material": "state-based", "poisson": 0.33},
    "plane stress": {"material": "state-based", "poisson": 0.2, "plane": "stress"},
    "correspondence": {"material": "correspondence", "poisson": 0.2, "stabilisation": 1.0},
}


def material(**options):
    return fh.Elastic(**{"kernel": fh.Kernel(1.5, 1), "young": 1.0, **options})


@pytest.mark.slow
def test_a_state_based_material_of_bonds_alone_has_their_sum():
    """With a Poisson's ratio of 1/4 its dilatation has no force, and a crack along an axis spends what the bonds across
    it hold: within the 6 % of a crack in bonds (`test_breaking`).
    """
    spacing = 0.5
    bonds = material()
    stencil = bonds.stencil(spacing, 2)
    xi, stiffness = spacing * stencil.offsets, bonds.bond_stiffness(stencil, spacing)
    up = xi[:, 1] > 0
    of_one = 0.5 * (stiffness * xi[:, 1] * (xi**2).sum(1))[up].sum()
    found = calibrated_stretch(material(material="state-based", poisson=0.25), spacing, 3e-4)
    assert found**2 * of_one == pytest.approx(3e-4, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("options", MATERIALS.values(), ids=MATERIALS)
def test_a_crack_in_another_strip_spends_the_fracture_energy(options):
    """Larger, pulled harder, in other units: the energy depends a little on how fast the crack runs."""
    model = material(**options)
    stretch = calibrated_stretch(model, 0.5, 2e-4)
    other = material(**options | {"kernel": fh.Kernel(0.03, 1), "young": 50.0, "density": 3.0})
    again = calibrated_stretch(other, 0.01, 2e-4 * 50 * 0.02)
    assert again == pytest.approx(stretch, rel=1e-6)
    spent = spent_energy(other, 0.01, 0.11, half=16.0, high=9.0)
    assert spent * (stretch / 0.01) ** 2 == pytest.approx(2e-4 * 50 * 0.02, rel=0.06)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((material(), 0.5, 1.0), "have to be calibrated; .*remedy: fracture_energy"),
        ((material(young="1 + x**2", poisson=0.2, material="state-based"), 0.5, 1.0), "one set of constants"),
        ((material(material="state-based", poisson=0.2), 0.5, 0.0), "fracture_energy"),
        ((material(material="state-based", poisson=0.2), -0.5, 1.0), "spacing"),
        ((fh.Wave(fh.Kernel(1.0)), 0.5, 1.0), "model: must be an Elastic model"),
    ],
)
def test_what_is_not_calibrated(given, message):
    with pytest.raises(fh.InputError, match=message):
        fh.calibrated_stretch(*given)
