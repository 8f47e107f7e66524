"""A temperature that continues with the displacements through absorbing sides, against domains from whose ends
nothing returns.
"""

import os

import numpy as np
import pytest

import farhorizon as fh

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
ZERO, CAPACITY = 300.0, 2.0


MATERIALS = {
    "bond-based": {},
    "state-based": {"poisson": 0.3},
    "correspondence": {"poisson": 0.1, "stabilisation": 0.5},
}


def both(
    coupling=0.2, diffusivity=0.3, kernel=None, family=2.0, plane=None, dim=2, coupled=True, material="bond-based"
):
    """Model with the coupling constant ``T0 beta^2 / rho c M``."""
    more = {"material": material, **MATERIALS[material]}
    solid = fh.Elastic(kernel or fh.Kernel(2.0, exponent=1), young=1.5, density=1.2, plane=plane, **more)
    beta = (2 if dim == 2 and plane else 3) * solid.lame + 2 * solid.shear
    expansion = np.sqrt(coupling * CAPACITY * solid.p_modulus / ZERO) / beta
    heat = fh.Heat(fh.Kernel(family), 4.0, CAPACITY / 4, diffusivity * CAPACITY)
    return fh.Thermoelastic(solid, heat, expansion, ZERO, coupled)


def errors(lower, upper, open_sides, far, model, initial, sides, until, **more):
    """Return the largest errors of both fields, relative to the largest value of each.

    `open_sides` are those beyond which the larger lattice has `far` more nodes; waves that its ends reflect are still
    on their way.
    """
    low, high = np.array(lower, float), np.array(upper, float)
    less = np.array([far * (f"{axis}-" in open_sides) for axis in "xyz"[: len(low)]])
    more_nodes = np.array([far * (f"{axis}+" in open_sides) for axis in "xyz"[: len(low)]])
    small = fh.Simulation(fh.Lattice(1.0, low, high), model, sides, initial, **more)
    large = fh.Simulation(fh.Lattice(1.0, low - less, high + more_nodes), model, sides, initial, dt=small.dt, **more)
    assert small.parts.thermoelastic == large.parts.thermoelastic != frozenset()
    stiffening = small.parts.near.coupling.stiffening if model.coupled else 0.0
    # the fastest wave would go there and back
    assert 2 * far > 1.1 * until * small.model.p_speed * np.sqrt(small.strongest * (1 + stiffening))
    part = tuple(slice(a, None if b == 0 else -b) for a, b in zip(less, more_nodes, strict=True))
    sizes, largest = np.zeros(2), np.zeros(2)
    for moment in (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0):
        for run in (small, large):
            run.run(moment * until, progress=False)
        for i, (name, base) in enumerate((("u", 0.0), ("T", ZERO))):
            field = large.fields[name][(..., *part)]
            sizes[i] = max(sizes[i], np.abs(field - base).max())
            largest[i] = max(largest[i], np.abs(small.fields[name] - field).max())
    return list(largest / np.where(sizes > 0, sizes, 1))


SPOT, PUSH = "exp(-((x-{0})**2)/18)*(abs(x) < 20)", "exp(-(x**2)/18)"
STRIP = {"x": fh.LatticePML(nodes=24), "y": fh.Periodic()}


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "initial, coupled",
    [({"T": f"300 + {SPOT.format(12)}"}, True), ({"T": f"300 + {SPOT.format(12)}"}, False), ({"u": [PUSH, 0.0]}, True)],
    ids=["heat that reaches the side", "by itself", "a coupled wave"],
)
def test_plane_waves_and_heat_leave(initial, coupled):
    """Along one axis. Once the expansion fell to zero beside the side, and 0.2 of u and a quarter of the coupling
    were missed.
    """
    model = both(coupled=coupled)
    errors_of_fields = errors((-24.0, 0.0), (24.0, 4.0), ("x-", "x+"), 120, model, initial, STRIP, 150.0)
    assert max(errors_of_fields) < 1e-5  # what layers of so many nodes keep for waves along their normal


@pytest.mark.slow
@pytest.mark.parametrize("material", ["state-based", "correspondence"])
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("initial", [{"T": f"300 + {SPOT.format(12)}"}, {"u": [PUSH, 0.0]}], ids=["heat", "wave"])
def test_states_go_on_with_the_heat(material, coupled, initial):
    """The layers continue the force states and the springs beside them."""
    model = both(material=material, coupled=coupled)
    errors_of_fields = errors((-24.0, 0.0), (24.0, 4.0), ("x-", "x+"), 130, model, initial, STRIP, 120.0)
    assert max(errors_of_fields) < 1e-5


@pytest.mark.slow
def test_heat_still_leaves_when_waves_are_long_gone():
    """After seven times the time in which heat diffuses to the side."""
    model = both(coupling=0.1, diffusivity=0.5)
    initial = {"T": f"300 + {SPOT.format(12)}"}
    errors_of_fields = errors((-24.0, 0.0), (24.0, 4.0), ("x-", "x+"), 800, model, initial, STRIP, 1100.0)
    assert max(errors_of_fields) < 1e-4


OPEN = ("x-", "x+", "y-", "y+")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["hot", "hot by itself", "pushed"])
def test_the_plane(name):
    """A hot spot near a side, whose heat leaves after the waves; and waves at all angles."""
    hot = {"T": "300 + exp(-((x-5)**2 + (y-2)**2)/6)"}
    pushed = {"u": ["x*exp(-(x**2 + y**2)/6)", "0.5*exp(-(x**2 + y**2)/6)"]}
    initial = pushed if name == "pushed" else hot
    model, layer = both(coupled=name != "hot by itself"), fh.LatticePML(nodes=16)
    errors_of_fields = errors((-13.0, -13.0), (13.0, 13.0), OPEN, 40, model, initial, layer, 45.0)
    assert max(errors_of_fields) < 1e-4  # the model's target; the small domain's is met tenfold


@pytest.mark.slow
def test_space():
    """A hot spot near the edge of two layers, in a domain that is periodic along the third axis."""
    sides = {"x": fh.LatticePML(nodes=10), "y": fh.LatticePML(nodes=10), "z": fh.Periodic()}
    model = both(kernel=fh.Kernel(1.5, exponent=1), family=1.5, dim=3)
    initial = {"T": "300 + exp(-((x-2)**2 + (y-1)**2 + 2*(cos(pi*z/3) - 1)**2)*0.5)"}
    errors_of_fields = errors((-8.0, -8.0, 0.0), (8.0, 8.0, 5.0), OPEN, 20, model, initial, sides, 22.0)
    assert max(errors_of_fields) < 1e-3  # of layers of ten nodes


def solid(young=1.5, density=1.2, **more):
    return fh.Elastic(fh.Kernel(2.0, exponent=1), young=young, density=density, **more)


def of(elastic, expansion=0.01, integrator="euler"):
    return fh.Thermoelastic(elastic, fh.Heat(fh.Kernel(2.0), 4.0, 0.5, 0.6, integrator), expansion, ZERO)


HOT, UPPER = {"T": "300 + 2*exp(-((x-3)**2 + y**2)/4)"}, "(1 + 0.5*(y > 1))"
VARIANTS = {
    "a density in strata": (of(solid(density=f"1.2*{UPPER}")), HOT, {}),
    "a stiffness in strata": (of(solid(f"1.5*{UPPER}")), HOT, {}),
    "states in strata": (of(solid(f"1.5*{UPPER}", poisson=0.3, material="state-based")), HOT, {}),
    "a conductivity in strata": (of(solid()), HOT, {"coefficient": {"T": f"{UPPER}/1.5"}}),
    "an expansion that varies": (of(solid(), "0.01*(1 + (x**2 + y**2 < 30))"), HOT, {}),
    "drag": (of(solid(damping=0.05)), HOT, {}),
    "a source of heat": (of(solid()), {}, {"sources": {"T": ["exp(-(x**2 + y**2)/4)*sin(t/5)**2"]}}),
    "bonds that break": (of(solid(critical_stretch=8e-3)), HOT, {"cracks": [fh.Crack([(0.0, 0.5), (4.0, 0.5)])]}),
    "single precision": (of(solid()), HOT, {"dtype": "float32"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_what_varies_and_breaks(name):
    """In front of the layers, or uniformly along their normals."""
    model, initial, more = VARIANTS[name]
    sides = {"x": fh.LatticePML(nodes=24), "y": fh.Periodic()}
    errors_of_fields = errors((-13.0, -6.0), (13.0, 6.0), ("x-", "x+"), 45, model, initial, sides, 40.0, **more)
    assert max(errors_of_fields) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("number", range(8))
def test_at_random(number):
    """Random kernels, couplings, conductivities, sides and data keep the model's target."""
    print("seed", SEED)
    random = np.random.default_rng([SEED, number])
    kinds = random.permutation(["open", random.choice(["open", "periodic", "one"])])
    low, high = -random.integers(10, 15, 2), random.integers(10, 15, 2)
    sides, ends = {}, []
    for axis, side in zip("xy", kinds, strict=True):
        if side == "periodic":
            sides[axis] = fh.Periodic()
            continue
        sides[axis] = fh.LatticePML(nodes=16)
        ends += [f"{axis}-", f"{axis}+"]
    plane, material = random.choice(["stress", None]), random.choice(list(MATERIALS))
    model = both(
        10 ** random.uniform(-2, -0.3),
        10 ** random.uniform(-1.5, -0.3),  # within the steps of the solid
        fh.Kernel(random.choice([1.5, 2.0, 3.0]), exponent=int(random.integers(2))),
        random.choice([1.5, 2.0, 3.0]),
        plane,
        coupled=bool(random.random() < 0.7),
        material=str(material),
    )
    at, width = random.uniform(-2, 2, 2), random.uniform(1.2, 1.8)
    bump = f"exp(-((x - ({at[0]:.3f}))**2 + (y - ({at[1]:.3f}))**2)/{2 * width**2:.3f})"
    initial = {"T": f"300 + {bump}"} if random.random() < 0.7 else {}
    if not initial or random.random() < 0.5:
        initial["u"] = [f"{value:.3f}*{bump}" for value in random.standard_normal(2)]
    errors_of_fields = errors(low, high, ends, 45, model, initial, sides, 40.0)
    assert max(errors_of_fields) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("number", range(6))
def test_layers_that_choose_themselves_keep_their_targets(number):
    """For a hot spot, with or without displacements, and coupling constants as solids have them."""
    print("seed", SEED)
    random = np.random.default_rng([SEED, 1, number])
    target = 10 ** random.uniform(-6, -3)
    layer, periodic = fh.LatticePML(target=target, until=40.0), bool(random.integers(2))
    sides = {"x": layer, "y": fh.Periodic() if periodic else layer}
    low, high = -random.integers(10, 15, 2), random.integers(10, 15, 2)
    model = both(
        10 ** random.uniform(-3, -1),
        10 ** random.uniform(-1.5, -0.3),
        fh.Kernel(random.choice([1.5, 2.0, 3.0]), exponent=int(random.integers(2))),
        random.choice([1.5, 2.0, 3.0]),
        random.choice(["stress", None]),
        material=str(random.choice(list(MATERIALS))),
    )
    at = random.uniform(-1.5, 1.5, 2)
    bump = f"exp(-((x - ({at[0]:.3f}))**2 + (y - ({at[1]:.3f}))**2)/4)"
    initial = {"T": f"300 + {bump}"}
    if random.random() < 0.5:
        initial["u"] = [f"{value:.5f}*{bump}" for value in 10 ** random.uniform(-3, 0, 2)]
    ends = OPEN[:2] if periodic else OPEN
    errors_of_fields = errors(low, high, ends, 45, model, initial, sides, 40.0)
    assert max(errors_of_fields) < target


def test_a_hot_spot_on_the_edge_keeps_its_heat_out_of_the_first_rows():
    """Unstretched nodes are put before the layer, whose memory begins with nothing: as many for both fields."""
    sim = fh.Simulation(fh.Lattice(1.0, (-9.0, 0.0), (9.0, 4.0)), both(family=3.0), STRIP)
    heat = sim.time_loop.heating._heat.parts.grid
    assert sim.parts.grid.margins == heat.margins
    assert sim.parts.grid.margins[0, 1] == 4  # one plus the reach of the heat
    assert sim.engine.layout.box.nodes == heat.engine.layout.box.nodes


def matrix_of_a_step(sim):
    """One step of the displacements now and a step ago, the temperature, and the memory of all layers, as a matrix."""
    time_loop, solid = sim.time_loop, sim.engine
    heating = time_loop.heating
    heat = heating._heat.parts.grid.engine
    of_heat = heat.layout.box.node_indices().ravel()
    nodes = solid.all_components(solid.layout.box.node_indices().ravel())

    def step():
        heating._now = heating._temperature_now()
        for _ in time_loop.advance(0, 1):
            pass

    random = np.random.default_rng(SEED)
    for level, places in ((solid.current, nodes), (solid.older, nodes), (heat.current, of_heat)):
        level[places] = random.standard_normal(len(places))
    for _ in range(6):
        step()  # what is zero then is never used
    memory = [(solid, np.flatnonzero(solid.memory)), (heat, np.flatnonzero(heat.memory))]

    def read():
        values = [solid.current[nodes], solid.older[nodes], heat.current[of_heat]]
        values += [engine.memory[places] for engine, places in memory]
        if heating.coupled:
            values += [heating._traces.ravel(), heating._traces_beyond]
        return values

    ends = np.cumsum([len(part) for part in read()])

    def write(values):
        parts = np.split(values, ends[:-1])
        for engine in (solid, heat):
            engine.levels[:], engine.memory[:] = 0, 0
        solid.current[nodes], solid.older[nodes], heat.current[of_heat] = parts[:3]
        for (engine, places), part in zip(memory, parts[3:5], strict=True):
            engine.memory[places] = part
        if heating.coupled:
            heating._traces, heating._traces_beyond = parts[5].reshape(heating._traces.shape).copy(), parts[6].copy()

    matrix = np.zeros((ends[-1], ends[-1]))
    for column, unit in zip(matrix.T, np.eye(ends[-1]), strict=True):
        write(unit)
        step()
        column[:] = np.concatenate(read())
    return matrix


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("coupled", [True, False])
def test_no_mode_between_layers_grows(material, coupled):
    """The spectral radius of a step of both fields and all memory, near the step limit, with strong coupling."""
    print("seed", SEED)
    model = both(0.3, 0.3, fh.Kernel(1.5, exponent=1), 1.5, coupled=coupled, material=material)
    sides, strip = {"x": fh.LatticePML(nodes=6), "y": fh.Periodic()}, fh.Lattice(1.0, (0.0, 0.0), (6.0, 3.0))
    limit = fh.Simulation(strip, model, sides).step_limit
    values = np.linalg.eigvals(matrix_of_a_step(fh.Simulation(strip, model, sides, dt=0.95 * limit)))
    assert 0.99 < np.abs(values).max() < 1 + 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_noise_between_corners_does_not_grow(material):
    """Random displacements, velocities and temperatures, for thirty crossings, at 0.95 of the step limit."""
    print("seed", SEED)
    random, box = np.random.default_rng(SEED), fh.Lattice(1.0, (0.0, 0.0), (36.0, 36.0))
    inside = np.zeros(box.shape)
    inside[12:-12, 12:-12] = 1
    start = {name: 0.1 * random.standard_normal((2, *box.shape)) * inside for name in "uv"}
    start["T"] = ZERO + random.standard_normal(box.shape) * inside
    model, sides = both(0.3, 0.1, material=material), fh.LatticePML(nodes=12)
    limit = fh.Simulation(box, model, sides).step_limit
    sim, sizes = fh.Simulation(box, model, sides, start, dt=0.95 * limit), []
    for _ in range(30):
        sim.run(sim.time + sim.crossing, progress=False, allow_unstable=True)
        sizes.append([np.abs(values).max() for values in (sim.fields["u"], sim.fields["T"] - ZERO, sim.engine.levels)])
    assert (np.max(sizes[-5:], axis=0) < 0.7 * np.array(sizes[5])).all()


SQUARE = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
SIDES = {
    "of one kind": (fh.LatticePML(nodes=6), 4),
    "alike by field": ({"u": fh.LatticePML(nodes=6), "T": fh.LatticePML(nodes=6)}, 4),
    "beside free ones": ({"x-": fh.Free(), "x+": fh.LatticePML(nodes=6), "y": fh.Periodic()}, 1),
    "some of their own": (
        {"u": {"x": fh.LatticePML(nodes=6), "y": fh.Free()}, "T": {"x": fh.LatticePML(nodes=6), "y": fh.Fixed(ZERO)}},
        2,
    ),
    "an extended domain": (fh.Extended(nodes=9), 4),
    "a layer and an extended domain": ({"x": fh.LatticePML(nodes=6), "y": fh.Extended(nodes=9)}, 4),
    "each its own": ({"u": fh.LatticePML(nodes=6), "T": fh.LatticePML(nodes=8)}, 0),
    "a sponge beside": ({"x": fh.LatticePML(nodes=6), "y": fh.Sponge(6)}, 0),
}


@pytest.mark.parametrize("name", SIDES)
def test_which_sides_both_fields_go_through(name):
    sides, count = SIDES[name]
    assert len(fh.Simulation(SQUARE, both(), sides).parts.thermoelastic) == count


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize(
    "sides",
    [
        fh.Extended(target=1e-6),
        {"x-": fh.Extended(target=1e-6), "x+": fh.LatticePML(nodes=24), "y": fh.Extended(target=1e-6)},
    ],
    ids=["extended", "both"],
)
def test_extended_domains_are_as_layers(sides, coupled):
    """A hot spot and its waves, with a domain as large as the length of the run requires."""
    initial = {"T": "300 + exp(-((x-5)**2 + (y-2)**2)/4)"}
    box, model = fh.Lattice(1.0, (-14.0, -14.0), (14.0, 14.0)), both(coupled=coupled)
    runs = [
        fh.Simulation(box, model, given, initial, dt=0.3).run(25.0, progress=False)
        for given in (sides, fh.LatticePML(nodes=24))
    ]
    assert len(runs[0].parts.thermoelastic) == 4
    for name, base in (("u", 0.0), ("T", ZERO)):
        field, reference = (run.fields[name] for run in runs)
        assert np.abs(field - reference).max() < 2e-6 * np.abs(reference - base).max()


def test_a_heat_of_several_stages_shares_no_layer():
    """A layer has no memory for each of them."""
    heat = fh.Heat(fh.Kernel(2.0), 4.0, 0.5, 0.3, "rk4")
    sim = fh.Simulation(SQUARE, fh.Thermoelastic(both().elastic, heat, 1e-3, ZERO), fh.LatticePML(nodes=6))
    assert not sim.parts.thermoelastic and not sim.engine.heat_passes


def test_a_heat_that_needs_shorter_steps_is_not_shared():
    """Without coupling, the solid takes its own steps, at which so fast a heat is not stable."""
    for diffusivity, count in ((0.3, 4), (30.0, 0)):
        sim = fh.Simulation(SQUARE, both(diffusivity=diffusivity, coupled=False), fh.LatticePML(nodes=6))
        assert len(sim.parts.thermoelastic) == count


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("place", [0.0, 16.0])
def test_the_energy_of_a_hot_spot_beside_a_side(place, material):
    """For nodes that do not move, it is that between periodic sides: bonds into the layer feel the heat, too."""
    initial, box = {"T": f"300 + {SPOT.format(place)}"}, fh.Lattice(1.0, (-24.0, 0.0), (24.0, 4.0))
    model = both(coupled=False, material=material)
    strain = [fh.Simulation(box, model, sides, initial).energies()["strain"] for sides in (STRIP, fh.Periodic())]
    assert strain[0] == pytest.approx(strain[1], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize(
    "sides",
    [fh.LatticePML(target=1e-3), {"x": fh.LatticePML(nodes=6), "y": fh.Free()}],
    ids=["that choose themselves", "beside free ones"],
)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_run_goes_on_bit_for_bit(tmp_path, sides, dtype, coupled):
    """From a checkpoint, and pickled, with the memory of the layers of both fields."""
    import pickle

    initial = {"T": "300 + exp(-(x**2 + y**2)/4)", "u": ["0.1*x*exp(-(x**2 + y**2)/4)", 0.0]}
    sim = fh.Simulation(SQUARE, both(coupled=coupled), sides, initial, dtype=dtype)
    sim.run(12.0, progress=False)
    sim.save(tmp_path / "state.h5")
    runs = [sim, fh.Simulation.restore(tmp_path / "state.h5"), pickle.loads(pickle.dumps(sim))]
    for run in runs:
        run.step(25)
    for run in runs[1:]:
        assert run.parts.thermoelastic == sim.parts.thermoelastic != frozenset()
        for name, values in sim.fields.items():
            np.testing.assert_array_equal(run.fields[name], values)
