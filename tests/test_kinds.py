"""Odd values in the place of any argument are either used or refused by an InputError that names the argument."""

import inspect

import numpy as np
import pytest

import farhorizon as fh
from farhorizon import kinds
from farhorizon.case.case import Case
from farhorizon.errors import shown

LINE = fh.Lattice(0.5, -4.0, 4.0)
PLANE = fh.Lattice(0.5, (-3.0, -3.0), (3.0, 3.0))
TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
KERNEL = fh.Kernel(1.0)
RECORD = {"points": [[0.0, 0.0], [1.0, 0.0]], "times": [0.0, 1.0], "u": [[0.0, 0.0], [0.0, 1.0]], "medium": 1.0}
DISC = fh.Disc(1.0)


def twice(u):
    return 2 * u


ODD = [
    None,
    "text",
    "",
    [],
    [1.0, "a"],
    [[1.0], [1.0, 2.0]],
    1 + 2j,
    np.nan,
    np.inf,
    -np.inf,
    -1,
    0,
    2.5,
    True,
    1e300,
    10**400,
    object(),
    np.zeros((2, 3)),
    np.array(["a"]),
    {},
    {"a": 1},
    lambda: 0.0,
    np.sin,
    fh.Wave,
]

TINY = Case("""lattice = { spacing = 0.5, lower = [-3.0], upper = [3.0] }
model = { type = "wave", kernel = { horizon = 1.0 } }
boundary = { all = { type = "fixed" } }
run = { until = 1.0 }""")
STILL = fh.Setup(LINE, fh.Wave(KERNEL), fh.Fixed(), {"u": "exp(-x**2)"}, dt=0.1)
SETUP = {
    "lattice": LINE,
    "model": fh.Wave(KERNEL),
    "boundary": None,
    "initial": None,
    "sources": (),
    "cracks": (),
    "coefficient": None,
    "background": 0.0,
    "dt": None,
    "dtype": "float64",
    "threads": 1,
    "rule": "both",
    "rim": "free",
    "constraints": (),
    "balance": False,
    "specimens": (),
    "loads": (),
}
# Valid arguments of every public callable.
RIGHT = {
    "Attenuation": {
        "quality": 50.0,
        "band": (0.1, 1.0),
        "exponent": 0.0,
        "reference": None,
        "mechanisms": None,
        "regions": (),
    },
    "Auto": {"target": None, "until": None},
    "Ball": {"radius": 1.0, "centre": (0.0, 0.0, 0.0)},
    "Beam": {"stiffness": 1.0, "damping": 0.0},
    "BodyForce": {"value": [1.0, 0.0], "time": None},
    "BilinearSoftening": {"onset": 0.01, "final": 0.04},
    "Box": {"lower": (0.0, 0.0), "upper": (1.0, 1.0)},
    "Chirp": {"first": 1.0, "last": 2.0, "duration": 10.0},
    "Convection": {"where": "x-", "transfer": 1.0, "ambient": 0.0, "within": None, "region": None},
    "Correspondence": {
        "kernel": KERNEL,
        "young": 1.0,
        "poisson": 0.3,
        "density": 1.0,
        "plane": "strain",
        "critical_stretch": None,
        "shape_tensor": "recomputed",
        "drag": 0.0,
        "stabilisation": 0.0,
        "contact": False,
        "friction": 0.0,
    },
    "Corrosion": {
        "operator": KERNEL,
        "diffusivity": 1.0,
        "saturation": 0.5,
        "interface": 0.1,
        "integrator": "euler",
        "limited": False,
    },
    "Crack": {"cut": [[0.0, 0.0], [1.0, 0.0]], "factor": 0.0, "opens": 0.0},
    "Diffusion": {"operator": KERNEL, "diffusivity": 1.0, "integrator": "euler"},
    "Disc": {"radius": 1.0, "centre": (0.0, 0.0)},
    "DiscCut": {"centre": (0.0, 0.0, 0.0), "normal": (0.0, 0.0, 1.0), "radius": 1.0},
    "Elastic": {
        "kernel": KERNEL,
        "young": 1.0,
        "poisson": None,
        "bulk": None,
        "shear": None,
        "density": 1.0,
        "material": "bond-based",
        "plane": None,
        "damping": 0.0,
        "stabilisation": 0.0,
        "nonlinear": False,
        "critical_stretch": None,
        "fracture_energy": None,
        "softening": None,
        "law": None,
        "contact": None,
        "friction": 0.0,
        "integrator": "verlet",
        "attenuation": None,
        "surface": None,
        "calibrate": "running",
    },
    "Elements": {"elements": (TETRAHEDRON, [(0, 1, 2, 3)]), "group": None, "scale": 1.0},
    "Exact": {"compress": 1e-12},
    "ExponentialSoftening": {"onset": 0.01, "final": 0.04},
    "Expression": {"text": "x", "dim": 1},
    "Extended": {"target": None, "nodes": None, "until": None},
    "FarField": {
        "box": None,
        "frequencies": [0.1],
        "points": None,
        "directions": 8,
        "history": True,
        "name": "far_field",
    },
    "FirstOrder": {},
    "Fixed": {"value": 0.0},
    "Flux": {"where": "x-", "value": 0.0, "kind": "source", "within": None, "region": None},
    "Free": {},
    "Gaussian": {"width": 1.0, "delay": 5.0},
    "Heat": {
        "operator": KERNEL,
        "density": 1.0,
        "specific_heat": 1.0,
        "conductivity": 1.0,
        "integrator": "euler",
        "self_term": "centre",
    },
    "Higdon": {"angles": (0.0, 45.0), "shift": None},
    "ImageMask": {"image": np.ones((2, 2), bool), "width": 1.0, "centre": (0.0, 0.0), "threshold": 0.5},
    "Impedance": {"stiffness": 1.0, "viscosity": 0.0, "tangential_stiffness": None, "tangential_viscosity": None},
    "IncidentField": {"field": "cos(x)*cos(t)", "within": None},
    "IncidentRecord": {"record": RECORD, "name": "shell", "within": None},
    "IncidentWave": {"direction": (1.0, 0.0), "signal": "sin(t)", "duration": 1.0, "polarisation": "P", "within": None},
    "Insulated": {"where": "x-", "kind": "mirror", "within": None},
    "Kernel": {
        "horizon": 1.0,
        "exponent": 2,
        "influence": "constant",
        "width": None,
        "volume": "ramp",
        "calibrate": True,
    },
    "Lattice": {"spacing": 0.5, "lower": (0.0, 0.0), "upper": (1.0, 1.0), "window": None, "body": None},
    "LatticePML": {"target": None, "nodes": None, "profile": None, "until": None, "angle": None, "wavelengths": None},
    "LossyRegion": {"region": fh.Disc(1.0), "quality": 20.0},
    "LineSource": {"points": [(0.0,), (1.0,)], "strength": 1.0, "time": None, "interpolation": "sinc"},
    "Mesh": {"triangles": (TETRAHEDRON, [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]), "scale": 1.0, "centre": None},
    "MomentTensor": {
        "at": (0.0, 0.0, 0.0),
        "moment": 1.0,
        "time": None,
        "strike": 0.0,
        "dip": 90.0,
        "rake": 0.0,
        "interpolation": "sinc",
    },
    "NonlocalPML": {
        "nodes": 30,
        "ramp": "cubic",
        "strength": None,
        "reflection": 1e-3,
        "plateau": 0.3,
        "cross": 0.0,
        "shift": 0.0,
    },
    "Periodic": {},
    "PhasedArray": {
        "first": (0.0, 0.0),
        "last": (2.0, 0.0),
        "elements": 3,
        "strength": 1.0,
        "time": "sin(t)",
        "speed": 1.0,
        "focus": None,
        "angle": 10.0,
        "width": 0.5,
        "across": None,
        "interpolation": "sinc",
    },
    "PlaneWave": {
        "fit": None,
        "dispersion": None,
        "time": None,
        "layer": None,
        "radius": None,
        "cone": None,
        "thin": None,
        "normals": None,
        "angle": None,
        "angles": 11,
        "wavenumber": None,
        "wavenumbers": None,
        "smallest": None,
        "regularization": None,
        "rcond": 1e-15,
        "balanced": True,
    },
    "OfField": {"value": "u*(1 - u)"},
    "PointCut": {"x": 0.0},
    "PointForce": {"at": (0.0, 0.0), "force": (1.0, 0.0), "time": None, "interpolation": "sinc"},
    "PointSource": {"at": 0.0, "strength": 1.0, "time": None, "interpolation": "sinc"},
    "Polygon": {"points": [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]},
    "PolygonCut": {"points": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]},
    "Polyline": {"points": [(0.0, 0.0), (1.0, 0.0)]},
    "Prescribed": {"where": [0.0], "value": 0.0, "until": None, "rate": None, "velocity": None},
    "RayleighWave": {"direction": (1.0, 0.0), "signal": "sin(t)", "duration": 1.0, "within": None},
    "Receivers": {"points": [[0.0]], "record": "u", "every": 1, "interpolation": "sinc", "name": "a"},
    "Spectra": {
        "where": [[0.0]],
        "frequencies": [0.1],
        "record": "u",
        "every": 1,
        "interpolation": "sinc",
        "name": "a",
    },
    "CrackTips": {"every": 1, "most": 6, "name": "a"},
    "StressIntensity": {"tips": [(1.0, 0.0)], "radii": (1.0, 2.0), "every": 1, "name": "a"},
    "Reaction": {"region": None, "every": 1, "name": "a"},
    "Impacts": {"every": 1, "name": "a"},
    "Impactor": {"shape": DISC, "mass": 1.0, "velocity": [0.0, 0.0], "path": None, "friction": 0.0, "stiffness": None},
    "PowerThrough": {"surfaces": [("x", 0.1)], "frequencies": [0.1], "name": "a"},
    "Probes": {"lattice": LINE, "points": [0.0], "stride": 1},
    "Rectangle": {"corner": (0.0, 0.0, 0.0), "edge1": (1.0, 0.0, 0.0), "edge2": (0.0, 1.0, 0.0)},
    "ShellRecorder": {"box": None, "name": "a"},
    "Ricker": {"frequency": 1.0, "delay": 2.0},
    "RungeKuttaChebyshev": {"chebyshev": 20},
    "Samples": {"values": [0.0, 1.0, 1.0, 0.0], "dt": 1.0},
    "Setup": SETUP,
    "Simulation": {**SETUP, "observe": (), "communicator": None, "topology": None, "engine": None},
    "Source": {"value": 0.0, "time": None},
    "Specimen": {"where": DISC, "concentration": 1.0},
    "Sponge": {"nodes": 40, "strength": None},
    "Step": {"rise": 1.0},
    "Stencil": {"offsets": [[1], [-1]], "weights": [1.0, 1.0], "reaction": 0.0},
    "Temperature": {"where": DISC, "value": 0.0, "kind": "volume", "within": None},
    "Text": {"text": "a", "height": 1.0, "centre": (0.0, 0.0), "font": "DejaVu Sans", "bold": False},
    "ToneBurst": {"frequency": 1.0, "cycles": 3.0},
    "ThermalLoad": {
        "temperature": 20.0,
        "expansion": 1e-5,
        "reference": 20.0,
        "every": None,
        "coupled": False,
        "joint": ["x-"],
        "contact_conductance": 0.0,
    },
    "Thermoelastic": {
        "elastic": fh.Elastic(KERNEL, 1.0),
        "heat": fh.Heat(KERNEL),
        "expansion": 1e-5,
        "reference": 300.0,
        "coupled": True,
        "contact_conductance": 0.0,
    },
    "Pressure": {"on": [(0.0, 0.0), (1.0, 0.0)], "value": 1.0, "time": None},
    "Traction": {"side": "y+", "value": (1.0, 0.0), "between": None, "time": None},
    "ViscoelasticBond": {"relaxing": 0.4, "time": 1.0},
    "Voxels": {"voxels": np.ones((2, 2), int), "size": 1.0, "lower": (0.0, 0.0), "labels": None},
    "Wave": {
        "operator": KERNEL,
        "speed": 1.0,
        "damping": 0.0,
        "density": 1.0,
        "integrator": "verlet",
        "attenuation": None,
    },
    "Weibull": {"scale": 1.0, "modulus": 5.0, "cell": 1.0, "seed": 0},
    "WholeSteps": {"every": 0.25, "until": 1.0},
    "LoadSteps": {"interval": 1.0, "tolerance": 1e-6, "limit": 1000},
    "LeastSquares": {"receivers": fh.Receivers([0.0]), "data": np.zeros((3, 1)), "weights": 1.0},
    "Envelope": {"receivers": fh.Receivers([0.0]), "data": np.zeros((3, 1)), "weights": 1.0},
    "TravelTime": {"receivers": fh.Receivers([0.0]), "data": np.zeros((3, 1)), "weights": 1.0},
    "OwnMisfit": {"receivers": fh.Receivers([0.0]), "function": lambda records, times: (0.0, {})},
    "gradient": {
        "setup": STILL,
        "misfit": fh.LeastSquares(fh.Receivers([0.0]), np.zeros((3, 1))),
        "wrt": "speed",
        "until": 0.2,
        "region": None,
        "memory": None,
        "precision": "float64",
        "illumination": False,
    },
    "image": {
        "shots": [(STILL, fh.LeastSquares(fh.Receivers([0.0]), np.zeros((3, 1))))],
        "until": 0.2,
        "show": "reflectors",
        "region": None,
        "memory": None,
        "precision": "float64",
    },
    "invert": {
        "shots": [(STILL, fh.LeastSquares(fh.Receivers([0.0]), np.zeros((3, 1))))],
        "wrt": "speed",
        "until": 0.2,
        "bounds": {"speed": (0.5, 1.5)},
        "region": None,
        "iterations": 0,
        "tolerance": 1e-6,
        "smooth": 0.0,
        "tikhonov": 0.0,
        "variation": 0.0,
        "frequencies": (None,),
        "illumination": True,
        "output": None,
        "callback": None,
        "jobs": 1,
        "memory": None,
        "precision": "float64",
        "progress": None,
    },
    "open_results": {"path": "no such file", "verify": True},
    "read_case": {"path": "no such file", "changes": ()},
    "speed_of_current": {"density": 10.0, "metal": 143000.0, "electrons": 2.0},
    "calibrated_stretch": {
        "model": fh.Elastic(KERNEL, 1.0),
        "spacing": 1.0,
        "fracture_energy": 1.0,
        "dim": 2,
        "calibrate": "running",
    },
    "convergence": {"case": float, "spacings": [0.4, 0.2, 0.1], "quantity": float, "exact": 0.0},
    "surface_factor": {"lattice": PLANE, "model": fh.Elastic(KERNEL, 1.0), "boundary": None},
    "sweep": {
        "case": TINY,
        "changes": {"model.speed": [1.0]},
        "quantities": {"a": lambda run: run.time},
        "table": None,
        "jobs": 1,
        "executor": None,
        "progress": False,
    },
    "function": {"given": twice},
    "Medium": {
        "order": 2,
        "coefficient": 1.0,
        "dt": 0.01,
        "damping": 0.0,
        "offsets": [[1.0], [-1.0]],
        "weights": [1.0, 1.0],
        "horizon": 1.0,
        "series": (-0.1,),
    },
    "update_matrix": {
        "points": np.linspace(-1, 1, 41)[:, None],
        "absorbing": [0, 40],
        "normals": [[-1.0], [1.0]],
        "medium": fh.Medium(2, 1.0, 0.01),
        "condition": None,
        "spacing": 0.05,
        "extent": 1.0,
        "enclosing": True,
    },
    "tuned": {"sim": None, "angle": 60.0, "band": None, "budget": 1.0},
}
# results, which are not made by hand, names of materials, and base classes
NOT_MADE = {"Certificate", "Gradient", "Inversion", "materials", "LatticeModel"} | {
    *("BondLaw", "Load", "Misfit", "DataMisfit", "Shape", "Side", "Signal")
}


def _or_input_error(call):
    """Return the result of a call, or the InputError that it raises; anything else fails the test."""
    try:
        return call()
    except fh.InputError as error:
        assert len(str(error)) < 1000
        return error


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Run in an empty folder, because a text in place of a path becomes a file."""
    monkeypatch.chdir(tmp_path)


def test_every_public_callable_is_here():
    public = {n for n in fh.__all__ if not (isinstance(getattr(fh, n), type) and issubclass(getattr(fh, n), Exception))}
    assert public == set(RIGHT) | NOT_MADE
    for name, arguments in RIGHT.items():
        parameters = inspect.signature(getattr(fh, name)).parameters
        assert arguments.keys() == parameters.keys() or parameters.keys() == {"intervals"}, name


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", sorted(RIGHT))
def test_odd_arguments_are_refused_or_taken(name):
    for key in RIGHT[name]:
        for value in ODD:
            _or_input_error(lambda key=key, value=value: getattr(fh, name)(**{**RIGHT[name], key: value}))


# Calls that pass odd values which only a set-up can judge: those of sources, of conditions, and of fields that are
# evaluated on the lattice.
BOTH = fh.Thermoelastic(**RIGHT["Thermoelastic"])
PLACES = {
    "initial": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), initial={"u": v}, threads=1),
    "initial of a vector": lambda v: fh.Simulation(PLANE, fh.Elastic(KERNEL, 1.0), initial={"u": [v, 0.0]}, threads=1),
    "source": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), sources=[v], threads=1).step(2),
    "place of a point source": lambda v: fh.Simulation(
        LINE, fh.Wave(KERNEL), sources=[fh.PointSource(v)], threads=1
    ).step(2),
    "direction of a point force": lambda v: fh.Simulation(
        fh.Lattice(0.5, (-5.0, -5.0), (5.0, 5.0)),
        fh.Elastic(KERNEL, 1.0),
        sources=[fh.PointForce((0.1, 0.1), v)],
        threads=1,
    ),
    "source in time": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), sources=[fh.Source(0.0, v)], threads=1).step(2),
    "crack": lambda v: fh.Simulation(PLANE, fh.Wave(KERNEL), cracks=[v], threads=1),
    "load": lambda v: fh.Simulation(PLANE, fh.Elastic(KERNEL, 1.0), loads=[v], threads=1),
    "body force": lambda v: fh.Simulation(
        PLANE, fh.Elastic(KERNEL, 1.0), fh.Fixed(), loads=[fh.BodyForce([v, 0.0])], threads=1
    ),
    "start of a temperature": lambda v: fh.Simulation(PLANE, BOTH, fh.Free(), {"T": v}, threads=1).step(1),
    "sides by field": lambda v: fh.Simulation(PLANE, BOTH, {"u": fh.Free(), "T": v}, threads=1),
    "sources by field": lambda v: fh.Simulation(PLANE, BOTH, fh.Free(), sources={"T": v}, threads=1).step(1),
    "start of a solid": lambda v: fh.Simulation(
        PLANE, fh.Correspondence(KERNEL, 1.0, 0.3), fh.Fixed(), {"u": [v, 0.0]}, threads=1
    ),
    "constraint": lambda v: fh.Simulation(LINE, fh.Diffusion(KERNEL), fh.Free(), constraints=[v], threads=1),
    "temperature": lambda v: fh.Simulation(
        LINE, fh.Heat(KERNEL), fh.Free(), constraints=[fh.Temperature("x-", v)], threads=1
    ).step(2),
    "temperature inside": lambda v: fh.Simulation(
        LINE, fh.Heat(KERNEL), fh.Free(), constraints=[fh.Temperature(fh.Box(-1, 1), v)], threads=1
    ),
    "prescribed": lambda v: fh.Simulation(
        LINE, fh.Wave(KERNEL), fh.Free(), constraints=[fh.Prescribed([0.0], v)], threads=1
    ).step(2),
    "prescribed velocity of a solid": lambda v: fh.Simulation(
        PLANE,
        fh.Elastic(KERNEL, 1.0),
        fh.Free(),
        constraints=[fh.Prescribed([[0.0, 0.0]], velocity=[v, None])],
        threads=1,
    ).step(2),
    "strength of a solid": lambda v: fh.Simulation(
        PLANE, fh.Elastic(KERNEL, 1.0, critical_stretch=v), fh.Free(), threads=1
    ),
    "where prescribed": lambda v: fh.Simulation(
        LINE, fh.Wave(KERNEL), fh.Free(), constraints=[fh.Prescribed(v, 0.0)], threads=1
    ),
    "specimen": lambda v: fh.Simulation(
        LINE, fh.Corrosion(KERNEL, saturation=0.5), fh.Free(), specimens=[v], threads=1
    ),
    "side": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), {"x": v}, threads=1),
    "signal": lambda v: fh.Simulation(
        PLANE, fh.Wave(fh.Stencil.finite_difference(2)), sources=[fh.IncidentWave((1, 0), v, 1.0)], threads=1
    ),
    "incident field": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), sources=[fh.IncidentField(v)], threads=1).step(1),
    "receivers": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), observe=[v], threads=1),
    "points of receivers": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), observe=[fh.Receivers(v)], threads=1),
    "spectra": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), observe=[fh.Spectra(v, 0.1)], threads=1),
    "frequencies": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), observe=[fh.Spectra(0.0, v)], threads=1),
    "surface": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), observe=[fh.PowerThrough([("x", v)])], threads=1),
    "step": lambda v: fh.Simulation(LINE, fh.Wave(KERNEL), dt=v, threads=1),
    "point": LINE.index,
    "points in a shape": DISC.contains,
    "coordinates of an expression": lambda v: fh.Expression("x")(v),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("place", PLACES)
def test_odd_values_in_a_set_up(place):
    for value in ODD:
        _or_input_error(lambda value=value: PLACES[place](value))


@pytest.mark.filterwarnings("error")
def test_odd_arguments_of_methods():
    sim = fh.Simulation(LINE, fh.Wave(KERNEL), initial={"u": "exp(-x**2)"}, boundary=fh.Fixed(), threads=1)
    calls = {
        "run": sim.run,
        "every": lambda v: sim.run(1.0, every=v),
        "record": sim.record,
        "step": sim.step,
        "power_across": lambda v: sim.power_across("x", v),
        "power_across an axis": lambda v: sim.power_across(v, 0.0),
        "certificate": sim.certificate,
        "check": lambda v: sim.check(budget=v),
        "save": sim.save,
        "write": sim.write,
        "output": lambda v: sim.run(1.0, output=v),
        "animate": lambda v: sim.animate(v, until=9.0, every=1.0),
        "animate until": lambda v: sim.animate(until=v, every=1.0),
        "load": sim.load,
        "restore": fh.Simulation.restore,
    }
    for call in calls.values():
        for value in (v for v in ODD if not isinstance(v, str)):  # a text is a path
            _or_input_error(lambda call=call, value=value: call(value))


def test_values_far_beyond_everything():
    """Values that once overflowed in the arithmetic are refused."""
    with pytest.raises(fh.InputError, match="outside the near field"):
        LINE.index([-1e308])
    with pytest.raises(fh.InputError, match="more steps than can be counted"):
        fh.Simulation(LINE, fh.Wave(KERNEL), fh.Exact(), {"u": "exp(-20*x**2)"}).run(1e59)
    with pytest.raises(fh.InputError, match=r"lattice\.spacing: the lattice does not fit into memory"):
        fh.Lattice(1e-15, (-1.0, -1.0), (1.0, 1.0))
    with pytest.raises(fh.InputError, match=r"boundary\.nodes: is out of range"):
        fh.LatticePML(nodes=10**20)


def test_dollars_are_letters():
    """Dollar signs are drawn as such and do not delimit mathematics, which would draw something else or fail."""
    assert (
        np.ptp(fh.Text("$5 and $6", 1.0).bounds(), axis=0)[0]
        > np.ptp(fh.Text("5 and 6", 1.0).bounds(), axis=0)[0] + 1.0
    )


class TestConverters:
    @pytest.mark.parametrize("value", [3, 3.0, np.float32(3), np.int8(3), np.array(3.0)])
    def test_number(self, value):
        found = kinds.number(value, "a.key", above=0)
        assert found == 3.0 and type(found) is float

    @pytest.mark.parametrize(
        ("value", "message"),
        [
            ("3", "a.key: must be a number; value: the text '3'; limit: > 0"),
            (np.ones((2, 2)), r"must be a number; value: an array of shape \(2, 2\)"),
            (True, "must be a number; value: True"),
            (1j, "must be a number; value: 1j"),
            (-0.0003999999999999983, "must be finite and positive; value: -0.0004; limit: > 0"),
            (np.float64("nan"), "must be finite and positive; value: nan"),
            (
                1e200,
                "is beyond what can be computed with; value: 1e[+]200; limit: 1e-60 to 1e[+]60 in magnitude; remedy: "
                "other units",
            ),
        ],
    )
    def test_not_that_number(self, value, message):
        with pytest.raises(fh.InputError, match=message):
            kinds.number(value, "a.key", above=0)

    @pytest.mark.parametrize("value", [4, np.uint8(4), np.int64(4)])
    def test_integer(self, value):
        found = kinds.integer(value, "a.key", least=1)
        assert found == 4 and type(found) is int
        assert fh.Sponge(nodes=value).nodes == fh.LatticePML(nodes=value).nodes == 4

    @pytest.mark.parametrize("value", [4.0, "4", None, True, 0, 10**20])
    def test_not_that_integer(self, value):
        with pytest.raises(fh.InputError, match=r"a\.key: .*limit: 1 to 1000000"):
            kinds.integer(value, "a.key", least=1)

    def test_a_float_is_seen_as_one(self):
        for value in (8.0, np.float32(8)):
            with pytest.raises(fh.InputError, match=r"must be a whole number; value: 8\.0; limit.*; remedy: write 8$"):
                kinds.integer(value, "a.key", least=1)
        for value in (8.5, 0.0, np.nan):
            with pytest.raises(fh.InputError, match="remedy: a whole number within these limits"):
                kinds.integer(value, "a.key", least=1)

    def test_words(self):
        with pytest.raises(
            fh.InputError, match=r"kernel\.influence: unknown influence.*text 'guassian'.*did you mean 'gaussian'"
        ):
            fh.Kernel(1.0, influence="guassian")

    def test_function(self):
        with pytest.raises(
            fh.InputError, match=r"initial.u: the function is called with x, y; .*; remedy: a function of 2 arguments"
        ):
            fh.Simulation(PLANE, fh.Wave(KERNEL), initial={"u": lambda x: x})


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.float64(-0.012), "-0.012"),
        ([np.float64(-0.012), np.float64(0.0)], "[-0.012, 0]"),
        (0.1 + 0.2, "0.3"),
        (-0.0003999999999999983, "-0.0004"),
        (np.int64(5), "5"),
        ((3, 4), "(3, 4)"),
        ((3,), "(3,)"),
        (np.zeros((40, 3)), "an array of shape (40, 3)"),
        (object(), "an object of type object"),
        (fh.Kernel, "Kernel"),
        (np.bool_(True), "True"),
        (10**5000, "a whole number of 16610 bits"),
    ],
    ids=lambda value: "",
)
def test_values_as_a_person_writes_them(value, words):
    assert shown(value) == words
    assert f"value: {words}" in str(fh.InputError("wrong", value=value))
    assert f"limit: {words}" in str(fh.InputError("wrong", limit=value))


def test_long_values_are_cut():
    error = fh.InputError("wrong", value="x" * 20_000, limit="a, b")
    assert len(str(error)) < 150 and str(error).endswith(" ...; limit: a, b") and error.value == "x" * 20_000
