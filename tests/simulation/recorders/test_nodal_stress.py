"""Stress at nodes: for uniform strains, against the records of receivers, and in files and pictures."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.simulation.recorders.quantities import fields_of, nodal_stress, von_mises

E, NU = 3.0, 0.25  # bond-based in plane strain and in space
LAME = MU = E / (2 * (1 + NU))  # Lame's constants are the same for this ratio


def strained(gradient, lattice, **options):
    """Simulation at its start under the displacement ``gradient . x``."""
    u = np.einsum("ij,j...->i...", gradient, np.stack(np.meshgrid(*lattice.axes, indexing="ij")))
    model = options.pop("model", None) or fh.Elastic(fh.Kernel(0.5), young=E)
    return fh.Simulation(lattice, model, fh.Free(), initial={"u": u}, **options)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_uniform_strain_has_hookes_stress(dim):
    """Everywhere, including the edges and the nodes beside a hole."""
    gradient = np.random.default_rng(3).normal(size=(dim, dim)) * 1e-3
    lower, upper = np.full(dim, -1.5), np.full(dim, 1.5)
    lattice = fh.Lattice(0.5, lower, upper, body=fh.Box(2 * lower, 2 * upper) - (fh.Disc if dim == 2 else fh.Ball)(0.4))
    found = nodal_stress(strained(gradient, lattice))
    whole = np.zeros((3, 3))
    whole[:dim, :dim] = gradient
    strain = (whole + whole.T) / 2
    stress = LAME * np.trace(strain) * np.eye(3) + 2 * MU * strain  # Hooke's law; in 2D, plane strain
    for name, values in found.items():
        if name != "stress_von_mises":
            a, b = ("xyz".index(letter) for letter in name[-2:])
            np.testing.assert_allclose(values[lattice.mask], stress[a, b], rtol=1e-9, atol=1e-15)
    (s1, s2, s3) = np.linalg.eigvalsh(stress)
    mises = np.sqrt(((s1 - s2) ** 2 + (s2 - s3) ** 2 + (s3 - s1) ** 2) / 2)
    np.testing.assert_allclose(found["stress_von_mises"][lattice.mask], mises, rtol=1e-9)
    assert np.isnan(found["stress_xx"][~lattice.mask]).all() and not lattice.mask.all()


def test_von_mises_of_plain_states():
    """Uniaxial tension, pure shear, and uniaxial tension in plane strain."""
    tension, shear = np.array([[2.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 2.0], [2.0, 0.0]])
    np.testing.assert_allclose(von_mises(np.stack([tension, shear])), [2.0, 2.0 * np.sqrt(3)])
    np.testing.assert_allclose(von_mises(tension[None], 0.25), 2 * np.sqrt(1 - 0.25 + 0.25**2))


def test_it_is_what_receivers_record():
    """On nodes, after some steps of a wave in a medium that varies."""
    lattice = fh.Lattice(0.5, (-4.0, -3.0), (4.0, 3.0))
    nodes = [(-1.0, 0.5), (0.0, 0.0), (2.5, -1.0)]
    line = fh.Receivers(nodes, record="stress", interpolation="linear")
    model = fh.Elastic(fh.Kernel(0.5), young="3 + x/4", material="bond-based")
    pulse = {"u": ["exp(-x**2 - y**2)", "x*exp(-x**2 - y**2)/2"]}
    sim = fh.Simulation(lattice, model, fh.Fixed(), initial=pulse, observe=[line])
    sim.step(7)
    found = nodal_stress(sim)
    for node, record in zip(nodes, line.data["stress"][-1], strict=True):
        place = lattice.index(node)
        here = [found[f"stress_{name}"][place] for name in ("xx", "xy", "yy")]
        np.testing.assert_allclose(here, [record[0, 0], record[0, 1], record[1, 1]], rtol=1e-12, atol=1e-14)


def test_no_stress_crosses_a_crack():
    """Two halves that are moved apart are not strained; where bonds can break, nodes beside the crack have none."""
    lattice = fh.Lattice(0.5, (-2.0, -1.75), (2.0, 1.75))
    y = lattice.axes[1]
    u = np.zeros((2, *lattice.shape))
    u[1] = np.sign(y) * 1e-3
    options = {"initial": {"u": u}, "cracks": [[(-9.0, 0.0), (9.0, 0.0)]]}
    whole = fh.Simulation(lattice, fh.Elastic(fh.Kernel(0.5), young=E), fh.Free(), **options)
    assert np.abs(nodal_stress(whole)["stress_yy"]).max() < 1e-15
    breaks = fh.Elastic(fh.Kernel(0.5), young=E, critical_stretch=0.5)
    stress = nodal_stress(fh.Simulation(lattice, breaks, fh.Free(), **options))["stress_yy"]
    assert np.isnan(stress[:, np.abs(y) < 0.5]).all()
    assert np.abs(stress[:, np.abs(y) > 1.0]).max() < 1e-15


def test_files_and_pictures_have_it_where_it_is_asked_for(tmp_path):
    lattice = fh.Lattice(0.5, (-2.0, -1.5), (2.0, 1.5))
    gradient = np.array([[1e-3, 0.0], [2e-3, 0.0]])
    sim = strained(gradient, lattice)
    results = fh.open_results(sim.write(tmp_path / "a.h5", fields=["u", "stress"]))
    names = ("stress_xx", "stress_xy", "stress_yy", "stress_von_mises")
    assert results.field_names == ("u", *names) and "stress_xx" not in sim.fields
    assert fh.open_results(sim.write(tmp_path / "b.h5", fields=["stress_xy"])).field_names == ("stress_xy",)
    np.testing.assert_allclose(results.field("stress_xy"), MU * 2e-3, rtol=1e-9)
    from farhorizon.pictures.result_pictures import plot_results
    from farhorizon.pictures.views import View

    drawn = plot_results(results, tmp_path, View(fields=["stress"]))
    assert [path.stem for path in drawn] == list(names)
    assert sim.plot("stress_von_mises").axes
    with pytest.raises(fh.InputError, match=r"no such field.*stress_xz.*stress_von_mises"):
        fields_of(sim, ["stress_xz"])
    wave = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), fh.Fixed())
    with pytest.raises(fh.InputError, match="no such field; value: stress; limit: u, v"):
        wave.write(tmp_path / "c.h5", fields=["stress"])


CASE = """
lattice = {{ spacing = 0.5, lower = [-2.0, -2.0], upper = [2.0, 2.0] }}
model = {{ type = "{model}", {constants}kernel = {{ horizon = 0.5 }} }}
boundary = {{ all = {{ type = "fixed" }} }}
run = {{ until = 1.0 }}
output = {{ fields = ["u", "stress"] }}
"""


def test_cases_ask_for_it():
    from farhorizon.case.case import Case

    case = Case(CASE.format(model="elastic", constants="young = 3.0, "))
    assert case.fields == ("u", "stress")
    assert "max_stress_von_mises" in case.figures(case.run())
    with pytest.raises(fh.InputError, match=r"a medium of type wave has no such field; value: stress; limit: u, v"):
        Case(CASE.format(model="wave", constants=""))
