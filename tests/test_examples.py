"""Results of the example scripts, and examples with bonds that break on coarser lattices."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.studies.compare import compare

EXAMPLES = Path(__file__).parent.parent / "examples"


def script(name):
    """Return the names of an example script, which is not run as a program."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def test_borehole_from_the_first_horizon_crossing_on():
    """Every probe is within 0.1 % of the exact line source; the slow test reaches the diffusion time of the near
    field.
    """
    example = script("heated_borehole")
    dt, times = example["EARLY"]
    assert np.abs(example["errors"](dt, times[:5])).max() < 1e-3


@pytest.mark.slow
def test_borehole_for_a_hundred_diffusion_times():
    example = script("heated_borehole")
    for dt, times in (example["EARLY"], example["LATE"]):
        assert np.abs(example["errors"](dt, times)).max() < 1e-3


@pytest.mark.slow
def test_plate_with_an_insulating_crack():
    """The difference from refined finite elements decreases when the horizon is halved."""
    differences = script("insulating_crack")["differences"]
    coarse, fine = (np.array(differences(h)) for h in (0.12, 0.06))
    assert (fine < coarse).all()


@pytest.mark.slow
def test_plate_with_an_insulating_crack_converges():
    """Both differences from refined finite elements decrease, the one far from the tips by more than half in two
    halvings.
    """
    differences = script("insulating_crack")["differences"]
    found = np.array([differences(h) for h in (0.12, 0.06, 0.03)])
    assert (found[1:] < found[:-1]).all()
    assert found[-1, 1] < 0.5 * found[0, 1]
    assert found[-1, 1] < 0.01


@pytest.mark.slow
def test_plate_with_an_insulating_crack_within_one_percent():
    """The difference is taken two horizons or more from the tips, with a horizon of 0.015."""
    assert script("insulating_crack")["differences"](0.015)[0] < 0.01


@pytest.mark.slow
def test_penny_crack_in_the_ground():
    """At rest an insulating crack agrees with that in an infinite body, except for its rim: the horizon is a fifth of
    the radius, and the lattice, with a spacing of half the horizon, resolves the radius to half a spacing. Across a
    conducting crack the jump is smaller.
    """
    example = script("penny_crack")
    radius = example["RADIUS"]
    insulating = example["ground"](0.0).run("static", tolerance=0.01, limit=10.0, progress=False)
    jump, total = example["jumps"](insulating)
    assert jump == pytest.approx(4 * radius / np.pi, rel=example["SPACING"] / 2 / radius)
    assert total == pytest.approx(8 * radius**3 / 3, rel=3 * example["SPACING"] / 2 / radius)
    conducting = example["ground"](0.1).run(insulating.time, progress=False)
    assert all(0 < less < more for less, more in zip(example["jumps"](conducting), (jump, total), strict=True))


def test_shot_record():
    """The direct wave and its image in the surface agree with the exact solution in the plane, up to the dispersion
    of finite differences, which is ``k L (k dx)^2 / 24 = 0.07`` radians for the frequency of the pulse at the last
    offset; the echo of the sea floor arrives with its ray.
    """
    example = script("shot_record")
    sim, streamer = example["shot"](0.6)
    ours, known = example["direct"](streamer)
    assert np.abs(ours - known).max() < 0.07 * np.abs(known).max()
    assert sim.check(budget=0.1).numbers["shortest_wave_nodes"] > 7
    offset = example["OFFSETS"][0]
    ray = np.hypot(offset, 2 * (example["FLOOR"] - example["DEPTH"])) / example["WATER"]
    echo = np.where(streamer.times > ray, np.abs(streamer.data["u"][:, 0]), 0.0)
    # the ghosts of gun and hydrophone arrive at most 4 * 10 m / 1480 m/s later
    assert streamer.times[echo.argmax()] - ray == pytest.approx(example["PULSE"].delay + 0.0135, abs=0.0135)


@pytest.mark.slow
def test_quenched_face():
    """Cracks advance with the cold, and fewer and fewer of them continue."""
    example = script("quenched_face")
    sim, found = example["solid"](), []
    for time in example["TIMES"]:
        sim.run(time, progress=False)
        count = example["cracked"](sim)
        deepest = int(np.flatnonzero(count)[-1])
        assert deepest < 2 * 2 * np.sqrt(example["DIFFUSIVITY"] * time)
        found.append((deepest, count[deepest // 2]))
    depths, running = zip(*found, strict=True)
    assert depths[0] < depths[1] < depths[2]
    assert running[0] > running[1] > running[2] > 1


@pytest.mark.slow
def test_double_couple():
    """The lobes are those of Aki and Richards, up to the dispersion of S waves of six nodes per wavelength."""
    example = script("double_couple")
    p, s = example["errors"](example["quake"]()[1])
    assert p < 0.02 and s < 0.05


@pytest.mark.slow
def test_absorbing_gel():
    """The quality between the hydrophones is that of the closed form."""
    example = script("absorbing_gel")
    _, line = example["gel"]()
    measured = example["quality"](example["absorption"](line))
    np.testing.assert_allclose(measured, example["GEL"].quality_at(example["FREQUENCIES"]), rtol=0.02)


@pytest.mark.slow
def test_side_drilled_hole():
    """The echo arrives with its ray, to within a quarter of a period; without the hole there is none: the surface
    waves along the row do not add up with these delays.
    """
    example = script("side_drilled_hole")
    _, probe = example["block"]()
    scan = example["a_scan"](probe)
    found, expected = example["echo"](scan, probe.times)
    assert abs(found - expected) < 0.25 / example["BURST"].frequency
    _, alone = example["block"](hole=False)
    late = probe.times > 7e-6
    assert np.abs(example["a_scan"](alone)[late]).max() < 0.1 * np.abs(scan[late]).max()


@pytest.mark.parametrize("rigid", [False, True], ids=["soft", "rigid"])
def test_cylinders(rigid):
    """The scattered power equals the power lost, and the error of a staircase rim is halved with the spacing."""
    example = script("cylinders")
    exact, errors = np.array([example["series"](frequency, rigid) for frequency in example["FREQUENCIES"]]), []
    for spacing in example["SPACINGS"]:
        scattering, total = example["measured"](spacing, rigid)
        np.testing.assert_allclose(scattering, total, rtol=1e-4)
        errors.append(np.abs(total / exact - 1).mean())
    assert errors[0] < example["SPACINGS"][0] / example["RADIUS"]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.3)


def test_mesh_closed_by_plane_waves():
    """Scattered waves leave the mesh: at all times the error is less than a third of that of a fixed or a free rim,
    and less than a tenth with wide clouds.
    """
    errors = {rim: np.array(values) for rim, values in script("mesh_scatterer")["errors"]().items()}
    rims = np.minimum(errors["fixed"], errors["free"])
    assert (3 * errors["plane waves"] < rims).all()
    assert (10 * errors["plane waves, wide clouds"] < rims).all()


def test_disc_of_quadrilaterals():
    """The elements cover the disc; the error of the condition, which no finer mesh reduces, is less than half of that
    of a fixed or an insulated circle.
    """
    example = script("disc_of_quadrilaterals")
    mesh = example["disc"](8)
    x, y = mesh.p[:, mesh.t]
    area = 0.5 * sum(x[i] * y[(i + 1) % 4] - x[(i + 1) % 4] * y[i] for i in range(4))
    assert (area > 0).all() and area.sum() == pytest.approx(np.pi, rel=0.01)  # of a polygon of 32 corners: 0.6 %
    assert np.allclose(np.hypot(*mesh.p[:, mesh.boundary_nodes()]), 1.0)
    coarse, fine, fixed, insulated = (
        np.array(example["errors"](count, rim))
        for count, rim in ((8, "fitted"), (16, "fitted"), (8, "fixed"), (8, "insulated"))
    )
    assert (2 * coarse < np.minimum(fixed, insulated)).all()
    np.testing.assert_allclose(fine, coarse, rtol=0.1)


def test_indentation():
    """A weak pressure breaks no bonds at the notches, a strong one does; the shares add up to the work."""
    example = script("indentation")
    bonds = []
    for pressure in (0.001, 0.006):
        sim = example["half_space"](pressure)
        sim.run(40.0)
        bonds.append(sim.broken_bonds)
        assert sum(example["share"](sim).values()) == pytest.approx(1, abs=1e-9)
    assert bonds[0] == 0 < bonds[1]


def test_struck_plate():
    """Cracks run at the angle that Kalthoff and Winkler measured, about 70 degrees, and the projectile does as much
    work as it loses.
    """
    example = script("struck_plate")
    sim, motion = example["struck"]("finite")
    length, angle = example["grown"](sim)
    assert length > 0.04
    assert angle == pytest.approx(70, abs=4)
    lost = example["MASS"] / 2 * (example["SPEED"] ** 2 - motion.data["velocity"][-1, 0, 0] ** 2)
    assert sim.energies()["work"] == pytest.approx(lost, rel=2e-3)
    assert abs(sim.balance()["lost"]) < 1e-9 * lost


@pytest.mark.parametrize(("name", "until", "tips"), [("notch_blast", 16.0, 3.5), ("branching", 40.0, 8.0)])
def test_cracks_grow_as_in_the_infinite_medium(name, until, tips):
    """On a lattice of twice the spacing, cracks grow beyond the notch as symmetrically as the set-up is, with an
    error a thousand times smaller than that of a fixed edge.

    A closed box drives the cracks on with its echoes.
    """
    text = (EXAMPLES / f"{name}.toml").read_text()
    for fine, coarse in (
        ("spacing = 0.125", "spacing = 0.25"),
        ("horizon = 0.375", "horizon = 0.75"),
        ("9.9375", "9.875"),
        ("15.9375", "15.875"),
    ):
        text = text.replace(fine, coarse)
    case = Case(text)
    sim = case.simulation().run(until, progress=False)
    damage, x = sim.fields["damage"], case.lattice.coordinates()[0]
    assert np.abs(x[damage > 0.3]).max() > tips
    # rounding decides which of two equal bonds breaks first
    assert max(np.abs(damage - np.flip(damage, axis)).max() for axis in (0, 1)) < 0.1
    assert 0 < sim.balance()["broken"] < sim.balance()["work"]
    curves = compare(case.setup, until, [0.5 * until, until]).curves
    assert curves["lattice PML"]["error_max_over_run"] < 1e-3 * curves["fixed edge"]["error_max_over_run"]


def test_an_inclusion_feels_no_box():
    """The reference is a body so large that nothing returns from its sides."""
    text = (EXAMPLES / "inclusion.toml").read_text()
    wide = text.replace("[-40.0, -30.0]", "[-110.0, -100.0]").replace("[40.0, 30.0]", "[110.0, 100.0]")
    wide = wide.replace('"nonlocal-pml", nodes = 20', '"fixed"')
    near = Case(text).run()
    far = Case(wide).run(dt=near.dt, balance=False)
    assert far.lattice.shape == (221, 201)
    for sim in (near, far):
        sim.run(70.0, progress=False)
    error = np.abs(near.fields["u"] - far.fields["u"][:, 70:-70, 70:-70]).max()
    assert error < 5e-4
    (curve,) = compare(Case(text).setup, 70.0, [70.0], beside=False).curves.values()
    assert curve["error"][-1] == pytest.approx(error, rel=1e-6)
    found = near.balance()
    assert found["lost"] > found["drag"] > 0


@pytest.mark.slow
def test_surface_notch():
    """The corner of notch and surface sends the burst back the way it came: all ray paths are twice as long as that
    to the corner.
    """
    from scipy.signal import hilbert

    case = Case((EXAMPLES / "surface_notch.toml").read_text(encoding="utf-8"))
    sim = case.simulation()
    probe, corner, begins = (np.array(place) for place in (case.parts.output.probes[0], (0.0, 0.0), (-8.4, -7.2)))
    echo = sim.record([probe])
    sim.run(case.parts.run.until, progress=False)
    way = np.sum(corner - begins + corner - probe) / np.sqrt(2)
    expected = way / sim.model.s_speed + 1.6  # the middle of the burst
    across = echo.values[:, 0] @ (-np.sqrt(0.5), np.sqrt(0.5))
    assert abs(echo.times[np.abs(hilbert(across)).argmax()] - expected) < 0.5 / 1.5
    assert np.abs(across).max() > 0.3e-3  # relative to the burst


@pytest.mark.slow
def test_valley():
    """Far from the valley the ground first moves as flat ground does: the coefficients of the lattice's surface are
    those of the continuum, up to (k dx)^2.
    """
    case = Case((EXAMPLES / "valley.toml").read_text(encoding="utf-8"))
    sim = case.simulation()
    ground = sim.record([case.parts.output.probes[0]])
    sim.run(2.0, progress=False)
    p, fast, slow = 0.342 / 1200, 1 / 2078.46, 1 / 1200  # slowness along the ground, and of P and of S waves
    qp, qs = np.sqrt(fast**2 - p**2), np.sqrt(slow**2 - p**2)
    whole = (slow**2 - 2 * p**2) ** 2 + 4 * p**2 * qp * qs
    horizontal = 2 * slow * qs * (slow**2 - 2 * p**2) / whole  # Aki and Richards, section 5.2
    assert np.abs(ground.values[:, 0, 0]).max() == pytest.approx(0.01 * horizontal, rel=0.02)


@pytest.mark.slow
def test_hidden_inclusion():
    """Contrast within 10 % and centre within half a spacing from data without noise, within 20 % with 5 % of noise; a
    sponge as thick as the layer makes an error of the map at least twice as large.
    """
    example = script("hidden_inclusion")
    layer, noisy, sponge = (
        example["measured"](example["inverted"](sides, noise))
        for sides, noise in ((example["LAYER"], 0.0), (example["LAYER"], 0.05), (example["SPONGE"], 0.0))
    )
    assert abs(layer[0] - example["CONTRAST"]) < 0.1 * example["CONTRAST"]
    assert np.abs(layer[1] - example["CENTRE"]).max() < 0.5
    assert abs(noisy[0] - example["CONTRAST"]) < 0.2 * example["CONTRAST"]
    assert sponge[2] > 2 * layer[2]


@pytest.mark.slow
def test_released_heat():
    """The places to a fifth of a length of 1, the heats to a tenth, from data with one percent of noise."""
    example = script("released_heat")
    left = example["released"](example["measured"]())
    for (x, y), heat in example["SPOTS"].items():
        near = np.hypot(example["X"] - x, example["Y"] - y) < 2
        place = (np.stack([example["X"], example["Y"]]) * left)[:, near].sum(1) / left[near].sum()
        assert np.abs(place - (x, y)).max() < 0.2
        assert abs(left[near].sum() * example["LATTICE"].spacing ** 2 / heat - 1) < 0.1


@pytest.mark.parametrize("iterations", [12, pytest.param(30, marks=pytest.mark.slow)])
def test_event_location(iterations):
    """From five percent of noise the place to a tenth of a spacing, and the tensor to a twentieth of its largest entry;
    the reversed records alone meet within a third of the wavelength of P waves, 20, of the event.
    """
    example = script("event_location")
    misfit = example["seismograms"]()
    image = fh.image([(example["ground"](), misfit)], example["UNTIL"], show="sources")
    start = example["meeting"](image)
    assert np.linalg.norm(start - example["PLACE"]) < 20 / 3
    place, tensor = example["located"](misfit, start, iterations)
    within = 0.1 if iterations == 30 else 0.3
    assert np.linalg.norm(place - example["PLACE"]) < within
    assert np.abs(tensor - example["TENSOR"]).max() < within / 2


@pytest.mark.parametrize("bursts", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_surface_array(bursts):
    """Nine tenths of what is bright in the image, more than half of the largest value, lies within a third of a
    wavelength, 10, of the crack.
    """
    example = script("surface_array")
    image = np.abs(example["imaged"](example["shots"](bursts)))
    place, (first, last) = np.stack(example["LATTICE"].coordinates(), -1), example["CRACK"]
    along = np.clip((place - first) @ (last - first) / np.sum((last - first) ** 2), 0, 1)
    distance = np.linalg.norm(place - first - along[..., None] * (last - first), axis=-1)
    bright = image > 0.5 * image.max()
    assert (distance[bright] < 10 / 3).mean() > 0.9
    assert along[bright].min() < 0.2 and along[bright].max() > 0.8


@pytest.mark.parametrize(("guns", "iterations"), [(1, 1), pytest.param(5, 8, marks=pytest.mark.slow)])
def test_layered_inversion(guns, iterations):
    """The misfit falls in each stage, and the error of the speed with it; the water stays as it is."""
    example = script("layered_inversion")
    found = example["inverted"](example["shots"](guns), iterations, jobs=1)
    speed, truth = found.maps["speed"], example["truth"]()
    for stage in range(3):
        misfits = [step.misfit for step in found.history if step.stage == stage]
        assert misfits[-1] < misfits[0]
    water = -example["Y"] < example["FLOOR"]
    assert (speed[water] == example["WATER"]).all()
    if iterations > 1:
        assert np.linalg.norm(speed - truth) < 0.9 * np.linalg.norm(example["START"] - truth)
