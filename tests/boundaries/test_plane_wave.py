"""The condition from plane waves: its fit, published examples against the infinite lattice, clouds of any points, and
what is refused.
"""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis import modes
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.boundaries import plane_wave
from farhorizon.boundaries.plane_wave import Medium, update_matrix

SPACING, DT, DAMPING, RADIUS = 0.25, 0.05, 0.0125, 26.0  # examples 2 and 3 of Hermann et al. (2023), with a larger step


def disc(reach, boundary, radius=RADIUS):
    """Example 2: the fringe of the paper, one horizon wide, lies within the radius."""
    lattice = fh.Lattice(SPACING, window=fh.Disc(radius - reach * SPACING))
    model = fh.Wave(fh.Kernel(reach * SPACING, 2, calibrate=False), damping=DAMPING)
    return fh.Simulation(lattice, model, boundary, {"u": lambda x, y: np.exp(-np.log(2) * (x**2 + y**2))}, dt=DT)


def errors(sim, times):
    """Return the largest differences from the infinite lattice over the near field."""
    steps = [round(t / sim.dt) for t in times]
    rate = sim.model.coefficient / sim.lattice.spacing**2
    exact = InfiniteLattice(
        sim.stencil, rate, sim.model.integrator, sim.dt, steps[-1], sim.start_u, None, sim.model.damping
    )
    found = []
    for n in steps:
        sim.step(n - sim.step_count)
        found.append(np.nanmax(np.abs(sim.fields["u"] - exact.after(n))))
    return np.array(found)


# the fit of the independent program, which regularises no more than rounding requires
SHARP = {"angle": 60.0, "wavenumber": 0.5 / SPACING, "regularization": 4e-5}
EXAMPLE_2 = [  # errors at t = 30, 40, 50 that an independent program found
    (3, fh.PlaneWave(**SHARP), (5.9e-5, 1.2e-4, 1.8e-4)),
    (3, fh.Higdon((0, 45), 0.02), (7.2e-4, 5.9e-4, 1.1e-3)),
    (6, fh.PlaneWave(**SHARP, thin=2), (2.3e-4, 2.5e-4, 4.5e-4)),
    (6, fh.Higdon((0, 45), 0.02), (6.5e-4, 4.2e-4, 8.4e-4)),
]


@pytest.mark.parametrize("reach, boundary, known", EXAMPLE_2)
def test_example_2_of_hermann(reach, boundary, known):
    assert (errors(disc(reach, boundary), (30, 40, 50)) < 2 * np.array(known)).all()


@pytest.mark.parametrize("reach", [3, 6])
def test_lattice_pml_beside_it(reach):
    assert (errors(disc(reach, fh.LatticePML(nodes=12)), (30, 40, 50)) < 1e-7).all()


HEXAGON = fh.Polygon([(12.4 * np.cos(a), 12.4 * np.sin(a)) for a in np.arange(6) * np.pi / 3])
SQUARE = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
CUBE = fh.Lattice(1.0, (-5.0,) * 3, (5.0,) * 3)
SET_UPS = {
    "elements on a square": (SQUARE, fh.Stencil.finite_element(2)),
    "elements on a disc": (fh.Lattice(1.0, window=fh.Disc(12.3)), fh.Stencil.finite_element(2)),
    "elements beside a free top": (SQUARE, fh.Stencil.finite_element(2)),
    "finite differences": (SQUARE, fh.Stencil.finite_difference(2)),
    "exponent 0": (SQUARE, fh.Kernel(3.0, 0)),
    "exponent 1": (SQUARE, fh.Kernel(3.0, 1)),
    "exponent 1 on a disc": (fh.Lattice(1.0, window=fh.Disc(12.3)), fh.Kernel(3.0, 1)),
    "exponent 2": (SQUARE, fh.Kernel(3.0, 2)),
    "exponent 2, whole radius": (fh.Lattice(1.0, window=fh.Disc(12.0)), fh.Kernel(3.0, 2)),
    "beside a free top": (SQUARE, fh.Kernel(3.0, 2)),
    "hexagon": (fh.Lattice(1.0, window=HEXAGON), fh.Kernel(3.0, 2)),
    "horizon of 6 spacings": (fh.Lattice(1.0, window=fh.Disc(16.3)), fh.Kernel(6.0, 2)),
    "cube": (CUBE, fh.Stencil.finite_difference(3)),
    "ball": (fh.Lattice(1.0, window=fh.Ball(5.3)), fh.Kernel(2.0, 2)),
    "cube, exponent 1": (CUBE, fh.Kernel(2.0, 1)),
}


@pytest.mark.parametrize("share", [0.5, 0.1])
@pytest.mark.parametrize("name", SET_UPS)
def test_default_is_certified_in_damped_media(name, share):
    """At the default step, half of the stable one, and at a fifth of it; waves lose 14 % in crossing the square."""
    lattice, operator = SET_UPS[name]
    model = fh.Wave(operator, damping=0.15 / 24)
    top = {"x": fh.PlaneWave(), "y-": fh.PlaneWave(), "y+": fh.Free()}
    setup = {"lattice": lattice, "model": model, "boundary": top if name.endswith("top") else fh.PlaneWave()}
    dt = share * fh.Simulation(**setup).step_limit
    assert fh.Simulation(**setup, dt=dt).certificate(60.0).verdict == "certified"


def test_noise_decays_with_the_default():
    """Independently of the certificate: on a hexagon, from ten crossings to twenty."""
    lattice, operator = SET_UPS["hexagon"]
    noise = np.where(lattice.mask, np.random.default_rng(5).standard_normal(lattice.shape), 0.0)
    sim = fh.Simulation(lattice, fh.Wave(operator, damping=0.15 / 24), fh.PlaneWave(), {"u": noise})
    norms = []
    for _ in range(2):
        sim.step(round(240 / sim.dt))
        norms.append(np.nansum(sim.fields["u"] ** 2))
    assert norms[1] < 0.5 * norms[0]


def test_default_on_finite_elements():
    """Example 1 of Hermann et al. (2023): errors no larger than those of the paper's first-order condition."""
    lattice = fh.Lattice(0.5, (-25.5, -25.5), (25.5, 25.5))
    start = {"u": lambda x, y: np.exp(-np.log(2) / 9 * (x**2 + y**2))}
    model, found = fh.Wave(fh.Stencil.finite_element(2), damping=DAMPING), {}
    for boundary in (fh.PlaneWave(), fh.FirstOrder()):
        found[type(boundary)] = errors(fh.Simulation(lattice, model, boundary, start, dt=0.1), (30, 40, 50))
    assert (found[fh.PlaneWave] < 0.5 * found[fh.FirstOrder]).all()


def test_images_of_a_cloud_share_a_fit(monkeypatch):
    """The same weights as with a fit for each cloud, on a disc with free normals, and an eighth of the fits."""
    model, fits = fh.Wave(fh.Kernel(3.0, 2)), []
    fitted = plane_wave._fitted
    monkeypatch.setattr(plane_wave, "_fitted", lambda *given: fits.append(1) or fitted(*given))

    def update():
        fits.clear()
        lattice = fh.Lattice(1.0, window=fh.Disc(9.2))
        found = fh.Simulation(lattice, model, fh.PlaneWave(normals="free")).closure.update
        return found.toarray(), len(fits)

    shared, few = update()
    monkeypatch.setattr(plane_wave, "_oriented", lambda normal, steps: (normal, steps))
    single, many = update()
    np.testing.assert_allclose(shared, single, atol=1e-9)
    assert few < many / 4


def test_check_reports_remark_1():
    """Condition number and norm of V of a collocation, against numpy's, and the cut-off that remark 1 implies."""
    boundary = fh.PlaneWave(fit="collocation", radius=2.0, cone=90.0, wavenumber=0.5)
    sim = fh.Simulation(SQUARE, fh.Wave(fh.Stencil.finite_element(2)), boundary, dt=0.1)
    medium, recipe = sim.closure.medium, boundary.recipe(sim.closure.medium, 1.0, 12.0)
    worst = 0.0
    for normal in (np.array([1.0, 0.0]), np.array([1.0, 1.0]) / np.sqrt(2)):
        ball = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 2, indexing="ij"), -1).reshape(-1, 2)
        places = ball[(np.linalg.norm(ball, axis=1) < 2.1) & (ball @ normal < 1e-9)]
        k = np.stack(np.meshgrid(recipe.wavenumbers, np.radians(np.linspace(-45, 45, 11))), -1).reshape(-1, 2)
        k = k[:, :1] * (np.cos(k[:, 1:]) * normal + np.sin(k[:, 1:]) * np.array([-normal[1], normal[0]]))
        factor = modes.factors(medium.symbol(k, "discrete"), 0.1, 2)
        shape = np.exp(1j * k @ places.T)
        matrix = np.concatenate([shape, shape / factor[:, None]], axis=1)
        worst = max(worst, np.linalg.cond(np.concatenate([matrix.real, matrix.imag])))
    text = dict(sim.check().rows)["fitted"]
    found = [
        float(text.split(what)[1].split()[0].strip(",")) for what in ("condition number at most", "norm of V at most")
    ]
    assert found[0] == pytest.approx(worst, rel=0.05)
    assert found[1] == pytest.approx(np.abs(sim.closure.update.data).max(), rel=0.01)
    assert fh.PlaneWave().rcond == 1e-12


def test_published_condition_grows_on_a_disc():
    """Clouds turned to each node's normal overflow, as in an independent program (log growth 10.9 per unit time)."""
    published = fh.PlaneWave(fit="collocation", normals="free", wavenumber=1.0, thin=1)
    with pytest.raises(fh.UnstableError):
        disc(3, published, 10.0).run(60.0, progress=False, allow_unstable=True)


# largest wavenumber; error at t = 250 relative to the largest value then, two digits from an independent program
EXAMPLE_1 = [(0.1, 0.029), (0.2, 0.010), (0.5, 0.029), (1.0, 0.072), (8.0, 0.34)]


@pytest.mark.parametrize("wavenumber, known", EXAMPLE_1)
def test_example_1_of_shojaei(wavenumber, known):
    """Peridynamic diffusion on a line, with a horizon and a layer of four spacings and clouds of two; a step 10 times
    the paper's.
    """
    spacing = 0.125
    boundary = fh.PlaneWave(radius=2 * spacing, wavenumber=wavenumber, wavenumbers=20)
    sim = fh.Simulation(
        fh.Lattice(spacing, (-29.5,), (29.5,)),
        fh.Diffusion(fh.Kernel(4 * spacing, 1)),
        boundary,
        {"u": lambda x: np.exp(-4 * x**2)},
        dt=0.005,
    )
    error = errors(sim, (250.0,))[0]
    assert error / sim.fields["u"].max() == pytest.approx(known, rel=0.1, abs=5e-4)


def test_small_crosses_in_diffusion_never_grow():
    """Clouds of nearest neighbours: weights that are not negative and sum to at most 1, so that no value exceeds the
    largest one before.
    """
    for dim, exponent in ((1, 1), (2, 1), (3, 1)):
        lattice = fh.Lattice(0.1, (-1.0,) * dim, (1.0,) * dim)
        sim = fh.Simulation(lattice, fh.Diffusion(fh.Kernel(0.2, exponent)), fh.PlaneWave(wavenumber=0.5))
        assert np.abs(sim.closure.update).sum(1).max() < 1 + 1e-6


@pytest.mark.parametrize("balanced", [True, False])
def test_symmetry_in_space(balanced):
    """Rings of directions keep a ball symmetric, up to rounding; the published grid of angles does not."""
    sim = fh.Simulation(
        fh.Lattice(0.1, window=fh.Ball(0.8)),
        fh.Diffusion(fh.Kernel(0.2, 1)),
        fh.PlaneWave(angles=9, balanced=balanced),
        {"u": lambda x, y, z: np.exp(-40 * (x**2 + y**2 + z**2))},
    )
    sim.step(300)
    u = np.nan_to_num(sim.fields["u"])
    worst = (
        max(np.abs(u - image).max() for image in (u[::-1], u[:, ::-1], u.transpose(1, 0, 2), u.transpose(2, 1, 0)))
        / u.max()
    )
    assert worst < 1e-12 if balanced else worst > 1e-4


def test_fitted_waves_go_on():
    """A plane wave among the fitted ones meets its own next value: the residual is small relative to that of values
    that stay.
    """
    grid = np.stack(np.meshgrid(*[SPACING * np.arange(-12, 13)] * 2, indexing="ij"), -1).reshape(-1, 2)
    stencil = fh.Stencil.from_kernel(fh.Kernel(3 * SPACING, 2), SPACING, 2)
    medium = Medium(2, 1.0, DT, 0.0, SPACING * stencil.offsets, stencil.weights / SPACING**2, 3 * SPACING)
    middle = np.flatnonzero(np.abs(grid).sum(1) == 0)
    matrix = update_matrix(grid, middle, np.array([[1.0, 0.0]]), medium, fh.PlaneWave(**SHARP), enclosing=False)
    for angle in np.radians([0, 20, 40, 55]):
        k = 1.1 * np.array([[np.cos(angle), np.sin(angle)]])
        factor = modes.factors(medium.symbol(k, "discrete"), DT, 2)[0]
        wave = np.exp(1j * grid @ k[0])
        fitted = (matrix @ np.concatenate([wave, wave / factor]))[0]
        assert abs(fitted - factor) < 0.02 * abs(factor - 2 + 1 / factor)


def random_disc(seed=3, count=1500):
    """Random points in the unit disc, and a ring of absorbing ones around them."""
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 2))
    points = points[np.linalg.norm(points, axis=1) < 0.95]
    turn = np.linspace(0, 2 * np.pi, 160, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.concatenate([points, ring]), len(points) + np.arange(160), ring


def test_any_points():
    """Random points: waves along the normal go on; at half of the nodes or more, at most a tenth of the acceleration
    is missed.
    """
    points, absorbing, normals = random_disc()
    medium = Medium(2, 1.0, 0.005)
    matrix = update_matrix(
        points, absorbing, normals, medium, fh.PlaneWave(radius=0.2, wavenumber=15.0, thin=1), spacing=0.05
    )
    assert matrix.shape == (160, 2 * len(points))
    k = 8.0
    factor = np.exp(-1j * k * 0.005)
    waves = np.exp(1j * k * points @ normals.T)
    fitted = (matrix @ np.concatenate([waves, waves / factor])).diagonal() / waves[absorbing].diagonal()
    assert np.median(np.abs(fitted - factor)) < 0.1 * abs(factor - 2 + 1 / factor)


BAD_POINTS = [
    ({"absorbing": slice(0, 80), "normals": slice(0, 80)}, "do not enclose"),
    ({"condition": fh.PlaneWave(radius=0.001)}, "no neighbours"),
    ({"condition": fh.PlaneWave(radius=0.2, wavenumber=1e4)}, "too short"),
    ({"medium": Medium(1, 1.0, 0.005), "condition": fh.PlaneWave(radius=0.2, wavenumber=1e3)}, "overflow"),
    (
        {"medium": Medium(1, 1.0, 1e-9), "condition": fh.PlaneWave(radius=0.2, wavenumber=1e4)},
        "overflow within a cloud",
    ),
    ({"condition": fh.PlaneWave(radius=0.2, dispersion="discrete")}, "no stencil"),
    ({"condition": fh.PlaneWave(radius=0.2, dispersion="taylor")}, "series"),
    ({"normals": np.zeros((160, 2))}, "normal of nonzero length"),
    ({"points": np.full((2000, 2), np.nan)}, "finite"),
]


@pytest.mark.parametrize("changes, message", BAD_POINTS)
def test_bad_points(changes, message):
    points, absorbing, normals = random_disc()
    given = {"points": points, "absorbing": absorbing, "normals": normals, "medium": Medium(2, 1.0, 0.005)}
    given |= {name: given[name][value] if isinstance(value, slice) else value for name, value in changes.items()}
    with pytest.raises(fh.InputError, match=message):
        update_matrix(**given)


@pytest.mark.parametrize(
    "options",
    [
        {"fit": "galerkin"},
        {"dispersion": "exact"},
        {"radius": 0.0},
        {"angle": 90.0},
        {"regularization": -1.0},
        {"rcond": 1.0},
        {"thin": 0},
        {"wavenumber": np.nan},
        {"normals": "radial"},
        {"time": "later"},
    ],
)
def test_bad_options(options):
    with pytest.raises(fh.InputError):
        fh.PlaneWave(**options)


SOLIDS = {
    "bonds": fh.Elastic(fh.Kernel(2.0), young=1.0),
    "states": fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.15, material="state-based"),
    "nearly incompressible": fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.45, material="state-based"),
    "elements": fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element"),
}
SHOVE = {"u": ["exp(-((x - 1)**2 + (y + 1)**2)/6)", "0*x"]}


@pytest.mark.parametrize("name", SOLIDS)
def test_modes_of_solids_are_eigenvectors_of_the_symbol(name):
    stencil = SOLIDS[name].medium(1.0, 2)
    k = np.array([[0.3, -0.7], [1.9, 0.4]])
    symbols, polar = modes.polarised(k, stencil.offsets.astype(float), stencil.weights)
    matrices = np.repeat(stencil.symbol(*k.T), 2, axis=0)
    np.testing.assert_allclose(np.einsum("mij,mj->mi", matrices, polar), symbols[:, None] * polar, atol=1e-13)


def test_a_fit_of_several_components_contains_that_of_one():
    """Two components that do not interact, of one speed, are two scalar fields."""
    medium, k = fh.Stencil.finite_difference(2), np.random.default_rng(3).uniform(0.1, 1.0, (40, 2))
    places = np.array([[0.0, 0.0], [-1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    symbol = medium.symbol(*k.T)
    factor, shape = modes.factors(symbol, 0.1, 2), modes.phases(k, places)
    both, polar = np.repeat(np.arange(40), 2), np.tile(np.eye(2), (40, 1))
    scalar = modes.CloudModes(shape, factor, symbol)
    vector = modes.CloudModes(shape[both], factor[both], symbol[both], polar)
    for one, two in (
        (modes.fit(scalar, 2), modes.fit(vector, 2)),
        (modes.fit_operator(scalar, 0, 0.1, 2, 1.0, 0.1), modes.fit_operator(vector, 0, 0.1, 2, 1.0, 0.1)),
    ):
        expected = one.weights[:, :, None, None] * np.eye(2)
        np.testing.assert_allclose(two.weights.reshape(expected.shape), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", SOLIDS)
def test_what_solids_reflect_at_normal_incidence(name):
    """P and S pulses in a strip, halved on their way to both ends: what remains, against the half that arrives."""
    model = SOLIDS[name]
    for component, speed, bound in ((0, model.p_speed, 0.05), (1, model.s_speed, 0.02)):  # measured: 0.035 and 0.01
        start = ["0*x", "0*x"]
        start[component] = "exp(-(x/4)**2)"
        line, sides = fh.Lattice(1.0, (-20.0, 0.0), (20.0, 9.0)), {"x": fh.PlaneWave(), "y": fh.Periodic()}
        sim = fh.Simulation(line, model, sides, {"u": start})
        sim.run(until=40.0 / speed, progress=False)
        assert np.abs(sim.fields["u"]).max() < bound * 0.5


@pytest.mark.parametrize("window", [False, True])
@pytest.mark.parametrize("name", ["bonds", "nearly incompressible"])
def test_solids_beside_the_infinite_lattice_and_other_sides(name, window):
    """What the page on these conditions says of a pulse three nodes wide in 33 nodes; a free edge reflects more, a
    lattice PML of eight nodes less.
    """
    model = SOLIDS[name]
    lattice = fh.Lattice(1.0, window=fh.Disc(16.0)) if window else fh.Lattice(1.0, (-16.0,) * 2, (16.0,) * 2)
    shove = {"u": ["exp(-((x - 3)**2 + (y + 2)**2)/9)", "0*x"]}
    times, wide = (20.0, 30.0, 40.0), fh.Lattice(1.0, (-60.0,) * 2, (60.0,) * 2)
    infinite = fh.Simulation(wide, model, fh.Fixed(), shove)
    sides = {"fitted": fh.PlaneWave(), "layer": fh.LatticePML(nodes=8)} | ({} if window else {"free": fh.Free()})
    runs = {what: fh.Simulation(lattice, model, side, shove, dt=infinite.dt) for what, side in sides.items()}
    errors = dict.fromkeys(runs, 0.0)
    for t in times:
        infinite.step(round(t / infinite.dt) - infinite.step_count)
        reach = lattice.shape[0] // 2
        exact = infinite.fields["u"][:, 60 - reach : 61 + reach, 60 - reach : 61 + reach]
        for what, sim in runs.items():
            sim.step(infinite.step_count - sim.step_count)
            errors[what] = max(errors[what], float(np.nanmax(np.abs(sim.fields["u"] - exact))))
    assert errors["layer"] < errors["fitted"] < 0.03
    assert window or errors["fitted"] < errors["free"] / 5


@pytest.mark.parametrize("name", ["bonds", "states", "nearly incompressible"])
def test_solids_are_certified_where_they_are_damped(name):
    """The damping that the advice about growth names."""
    given, lattice = SOLIDS[name], fh.Lattice(1.0, (-10.0,) * 2, (10.0,) * 2)
    more = {} if given.material == "bond-based" else {"poisson": given.poisson, "material": given.material}
    damped = fh.Elastic(fh.Kernel(2.0), young=1.0, damping=0.15 * given.p_speed / 20, **more)
    assert fh.Simulation(lattice, damped, fh.PlaneWave(), SHOVE).certificate().verdict == "certified"


def test_solids_that_conditions_do_not_close():
    cube = fh.Lattice(1.0, (-6.0,) * 3, (6.0,) * 3)
    with pytest.raises(fh.InputError, match=r"in the plane; value: .* in 3 dimensions"):
        fh.Simulation(cube, SOLIDS["bonds"], fh.PlaneWave())
    with pytest.raises(fh.InputError, match="conditions for scalar waves are tuned"):
        fh.tuned(fh.Simulation(SQUARE, SOLIDS["bonds"], fh.PlaneWave(), SHOVE))
