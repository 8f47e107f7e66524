"""Bonds of solids: how strongly a correspondence material may be stabilised."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.medium.solids import neutral_stabilisation

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))


@pytest.mark.parametrize("dim", [2, 3])
def test_short_shear_waves_are_faster_than_long_ones_above_the_neutral_stabilisation(dim):
    """In any direction, for any weights and any Poisson's ratio."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    for _ in range(3):
        poisson, horizon = rng.uniform(-0.2, 0.45), rng.uniform(1.2, 3.2)
        kernel = fh.Kernel(horizon, rng.choice([0, 1, 2]), str(rng.choice(["constant", "linear"])))
        ways = rng.normal(size=(6, dim))
        ways /= np.abs(ways).max(1)[:, None]  # to the edge of the Brillouin zone
        k = (np.linspace(0.02, np.pi, 40)[:, None, None] * ways).reshape(-1, dim)
        for share, faster in ((0.98, False), (1.1, True)):
            lame, shear = poisson / (1 - poisson), (1 - 2 * poisson) / (2 * (1 - poisson))  # of a unit P modulus
            strength = share * float(neutral_stabilisation(lame, shear))
            model = fh.Elastic(kernel, 1.0, poisson, material="correspondence", stabilisation=min(strength, 1.0))
            stencil = model.stencil(1.0, dim)
            symbol = np.einsum("qk,kab->qab", 1 - np.cos(k @ stencil.offsets.T), stencil.weights)
            speeds = np.sqrt(np.maximum(np.linalg.eigvalsh(symbol)[:, 0], 0.0) / shear) / np.linalg.norm(k, axis=1)
            assert (speeds.max() > 1 + 1e-6) == (faster and strength < 1)
            assert (model.caution is not None) == (faster and strength < 1)


@pytest.mark.parametrize("material", ["state-based", "correspondence"])
def test_a_horizon_of_so_many_nodes_that_adding_up_takes_minutes_is_refused(material):
    model = fh.Elastic(fh.Kernel(61.0), 1.0, 0.2, material=material)
    with pytest.raises(fh.InputError, match=r"kernel\.horizon: .*11\d\d\d neighbours; limit: 5477 neighbours"):
        model.stencil(1.0, 2)
