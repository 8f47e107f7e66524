"""A model outside the package whose number of field components differs from the number of axes: a lattice of beams,
whose nodes move and rotate.

Rows and layers of the engine work from the stencil's matrices and the reaction to rotations alone.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.medium.integrators import Verlet
from interpreter import Interpreter

SPACING = 0.5
OFFSETS = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])


class Micropolar(fh.LatticeModel):
    """Beams from each node of a plane lattice to its eight neighbours, with the energies ``a (n . du)^2 / 2`` of
    stretching, ``b (t . du - l (phi + phi') / 2)^2 / 2`` of shear and ``g (dphi)^2 / 2`` of bending, per unit mass.

    The field is u along both axes and the rotation times the radius of inertia of a node, `inertia`. Beams with a
    `twist` couple stretching and shear, like chiral ones.
    """

    bonds = False
    moduli = None

    def __init__(self, shear: float = 0.4, bend: float = 0.2, inertia: float = 0.5, twist: float = 0.0) -> None:
        self.shear, self.bend, self.inertia, self.twist = shear, bend, inertia, twist
        self.coefficient, self.integrator = 1.0, Verlet()

    def stencil(self, spacing: float, dim: int) -> fh.Stencil:
        """Forces are derivatives of the energies: in those on u, ``phi + phi'`` has an odd weight, so that opposite
        neighbours leave differences; in those on phi, ``2 phi`` remains.
        """
        weights, reaction = np.zeros((len(OFFSETS), 3, 3)), np.zeros((3, 3))
        for k, (springs, n, t, arm) in enumerate(self.beams(spacing)):
            near, far = rows_of(n, t, arm)
            weights[k] = -near.T @ springs @ far
            reaction += near.T @ springs @ near + near.T @ springs @ far
        return fh.Stencil(OFFSETS, weights, reaction)

    def beams(self, spacing: float):
        """Yield stiffnesses, direction, normal, and half the length over the radius of inertia."""
        for offset in OFFSETS:
            length = np.linalg.norm(offset)
            n = offset / length
            springs = np.array([[1, self.twist, 0], [self.twist, self.shear, 0], [0, 0, self.bend]]) / length**2
            yield springs, n, np.array([-n[1], n[0]]), length * spacing / 2 / self.inertia


del fh.LatticeModel.known["Micropolar"]  # other tests examine all models of case files


def rows_of(n, t, arm):
    """Return stretch, shear and bending of a beam as rows that act on the field at its near and at its far end."""
    near = np.array([[*-n, 0], [*-t, -arm], [0, 0, -1]])
    return near, np.array([[*n, 0], [*t, -arm], [0, 0, 1]])


def dynamic_matrix(model, *angles):
    """Return the matrix whose eigenvalues are the squared frequencies of a plane wave: twice the energy of the beams
    of a node, each of which is counted from both ends.
    """
    total = np.zeros((3, 3), complex)
    for offset, (springs, n, t, arm) in zip(OFFSETS, model.beams(SPACING), strict=True):
        near, far = rows_of(n, t, arm)
        strains = near + far * np.exp(1j * (offset @ np.array(angles)))
        total += strains.conj().T @ springs @ strains / 2
    return total / SPACING**2


@pytest.fixture(autouse=True)
def known():
    """The model is registered during a test."""
    fh.LatticeModel.known["Micropolar"] = Micropolar
    yield
    del fh.LatticeModel.known["Micropolar"]


MODELS = {"mirrors": Micropolar(), "none": Micropolar(twist=0.3)}


def lattice(*half):
    return fh.Lattice(SPACING, tuple(-float(h) for h in half), tuple(float(h) for h in half))


START = {"u": ["exp(-(x**2 + y**2))", "0.5*x*exp(-(x**2 + y**2))", "exp(-((x - 1)**2 + y**2))"]}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_dispersion(model):
    """There are three branches, of which the rotational one has a cut-off; with mirror symmetry the components change
    sign as a vector and a rotation do.
    """
    stencil = model.stencil(SPACING, 2)
    for angles in [(0.3, 0.2), (2.0, -1.0), (np.pi, 0.5), (0.0, 0.0)]:
        exact = np.linalg.eigvalsh(dynamic_matrix(model, *angles))
        np.testing.assert_allclose(stencil.branches(*angles) / SPACING**2, exact, rtol=0, atol=1e-12)
    lowest = stencil.branches(0.0, 0.0)
    assert lowest == pytest.approx([0, 0, stencil.strongest_reaction], abs=1e-13) and lowest[2] > 1
    mirrors = [stencil.even_along(axis) for axis in (0, 1)]
    assert mirrors == [model.twist == 0] * 2
    if model.twist == 0:  # x, y and the rotation, across x and across y; a change of all signs is equivalent
        np.testing.assert_array_equal(stencil.signs * stencil.signs[0], [[1, 1], [-1, -1], [1, -1]])


@pytest.mark.parametrize("branch", [0, 1, 2])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_waves_in_a_periodic_box(model, branch):
    """Each wave oscillates with the frequency of its branch under the time stepping, and conserves its energy to
    rounding; rows are compiled if there is mirror symmetry, otherwise sums are over single bonds.
    """
    angles = 2 * np.pi * np.array([2 / 12, -3 / 15])
    squares, modes = np.linalg.eigh(dynamic_matrix(model, *angles))
    i, j = np.indices((12, 15))
    start = np.real(modes[:, branch, None, None] * np.exp(1j * (angles[0] * i + angles[1] * j)))
    box = fh.Lattice(SPACING, (0.0, 0.0), (5.5, 7.0))
    sim = fh.Simulation(box, model, fh.Periodic(), {"u": start})
    assert bool(sim.engine.tables.sweep.function) == (model.twist == 0)
    sim.step()
    energy = sim.energy()
    sim.step(99)
    frequency = 2 / sim.dt * np.arcsin(np.sqrt(squares[branch]) * sim.dt / 2)
    np.testing.assert_allclose(sim.fields["u"], start * np.cos(frequency * sim.time), rtol=0, atol=1e-12)
    assert sim.energy() == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("sides", [fh.LatticePML(nodes=5), {"x": fh.LatticePML(nodes=4), "y": fh.Fixed()}])
def test_compiled_loop_and_definitions(model, sides):
    """Layers, whose sums use the mirror symmetry of components, against stretched shifts written out."""
    u = np.random.default_rng(3).standard_normal((3, 13, 12)) * np.pad(np.ones((5, 4)), 4)
    one, two = (fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (12.0, 11.0)), model, sides, {"u": u}) for _ in range(2))
    two.engine.loop = Interpreter(two.engine)
    for sim in (one, two):
        sim.step(20)
    np.testing.assert_allclose(two.fields["u"], one.fields["u"], rtol=0, atol=1e-12)
    assert np.abs(one.fields["u"]).max() > 1e-3


def test_layers_are_the_larger_domain():
    """They differ by the reflection, which decreases with the layer's thickness; all three branches cross it.
    Rotations near their cut-off are slow, and require thick layers.
    """
    model, errors = MODELS["mirrors"], {}
    sims = {n: fh.Simulation(lattice(6, 5), model, fh.LatticePML(nodes=n), START) for n in (8, 16, 24)}
    large = fh.Simulation(lattice(36, 35), model, fh.Fixed(), START, dt=sims[8].dt)
    for until in (20.0, 40.0):
        exact = large.run(until, progress=False).fields["u"][:, 60:-60, 60:-60]
        for n, sim in sims.items():
            off = np.abs(sim.run(until, progress=False).fields["u"] - exact).max()
            errors[n] = max(errors.get(n, 0.0), off)
    assert errors[8] < 3e-3 and errors[16] < 1e-4 and errors[24] < 1e-5
    chosen = fh.Simulation(lattice(6, 5), model, fh.LatticePML(target=1e-3, until=40.0), START)
    assert np.abs(chosen.run(40.0, progress=False).fields["u"] - exact).max() < 1e-3


def test_runs_checkpoints_and_checks(tmp_path):
    """The model works like any other."""
    first = fh.Simulation(lattice(6, 5), MODELS["mirrors"], fh.LatticePML(nodes=8), START)
    first.step(7)
    first.save(tmp_path / "a.ckpt")
    other = fh.Simulation.restore(tmp_path / "a.ckpt")
    for sim in (first, other):
        sim.step(9)
    np.testing.assert_array_equal(first.fields["u"], other.fields["u"])
    assert first.certificate().verdict == "certified"
    assert "u3 to u3" in first.check(until=10.0).details


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"initial": {"u": ["1", "2"]}}, "a list of 3"),
        ({"boundary": fh.Free()}, "no such side"),
        ({"cracks": [[(-2.0, 0.2), (2.0, 0.2)]]}, "cannot be cut"),
        ({"sources": [fh.MomentTensor((0.0, 0.0), [[1, 0], [0, 1]], "sin(t)")]}, "acts on an elastic medium"),
        ({"sources": [fh.IncidentWave((1.0, 0.0), "sin(t)", 4.0, "S")]}, "incident"),
        ({"observe": [fh.FarField(fh.Box((-4, -4), (4, 4)))]}, "scalars and of vectors"),
        ({"observe": [fh.Receivers([[0.3, 0.2]], record="stress")]}, "no such quantity"),
    ],
)
def test_what_it_does_not_have(given, words):
    with pytest.raises(fh.InputError, match=words):
        fh.Simulation(lattice(6, 5), MODELS["mirrors"], **{"boundary": fh.LatticePML(nodes=6)} | given)


@pytest.mark.parametrize(
    "reaction", [np.ones((2, 2)), -np.eye(3), [[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]], [[np.nan] * 3] * 3]
)
def test_reactions_that_cannot_be(reaction):
    stencil = MODELS["mirrors"].stencil(SPACING, 2)
    with pytest.raises(fh.InputError, match=r"stencil\.reaction"):
        fh.Stencil(stencil.offsets, stencil.weights, reaction)


def test_a_number_draws_all_components_back_alike():
    """A number as the reaction acts on all components, also in addition to a matrix."""
    stencil = MODELS["mirrors"].stencil(SPACING, 2)
    more = stencil.with_reaction(stencil.own + 0.3 * np.eye(3))
    np.testing.assert_allclose(more.branches(0.4, 0.1), stencil.branches(0.4, 0.1) + 0.3, rtol=0, atol=1e-13)
    model = Micropolar()
    model.reaction = 0.3 / SPACING**2
    assert model.medium(SPACING, 2) == more
