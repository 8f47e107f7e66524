"""Energy lost with a bond of a correspondence material, against the definitions of energies for random materials."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.medium.force_states import energy_of_bonds

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
print(f"energies of bonds: seed {SEED}")


def drawn(case, dim):
    random = np.random.default_rng([SEED, case])
    kernel = fh.Kernel(random.uniform(1.5, 3.2 if dim == 3 else 4.5), int(random.integers(0, 3)))
    options = {"poisson": random.uniform(-0.2, 0.4), "stabilisation": random.uniform(0.0, 1.0)}
    return fh.Elastic(kernel, 1.0, material="correspondence", **options).force_states(1.0, dim), random


def energy(states, eta, there):
    """Energy of a node, including half of that of its springs, with the shape tensor of all bonds."""
    (law,) = states.law(np.eye(eta.shape[1])[None], np.array([states.moduli]))
    state = np.einsum("kqa,ka->q", states.gradient[there], eta[there])
    return state @ law @ state / 2 + np.einsum("ka,kab,kb->", eta[there], states.bonds[there], eta[there]) / 4


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("case", range(3))
def test_energy_of_bonds_is_what_both_nodes_lose(case, dim):
    """The body is stretched uniformly, until the bond is elongated as much as the longest one at a stretch of 1."""
    states, random = drawn(case, dim)
    lengths, found = np.linalg.norm(states.offsets, axis=1), energy_of_bonds(states) @ states.moduli
    every = np.ones(len(lengths), bool)
    for bond in random.choice(len(lengths), 8, replace=False):
        eta = lengths.max() / lengths[bond] * states.offsets
        lost = 2 * (energy(states, eta, every) - energy(states, eta, every & (np.arange(len(lengths)) != bond)))
        assert 2 * found[bond] == pytest.approx(lost, rel=1e-9)
        assert found[bond] > 0


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("case", range(3))
def test_both_directions_of_a_bond_have_one_energy(case, dim):
    """They agree bitwise, because each end decides by itself that the bond breaks."""
    states, _ = drawn(case, dim)
    at = {tuple(offset): k for k, offset in enumerate(states.offsets.tolist())}
    back = [at[tuple(-c for c in offset)] for offset in states.offsets.tolist()]
    found = energy_of_bonds(states)
    np.testing.assert_array_equal(found, found[back])


def breaks_at(model, sides, strain):
    """Whether a bond breaks at once, which is refused, in a bar that is pulled along x and free to contract."""
    lattice = fh.Lattice(1.0, (-20.0, -10.0), (20.0, 10.0))
    x, y = lattice.coordinates()
    narrower = model.lame / (model.lame + 2 * model.shear)
    try:
        fh.Simulation(lattice, model, sides, {"u": np.stack([strain * x, -narrower * strain * y])}, threads=1)
    except fh.InputError as error:
        assert "stretch bonds beyond the critical stretch" in str(error)
        return True
    return False


def first_inside(model):
    """Strain along x at which a bond of an intact body breaks, for a critical stretch of 1."""
    states = model.force_states(1.0, 2)
    narrower = model.lame / (model.lame + 2 * model.shear)
    eta, every = states.offsets * [1.0, -narrower], np.ones(len(states.offsets), bool)
    whole, limits = energy(states, eta, every), energy_of_bonds(states) @ states.moduli
    lost = [whole - energy(states, eta, every & (np.arange(len(eta)) != bond)) for bond in range(len(eta))]
    return min(np.sqrt(limit / one) for limit, one in zip(limits, lost, strict=True) if one > 0)


@pytest.mark.parametrize(("plane", "poisson"), [("strain", 0.2), ("strain", 0.45), ("stress", 0.3), ("stress", 0.45)])
def test_in_uniaxial_tension_a_bond_bears_more_than_the_critical_stretch(plane, poisson):
    """By a factor of the root of the modulus of a uniform stretch over Young's modulus at a free face, to 3 %, and by
    more inside.
    """
    strength, kernel = 1e-3, fh.Kernel(3.0, 1)
    options = {"material": "correspondence", "plane": plane, "stabilisation": 0.4, "critical_stretch": strength}
    model = fh.Elastic(kernel, 1.0, poisson, **options)
    even, tension = 2 * (model.lame + model.shear), 4 * model.shear * (model.lame + model.shear)
    face = np.sqrt(even / (tension / (model.lame + 2 * model.shear)))
    said = 1 / (1 - poisson) if plane == "stress" else (1 - poisson) / (1 - 2 * poisson)
    assert face == pytest.approx(np.sqrt(said))
    for sides, strain, error in ((fh.Free(), face, 0.03), (fh.Fixed(), first_inside(model), 0.002)):
        assert breaks_at(model, sides, (1 + error) * strain * strength)
        assert not breaks_at(model, sides, (1 - error) * strain * strength)
    assert first_inside(model) > face
