"""Runs, and the parts of which they are made, as values: pickled and copied."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import farhorizon as fh

PARTS = {
    "lattice": lambda: fh.Lattice(spacing=1.0, window=fh.Disc(5.0)),
    "body": lambda: fh.Lattice(1.0, (-9, -9), (9, 9), body=fh.Box((-9, -9), (9, 9)) - fh.Disc(3.0)),
    "kernel": lambda: fh.Kernel(2.0, influence="linear"),
    "stencil": lambda: fh.Stencil.finite_element(2),
    "wave": lambda: fh.Wave(fh.Kernel(2.0), speed=3.0),
    "elastic": lambda: fh.Elastic(fh.Kernel(2.0), young=2.0, fracture_energy=1.0),
    "heat": lambda: fh.Heat(fh.Kernel(2.0), integrator=fh.RungeKuttaChebyshev(5)),
    "corrosion": lambda: fh.Corrosion(fh.Kernel(1.0), saturation=0.5),
    "beam": lambda: fh.Beam(2.0),
    "layer": lambda: fh.LatticePML(target=1e-6),
    "outline": lambda: fh.PlaneWave(),
    "exact": lambda: fh.Exact(),
    "expression": lambda: fh.Expression("exp(-x**2)*sin(t)", 1),
    "source": lambda: fh.Source("exp(-x**2)", time="sin(t)"),
    "crack": lambda: fh.Crack([(0, 0), (1, 1)], factor=0.5),
    "pressure": lambda: fh.Pressure([(0, 0), (1, 1)], [[1.0, 0.5], [0.5, 2.0]], time="sin(t)"),
    "traction": lambda: fh.Traction("y+", [0, 1.0], time="sin(t)"),
    "text": lambda: fh.Text("A", 1.0),
}
#: Ways to copy a value.
WAYS = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", PARTS)
def test_parts_come_back(name, way):
    part = PARTS[name]()
    again = WAYS[way](part)
    assert type(again) is type(part) and repr(again) == repr(part) and "object at 0x" not in repr(part)


def pulse(**options):
    lattice, model = fh.Lattice(0.5, (-6, -6), (6, 6)), fh.Wave(fh.Kernel(1.0))
    return fh.Simulation(lattice, model, fh.LatticePML(nodes=6), {"u": "exp(-x**2-y**2)"}, **options)


def salt():
    model = fh.Corrosion(fh.Kernel(1.0), saturation=0.5)
    metal = [fh.Specimen(fh.Box((-2, -2), (2, 2)))]
    return fh.Simulation(
        fh.Lattice(0.5, (-4, -4), (4, 4)), model, fh.LatticePML(nodes=4), specimens=metal, balance=True
    )


def cracked():
    crack = [(-2.0, 0.1), (2.0, 0.1)]
    start = {"u": [lambda x, y: 0.01 * np.exp(-(x**2) - y**2), 0.0]}
    solid = fh.Correspondence(fh.Kernel(1.0), 1.0, 0.25, critical_stretch=0.02, drag=0.1)
    return fh.Simulation(fh.Lattice(0.5, (-5, -5), (5, 5)), solid, fh.Fixed(), start, cracks=[crack])


RUNS = {
    "wave": lambda: pulse(sources=["exp(-2*(x**2 + y**2))*sin(t)"], cracks=[[(-2.0, 1.0), (2.0, 1.0)]]),
    "corrosion": salt,
    "exact": lambda: fh.Simulation(
        fh.Lattice(0.5, -6, 6), fh.Wave(fh.Kernel(1.0)), fh.Exact(), {"u": "0.5 + exp(-x**2)"}, background=0.5
    ),
    "body": cracked,
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("way", WAYS)
def test_a_run_goes_on_bitwise(name, way):
    run = RUNS[name]()
    run.step(20)
    again = WAYS[way](run)
    assert (again.time, again.dt) == (run.time, run.dt) and again is not run
    again.step(20)
    before = run.fields["u"]
    run.step(20)
    assert not np.array_equal(before, run.fields["u"], equal_nan=True)  # the copy moved independently
    for field, values in run.fields.items():
        np.testing.assert_array_equal(again.fields[field], values)
    assert again.energy() == run.energy()


def test_probes_and_observers_go_on():
    run = pulse(observe=[print])
    run.record([[0.0, 0.0], [3.0, 0.0]])
    run.step(10)
    again = copy.deepcopy(run)
    for one in (run, again):
        one.step(10)
    assert again.observers == [print] and again.probes is not run.probes and len(run.probes.times) == 21
    np.testing.assert_array_equal(again.probes.values, run.probes.values)


def test_python_functions_are_copied_and_those_with_a_name_pickled():
    run = pulse(sources=[lambda x, y, t: np.exp(-2 * (x**2 + y**2)) * np.sin(t)])
    run.step(5)
    again = copy.deepcopy(run)
    for one in (run, again):
        one.step(5)
    np.testing.assert_array_equal(again.fields["u"], run.fields["u"])
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        pickle.dumps(run)


def test_another_process_goes_on(tmp_path):
    """Addresses and imported modules differ there."""
    run = pulse()
    run.step(20)
    (tmp_path / "run.pickle").write_bytes(pickle.dumps(run))
    script = (
        "import pickle, sys; import numpy as np; run = pickle.loads(open(sys.argv[1], 'rb').read()); run.step(20); "
        "np.save(sys.argv[2], run.fields['u'])"
    )
    files = [str(tmp_path / name) for name in ("run.pickle", "u.npy")]
    subprocess.run([sys.executable, "-c", script, *files], check=True)
    run.step(20)
    np.testing.assert_array_equal(np.load(files[1]), run.fields["u"])
