"""Classes that checkpoints know by name, because they derive from a common class."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.files.storable import Storable
from farhorizon.geometry.shapes import Shape

#: Classes that are no part of a set-up, or are stored in other ways: runs, models and sides (which have their own
#: registries), constants, misfits and what is found with them, errors.
APART = (
    fh.LatticeModel,
    fh.Side,
    fh.Simulation,
    fh.Setup,
    fh.Certificate,
    fh.Probes,
    fh.Receivers,
    fh.FarField,
    fh.Spectra,
    fh.PowerThrough,
    fh.Reaction,
    fh.Impacts,
    fh.ShellRecorder,
    fh.StressIntensity,
    fh.CrackTips,
    fh.WholeSteps,
    fh.Medium,
    fh.Misfit,
    fh.Gradient,
    fh.Inversion,
    fh.materials,
)


def test_every_part_of_a_set_up_is_known():
    public = {name: getattr(fh, name) for name in fh.__all__ if isinstance(getattr(fh, name), type)}
    parts = {n for n, one in public.items() if not issubclass(one, (*APART, Exception))}
    assert {n for n in parts if Storable.stored_as.get(n) is not public[n]} == set()


class Half(Shape, offered=False):  # in files, not in case files
    """Everything below a height, as a user-defined shape."""

    _shown = ("height",)

    def __init__(self, height):
        self.height, self.dim = height, 2

    def _contains(self, points):
        return points[..., 1] <= self.height


def test_a_shape_of_ones_own_is_in_checkpoints(tmp_path):
    """Its arguments are stored, and the run continues bitwise."""
    lattice, model = fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0)), fh.Diffusion(fh.Kernel(2.0))
    held = fh.Temperature(Half(-4.0), "sin(t)")
    sim = fh.Simulation(lattice, model, fh.Free(), {"u": "exp(-x**2)"}, constraints=[held], threads=1)
    sim.step(5)
    sim.save(tmp_path / "a.ckpt")
    again = fh.Simulation.restore(tmp_path / "a.ckpt")
    assert again.setup.constraints[0].where.height == -4.0
    for one in (sim, again):
        one.step(5)
    np.testing.assert_array_equal(again.fields["u"], sim.fields["u"])


def test_a_name_is_that_of_one_class():
    with pytest.raises(TypeError, match=r"a class 'Disc' already, in farhorizon\.geometry\.shapes"):
        type("Disc", (Shape,), {})
    assert Storable.stored_as["Disc"] is fh.Disc
