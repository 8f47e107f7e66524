"""How much faster solids with cracks oscillate than whole ones, and that layers are chosen for that step."""

import itertools

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.simulation import assembly
from farhorizon.simulation.assembly import assembled
from farhorizon.simulation.processes import subdomain
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.setup.stiffening import largest_rate, stiffening

KERNEL = fh.Kernel(2.0)
SOLIDS = {
    "state-based": fh.Elastic(KERNEL, 1.0, 0.3, material="state-based"),
    "nearly incompressible": fh.Elastic(KERNEL, 1.0, 0.45, material="state-based"),
    "correspondence": fh.Correspondence(KERNEL, 1.0, 0.3, stabilisation=0.3),
}
LATTICE = fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0))
CRACK, INTO = [(-4.0, 1.3), (3.0, 1.3)], [(2.0, 0.5), (900.0, 0.5)]
PULSE = {"u": ["exp(-((x + 2)**2 + (y + 2)**2)/3)", 0.0]}
CHOSEN = fh.LatticePML(target=1e-2, until=15.0)


def setup_of(name="nearly incompressible", boundary=CHOSEN, cracks=(CRACK,), **others):
    given = {"lattice": LATTICE, "initial": PULSE, "threads": 1} | others
    return fh.Setup(given.pop("lattice"), SOLIDS[name], boundary, cracks=cracks, **given)


def counted(monkeypatch, owner, name):
    """Return a list that grows with each call of a function from now on."""
    calls, called = [], getattr(owner, name)

    def counting(*given, **named):
        calls.append(given)
        return called(*given, **named)

    monkeypatch.setattr(owner, name, counting)
    return calls


class Counting(ProcessGroup):
    """One process that counts its sums over all processes."""

    sums = 0

    def summed(self, values):
        self.sums += 1
        return super().summed(values)


def dense_rate(setup):
    """Return the largest squared frequency, from the eigenvalues of the whole matrix."""
    grid = assembled(setup).grid
    engine = grid.engine
    nodes = engine.all_components(
        engine.layout.box.node_indices()[engine.absent.exists[engine.layout.box.node_indices()]]
    )
    places, level, columns = nodes.ravel(), np.zeros(engine.levels.shape[1]), []
    for place in places:
        level[:] = 0
        level[place] = 1
        engine.complete(level)
        columns.append(-engine.apply_core(level)[places])
    return np.linalg.eigvalsh(np.array(columns))[-1]


@pytest.mark.parametrize("name", SOLIDS)
def test_the_largest_rate_is_that_of_the_matrix(name):
    body = fh.Lattice(1.0, (-5.0, -4.0), (5.0, 4.0), body=fh.Box((-5.2, -4.2), (5.2, 4.2)) - fh.Disc(1.5, (0.4, 0.0)))
    setup = setup_of(name, fh.Free(), [[(2.0, 0.5), (9.0, 0.5)]], lattice=body, initial=None)
    parts = assembled(setup)
    assert largest_rate(parts.grid, ProcessGroup()) == pytest.approx(dense_rate(setup), rel=1e-7)


@pytest.mark.parametrize(("dtype", "power"), [("float64", 190), ("float64", -190), ("float32", 28), ("float32", -28)])
def test_rates_whose_squares_overflow_or_underflow(dtype, power):
    """In other units the step is the same, bit for bit: these change the spacing and the stiffness by powers of two."""
    found = []
    for unit in (1.0, 2.0**power):
        lattice = fh.Lattice(1 / unit, (-8 / unit, -8 / unit), (8 / unit, 8 / unit))
        solid = fh.Elastic(fh.Kernel(2 / unit), unit, 0.3, material="state-based")
        crack = [(x / unit, y / unit) for x, y in CRACK]
        with np.errstate(over="raise", invalid="raise"):
            found.append(fh.Simulation(lattice, solid, fh.Free(), dtype=dtype, cracks=[crack], threads=1).dt)
    assert found[0] == found[1] * 2.0 ** (3 * power // 2)


def test_what_is_below_a_known_rate_is_not_looked_for_any_longer():
    parts, teams = assembled(setup_of("state-based", fh.LatticePML(nodes=12))), (Counting(), Counting())
    found = [
        largest_rate(parts.grid, team, known) for team, known in zip(teams, (0.0, parts.near.rate_limit), strict=True)
    ]
    assert teams[1].sums < 0.5 * teams[0].sums
    assert 0.99 < found[1] / found[0] <= 1 and found[0] < parts.near.rate_limit


@pytest.mark.sampled(10)
@pytest.mark.parametrize("boundary", [fh.LatticePML(nodes=6), CHOSEN], ids=["given", "chosen"])
@pytest.mark.parametrize("name", SOLIDS)
def test_mirrored_cracks_have_the_same_step_limit(name, boundary):
    """Cracks that end inside, and those that run into a layer; with data in the middle."""
    middle = {"u": ["exp(-(x**2 + y**2)/3)", 0.0]}
    for crack in (CRACK, INTO):
        limits = [
            fh.Simulation.of(setup_of(name, boundary, [[(x * a, y * b) for x, y in crack]], initial=middle)).step_limit
            for a, b in ((1, 1), (-1, 1), (1, -1))
        ]
        assert limits == pytest.approx([limits[0]] * 3, rel=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("poisson", [0.42, 0.43, 0.44])
def test_what_oscillates_at_a_crack_is_found_in_a_large_box(poisson):
    """All four mirror images of a crack have the same limit, which covers the fastest oscillation."""
    solid, limits, middle = fh.Elastic(KERNEL, 1.0, poisson, material="state-based"), [], [0.0, 0.0]
    lattice = fh.Lattice(1.0, (-150.0, -150.0), (150.0, 150.0))
    for a, b in itertools.product((1, -1), repeat=2):
        cracks = [[(x * a, y * b) for x, y in CRACK]]
        setup = fh.Setup(lattice, solid, fh.LatticePML(nodes=6), {"u": middle}, cracks=cracks, threads=1)
        limits.append(fh.Simulation.of(setup).step_limit)
    assert limits == pytest.approx([limits[0]] * 4, rel=1e-6)
    small = fh.Lattice(1.0, (-30.0, -30.0), (30.0, 30.0))  # just large enough for what oscillates at the crack
    parts = fh.Simulation.of(fh.Setup(small, solid, fh.LatticePML(nodes=6), {"u": middle}, cracks=[CRACK])).parts
    assert (limits[0] / parts.near.step_limit) ** 2 == pytest.approx(1, rel=1e-4)
    assert largest_rate(parts.grid, ProcessGroup()) < parts.near.rate_limit


def test_noise_in_a_large_box_stays_bounded_near_the_limit():
    """Oscillations at the crack, which are faster than any wave of the medium, do not grow."""
    lattice = fh.Lattice(1.0, (-150.0, -150.0), (150.0, 150.0))
    noise = {"u": 1e-3 * np.random.default_rng(5).standard_normal((2, *lattice.shape))}
    solid = fh.Elastic(KERNEL, 1.0, 0.44, material="state-based")
    given = {"cracks": [CRACK], "threads": 1, "dt": lambda half: 0.9998 * 2 * half}
    run = fh.Simulation.of(fh.Setup(lattice, solid, fh.Fixed(), noise, **given))
    run.step(600)
    assert run.dt == pytest.approx(0.9998 * run.step_limit) and np.abs(run.fields["u"]).max() < 0.2


def test_where_moduli_differ_waves_along_the_interface_are_found():
    """The limit covers the converged rate, in a narrow and a wide box."""
    for size in (20.0, 60.0):
        lattice = fh.Lattice(1.0, (-size, -12.0), (size, 12.0))
        solid = fh.Elastic(KERNEL, "1 + (y > 0.3)", "0.3 + 0.14*(y > 0.3)", material="state-based")
        parts = assembled(fh.Setup(lattice, solid, fh.LatticePML(nodes=6), {"u": [0.0, 0.0]}, threads=1))
        found = stiffening(parts.near, parts.grid, ProcessGroup())
        assert largest_rate(parts.grid, ProcessGroup()) < found * parts.near.rate_limit


def test_a_crack_shortens_the_step_only_where_it_makes_the_solid_stiffer():
    whole, cut = (
        {name: fh.Simulation.of(setup_of(name, cracks=c)).step_limit for name in SOLIDS} for c in ([], [CRACK])
    )
    assert 0.9997 < cut["state-based"] / whole["state-based"] < 1
    assert 0.98 < cut["nearly incompressible"] / whole["nearly incompressible"] < 0.999
    assert 0.5 < cut["correspondence"] / whole["correspondence"] < 0.8


@pytest.mark.parametrize("cracks", [[CRACK], [INTO]], ids=["inside", "into a side"])
@pytest.mark.parametrize("name", SOLIDS)
def test_noise_keeps_its_energy_just_below_the_limit(name, cracks):
    noise = {"u": 1e-3 * np.random.default_rng(5).standard_normal((2, *LATTICE.shape))}
    setup = setup_of(name, fh.Extended(nodes=4), cracks, initial=noise, dt=lambda half: 0.999 * 2 * half)
    run = fh.Simulation.of(setup)
    run.step(600)
    assert run.dt == pytest.approx(0.999 * run.step_limit) and np.abs(run.fields["u"]).max() < 0.02


@pytest.mark.parametrize("cracks", [[CRACK], [INTO]], ids=["inside", "into a layer"])
@pytest.mark.parametrize("name", SOLIDS)
def test_a_run_with_the_step_that_was_found_is_stable(name, cracks):
    sim = fh.Simulation.of(setup_of(name, cracks=cracks))
    sim.step(150)
    early = np.abs(sim.fields["u"]).max()
    sim.step(1500)
    # the limit is that of the chosen layers, the step half of that of others: up to 0.013 of the rate apart (see
    # `stiffening`); oscillations at the crack, faster than any wave, persist
    assert sim.dt == pytest.approx(sim.step_limit / 2, rel=0.0065) and np.abs(sim.fields["u"]).max() < 1.5 * early


@pytest.mark.sampled(2)
@pytest.mark.parametrize("cracks", [[CRACK], [INTO], [CRACK, INTO]])
@pytest.mark.parametrize("name", ["nearly incompressible", "correspondence"])
def test_the_limit_is_that_of_the_layers_that_were_chosen(name, cracks):
    """A trial with a few nodes in place of the layers also covers thicker and thinner ones."""
    trial = fh.Simulation.of(setup_of(name, cracks=cracks)).rate_limit
    for nodes in (1, 3, 30):
        parts = fh.Simulation.of(setup_of(name, fh.LatticePML(nodes=nodes), cracks)).parts
        own = largest_rate(parts.grid, ProcessGroup())
        assert own < parts.near.rate_limit and own < trial < 1.05 * own


@pytest.mark.parametrize(
    "boundary",
    [CHOSEN, {"all": CHOSEN, "y+": fh.Free()}, fh.Auto(target=1e-2, until=15.0)],
    ids=["by target", "half-space", "auto"],
)
@pytest.mark.parametrize("name", ["state-based", "correspondence"])
def test_the_step_does_not_depend_on_the_layers_that_are_chosen(name, boundary):
    sim = fh.Simulation.of(setup_of(name, boundary))
    dt = sim.dt
    sim.run(until=15.0)
    assert sim.dt == dt and sim.setup.boundary == setup_of(name, boundary).boundary  # what was given


def test_what_is_not_stiffer_is_assembled_once(monkeypatch):
    """The crack adds nothing; or no bond is cut; or the bonds are springs."""
    assemblies = counted(monkeypatch, assembly, "assembled")
    for setup in (
        setup_of("state-based", fh.LatticePML(nodes=5)),
        setup_of("state-based", fh.LatticePML(), cracks=()),
        fh.Setup(LATTICE, fh.Elastic(KERNEL, 1.0), fh.LatticePML(), PULSE, cracks=[CRACK]),
    ):
        assemblies.clear()
        fh.Simulation.of(setup)
        assert len(assemblies) == 1


def test_the_chosen_layers_are_those_of_the_same_step():
    """The layers of the trial leave no trace."""
    sim = fh.Simulation.of(setup_of("correspondence", cracks=[INTO]))
    again = fh.Simulation.of(setup_of("correspondence", cracks=[INTO], dt=sim.dt))
    assert sim.beyond == again.beyond and sim.notes == again.notes and sim.thickness.keys() == again.thickness.keys()
    assert sim.parts.grid.margins == again.parts.grid.margins


@pytest.mark.slow
def test_a_set_up_serves_whose_trial_does_not():
    """An oblique crack across a side that extends the domain, because no layer keeps the target."""
    given = {"cracks": [[(2.0, 0.2), (30.0, 14.0)]], "initial": {"u": ["exp(-(x + 2)**2 - (y + 2)**2)", 0.0]}}
    auto, far = (
        fh.Simulation.of(setup_of("correspondence", side(1e-12, until=15.0), **given))
        for side in (fh.Auto, fh.Extended)
    )
    assert len(auto.extents) == 4 and auto.beyond == far.beyond
    assert auto.step_limit == far.step_limit


def test_what_is_refused_is_said_of_the_set_up_itself():
    with pytest.raises(fh.InputError, match="only straight along its normal"):
        fh.Simulation.of(setup_of("correspondence", cracks=[[(2.0, 0.2), (30.0, 14.0)]]))


def test_a_lattice_on_which_no_layer_is_chosen_is_refused_before_any_work(monkeypatch):
    """Its trial is not assembled first."""
    assemblies = counted(monkeypatch, assembly, "assembled")
    monkeypatch.setattr(subdomain, "_CHOSEN", 100)
    with pytest.raises(fh.InputError, match="no process has on so large a lattice"):
        assembly.assemble_subdomain(setup_of("correspondence"), ProcessGroup(), None, [])
    assert not assemblies
