"""What the layers of a set-up remember: single precision in space where the target allows it."""

from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh

PULSE = "exp(-((x - 7)**2 + (y - 8)**2 + (z - 9)**2)/3)"


def cube(boundary=None, model=None, nodes=17, **changes):
    lattice = fh.Lattice(1.0, (0.0,) * 3, (nodes - 1.0,) * 3)
    return fh.Simulation(lattice, model or fh.Wave(fh.Kernel(2.0)), boundary, **{"initial": {"u": PULSE}, **changes})


@pytest.mark.parametrize(
    ("boundary", "changes", "kept"),
    [
        (None, {}, "float32"),
        (fh.LatticePML(nodes=4, target=1e-5), {}, "float32"),
        (fh.LatticePML(nodes=4, target=9e-6), {}, "float64"),
        (fh.LatticePML(nodes=4), {}, "float64"),  # nobody said what is wanted
        (fh.LatticePML(nodes=4, target=1e-3), {}, "float32"),
        (
            {"x": fh.LatticePML(nodes=3, target=1e-3), "y": fh.LatticePML(nodes=3, target=1e-6), "z": fh.Fixed()},
            {},
            "float64",
        ),
        (fh.LatticePML(nodes=4), {"dtype": "float32"}, "float32"),
        (fh.Fixed(), {}, "float64"),
        (None, {"model": fh.Elastic(fh.Kernel(2.0), 1.0, 0.25), "initial": {"u": [PULSE, "0", "0"]}}, "float32"),
    ],
)
def test_targets_choose_what_is_remembered(boundary, changes, kept):
    assert cube(boundary, **changes).engine.memory.dtype == kept


@pytest.mark.parametrize(("target", "single"), [(1e-3, True), (1e-6, False)])
def test_check_says_what_is_remembered(target, single):
    sim = cube(fh.LatticePML(nodes=3, target=target), nodes=13, initial={})
    assert ("remembered in single precision" in str(sim.check(until=1.0, budget=0.1))) == single


def test_in_the_plane_all_is_remembered():
    """Static fields grow there with the distance from their load, and a layer must remember them exactly."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (16.0, 16.0))
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-((x-8)**2 + (y-8)**2)/3)"})
    assert sim.engine.memory.dtype == "float64"


def in_double(sim):
    """The same layers, remembered in double precision."""
    found = {}
    for (axis, side), layer in sim.engine.layers.items():
        target = sim.sides[axis, side].wanted(sim.model.target)
        name, exact = "xyz"[axis] + "-+"[side > 0], replace(layer, kept="float64")
        found[name] = fh.LatticePML(target=target, nodes=layer.columns, profile=exact)
    return found


THIN = fh.LatticePML(target=1e-3, nodes=6)
SET_UPS = {
    "a pulse": ({}, 40, 1e-8),
    "a load that lasts": ({"initial": {}, "sources": [f"{PULSE}*(1 - exp(-t**2/20))"], "boundary": THIN}, 40, 1e-6),
    "an elastic pulse": (
        {"model": fh.Elastic(fh.Kernel(2.0), 1.0, 0.25), "initial": {"u": [PULSE, "0", "0"]}, "boundary": THIN},
        10,
        1e-7,
    ),
}


@pytest.mark.parametrize("name", SET_UPS)
def test_rounding_what_is_remembered_stays_far_below_the_target(name):
    """Tens of crossings; also where a field stays in the layers, whose memory stops following it when what a step
    changes is below its rounding.
    """
    changes, calls, most = SET_UPS[name]
    short = cube(**changes)
    exact = cube(**{**changes, "boundary": in_double(short)})
    assert (short.engine.memory.dtype, exact.engine.memory.dtype) == ("float32", "float64")
    largest = np.abs(exact.fields["u"]).max()
    worst = 0.0
    for _ in range(calls):
        for sim in (short, exact):
            sim.step(25)
        largest = max(largest, np.abs(exact.fields["u"]).max())
        worst = max(worst, np.abs(short.fields["u"] - exact.fields["u"]).max())
    assert 0 < worst < most * largest


def test_a_run_that_remembers_single_precision_resumes_bitwise(tmp_path):
    whole, first = cube(), cube()
    whole.step(25)
    first.step(13)
    first.save(tmp_path / "cube.ckpt")
    second = fh.Simulation.restore(tmp_path / "cube.ckpt")
    assert second.engine.memory.dtype == "float32"
    second.step(12)
    np.testing.assert_array_equal(second.fields["u"], whole.fields["u"])


def test_the_certificate_examines_the_update_without_rounding():
    """The verdict is that of the layers as they are, and rounding is no linear map."""
    short = cube(nodes=9, initial={"u": "0*x"}, boundary=fh.LatticePML(nodes=2, target=1e-3))
    exact = cube(in_double(short), nodes=9, initial={"u": "0*x"})
    assert short.certificate(budget=20).verdict == exact.certificate(budget=20).verdict


@pytest.mark.parametrize(
    ("kernel", "width", "target", "said"),
    [
        (fh.Kernel(2.0, 0, "constant", volume="full"), 2.4, 1e-3, True),
        (fh.Kernel(2.0, 0, "constant", volume="full"), 4.5, 1e-3, False),
        (fh.Kernel(3.0, 1, "constant", volume="full"), 2.5, 1e-3, True),
        (fh.Kernel(2.0), 2.4, 1e-5, False),  # nothing runs backward
    ],
)
def test_data_that_run_backward_are_told(kernel, width, target, said):
    """exp(-x^2/w^2) holds about exp(-(k w)^2/4) from the wavenumber k on."""
    lattice = fh.Lattice(1.0, -25.0, 25.0)
    sim = fh.Simulation(
        lattice, fh.Wave(kernel), fh.LatticePML(target=target, until=100.0), {"u": f"exp(-(x/{width})**2)"}
    )
    found = [note for note in sim.notes if "run backward" in note]
    assert bool(found) == said
    first = 2 * np.pi / float(found[0].split("less than ")[1].split()[0]) if said else 0.0
    share = float(found[0].split("of the data ")[1].split()[0]) if said else 0.0
    assert not said or 0.1 < share / np.exp(-((first * width) ** 2) / 4) < 10
