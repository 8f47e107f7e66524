"""Passes odd arguments to every public callable: the answer is a value or an InputError that names the argument.

python tests/robustness/arguments.py --seed 7
"""

from __future__ import annotations

import argparse
import contextlib
import inspect
import sys
import tempfile
import warnings
from pathlib import Path

import machinery
import numpy as np

BAD = ("traceback", "crash", "hang")
LIMIT = 120.0


def odd_values():
    """Return values that no argument should have, by name."""
    return {
        "none": None,
        "text": "text",
        "empty": "",
        "true": True,
        "zero": 0,
        "negative": -1,
        "float": 2.5,
        "nan": float("nan"),
        "inf": float("inf"),
        "huge": 1e300,
        "tiny": 1e-300,
        "complex": 1 + 2j,
        "list": [],
        "nested": [[1.0], [2.0, 3.0]],
        "dict": {},
        "array": np.zeros((2, 2)),
        "nans": np.full(3, np.nan),
        "objects": np.array([None, "a"], dtype=object),
        "complex array": np.ones(3) * 1j,
        "uint8": np.uint8(4),
        "int8": np.int8(4),
        "float32": np.float32(1.5),
        "function": lambda *a: 1 / 0,
        "class": dict,
        "bytes": b"ab",
        "set": {1, 2},
        "big": 10**30,
    }


def good():
    """Return valid arguments of each public callable."""
    import farhorizon as fh

    lattice, kernel = fh.Lattice(0.5, (-3.0, -3.0), (3.0, 3.0)), fh.Kernel(1.0)
    wave = fh.Wave(kernel)
    record = {"points": [[0.0, 0.0], [1.0, 0.0]], "times": [0.0, 1.0], "u": [[0.0, 0.0], [0.0, 1.0]], "medium": 1.0}
    disc, square = fh.Disc(1.0), [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    return {
        "Attenuation": {"quality": 50.0, "band": (0.01, 0.1)},
        "Auto": {},
        "Ball": {"radius": 1.0},
        "Beam": {"stiffness": 1.0},
        "BilinearSoftening": {"onset": 0.01, "final": 0.04},
        "BodyForce": {"value": [1.0, 0.0]},
        "Box": {"lower": [0.0, 0.0], "upper": [1.0, 1.0]},
        "Chirp": {"first": 0.1, "last": 0.2, "duration": 9.0},
        "Convection": {"where": "x-", "transfer": 1.0, "ambient": 0.0},
        "Corrosion": {"operator": kernel, "diffusivity": 1.0, "saturation": 0.9},
        "Correspondence": {"kernel": kernel, "young": 1.0, "poisson": 0.25},
        "CrackTips": {},
        "Crack": {"cut": square[:2]},
        "Diffusion": {"operator": kernel, "diffusivity": 1.0},
        "Disc": {"radius": 1.0},
        "DiscCut": {"centre": [0.0] * 3, "normal": [0.0, 0.0, 1.0], "radius": 1.0},
        "Elastic": {"kernel": fh.Kernel(1.0, 1), "young": 1.0},
        "Exact": {},
        "ExponentialSoftening": {"onset": 0.01, "final": 0.04},
        "Expression": {"text": "x", "dim": 2},
        "Extended": {},
        "FarField": {"frequencies": [0.05], "points": [(9.0, 0.0)]},
        "FirstOrder": {},
        "Fixed": {},
        "Flux": {"where": "x-", "value": 1.0},
        "Free": {},
        "Gaussian": {"width": 3.0},
        "Heat": {"operator": kernel},
        "Higdon": {},
        "Impedance": {"stiffness": 1.0},
        "Insulated": {"where": "x-"},
        "ImageMask": {"image": np.ones((3, 3), bool), "width": 1.0},
        "RayleighWave": {"direction": [1.0, 0.0], "signal": fh.Expression("sin(t)", 0), "duration": 3.0},
        "IncidentRecord": {"record": record},
        "IncidentField": {"field": "cos(x)*cos(t)", "within": fh.Box((-2.0, -2.0), (2.0, 2.0))},
        "IncidentWave": {"direction": [1.0, 0.0], "signal": fh.Expression("sin(t)", 0), "duration": 3.0},
        "Kernel": {"horizon": 1.0},
        "Medium": {"order": 2, "coefficient": 1.0, "dt": 0.01},
        "function": {"given": _doubled},
        "update_matrix": {
            "points": np.linspace(-1, 1, 41)[:, None],
            "absorbing": np.array([0, 40]),
            "normals": np.array([[-1.0], [1.0]]),
            "medium": fh.Medium(order=2, coefficient=1.0, dt=0.01),
        },
        "Lattice": {"spacing": 0.5, "lower": (-1.0, -1.0), "upper": (1.0, 1.0)},
        "LossyRegion": {"region": disc, "quality": 20.0},
        "LatticePML": {},
        "LeastSquares": {"receivers": fh.Receivers([(0.0, 0.0)]), "data": np.zeros((3, 1))},
        "Envelope": {"receivers": fh.Receivers([(0.0, 0.0)]), "data": np.zeros((3, 1))},
        "TravelTime": {"receivers": fh.Receivers([(0.0, 0.0)]), "data": np.zeros((3, 1))},
        "OwnMisfit": {"receivers": fh.Receivers([(0.0, 0.0)]), "function": _nothing},
        "LineSource": {"points": [(-0.5, 0.0), (0.5, 0.0)], "strength": 1.0, "interpolation": "linear"},
        "Elements": {"elements": (np.vstack([np.zeros(3), np.eye(3)]), [(0, 1, 2, 3)])},
        "Mesh": {"triangles": (np.vstack([np.zeros(3), np.eye(3)]), [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)])},
        "MomentTensor": {"at": (0.1, 0.2), "moment": 1.0, "interpolation": "linear"},
        "NonlocalPML": {},
        "Periodic": {},
        "PhasedArray": {
            "first": (-1.0, 0.0),
            "last": (1.0, 0.0),
            "elements": 3,
            "strength": 1.0,
            "time": fh.Ricker(0.1),
            "interpolation": "linear",
        },
        "OfField": {"value": "u*(1 - u)"},
        "PlaneWave": {},
        "PointCut": {"x": 0.1},
        "PointForce": {"at": (0.1, 0.2), "force": (1.0, 0.0), "interpolation": "linear"},
        "PointSource": {"at": (0.1, 0.2), "interpolation": "linear"},
        "Polygon": {"points": square},
        "PolygonCut": {"points": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]},
        "Polyline": {"points": square},
        "ShellRecorder": {"box": fh.Box((-2.0, -2.0), (2.0, 2.0))},
        "ViscoelasticBond": {"relaxing": 0.4, "time": 1.0},
        "Voxels": {"voxels": np.ones((3, 3), int), "size": 1.0},
        "PowerThrough": {"surfaces": fh.Box((-1.0, -1.0), (1.0, 1.0)), "frequencies": [0.1]},
        "Prescribed": {"where": [[0.0, 0.0]], "value": 1.0},
        "Reaction": {},
        "Impactor": {"shape": fh.Disc(1.0, (0.0, 4.1)), "mass": 1.0, "velocity": (0.0, -0.1)},
        "Impacts": {},
        "Receivers": {"points": [(0.1, 0.2)], "interpolation": "linear"},
        "Rectangle": {"corner": [0.0] * 3, "edge1": [1.0, 0.0, 0.0], "edge2": [0.0, 1.0, 0.0]},
        "Ricker": {"frequency": 0.1},
        "RungeKuttaChebyshev": {"chebyshev": 5},
        "Samples": {"values": [0.0, 1.0, 1.0, 0.0], "dt": 0.5},
        "Setup": {"lattice": lattice, "model": wave, "boundary": fh.LatticePML(nodes=4)},
        "Simulation": {"lattice": lattice, "model": wave, "boundary": fh.LatticePML(nodes=4)},
        "Source": {"value": 1.0, "time": 1.0},
        "Spectra": {"where": [(0.1, 0.2)], "frequencies": [0.05], "interpolation": "linear"},
        "Specimen": {"where": disc, "concentration": 1.0},
        "Sponge": {},
        "Step": {"rise": 3.0},
        "StressIntensity": {"tips": [(0.5, 0.2)], "radii": (1.0, 1.5)},
        "Stencil": {"offsets": [[1, 0], [-1, 0], [0, 1], [0, -1]], "weights": [1.0] * 4},
        "Temperature": {"where": "x-", "value": 1.0},
        "Text": {"text": "a", "height": 1.0},
        "ToneBurst": {"frequency": 0.1, "cycles": 2},
        "Thermoelastic": {
            "elastic": fh.Elastic(fh.Kernel(1.0, 1), 1.0),
            "heat": fh.Heat(kernel),
            "expansion": 1e-5,
            "reference": 300.0,
        },
        "ThermalLoad": {"temperature": 20.0, "expansion": 1e-5, "reference": 20.0},
        "Pressure": {"on": [(-1.0, 0.1), (1.0, 0.1)], "value": 1.0},
        "Traction": {"side": "x-", "value": [1.0, 0.0]},
        "Wave": {"operator": kernel},
        "Weibull": {"scale": 1.0, "modulus": 5.0, "cell": 1.0},
        "LoadSteps": {"interval": 1.0},
        "WholeSteps": {"every": 1.0},
        "calibrated_stretch": {"model": fh.Elastic(kernel, 1.0), "spacing": 1.0, "fracture_energy": 1.0},
        "convergence": {"case": float, "spacings": [0.4, 0.2, 0.1], "quantity": float, "exact": 0.0},
        "open_results": {"path": "none.h5"},
        "read_case": {"path": machinery.HERE.parents[1] / "examples" / "blob.toml", "changes": {"run.until": 1.0}},
        "surface_factor": {"lattice": fh.Lattice(1.0, (-4.0, -4.0), (4.0, 4.0)), "model": fh.Elastic(kernel, 1.0)},
        "sweep": {"case": float, "changes": {"model.speed": [1.0]}, "table": "no such folder/table.csv"},
        "speed_of_current": {"density": 1.0, "metal": 143.0, "electrons": 2.0},
    }


def _doubled(u: float) -> float:
    return 2 * u


def _nothing(records, times):
    return 0.0, {}


#: Public names that are not called by users, or that compute for a long time.
NOT_CALLED = {
    "Certificate",
    "Gradient",
    "Inversion",
    "Misfit",
    "DataMisfit",
    *("gradient", "image", "invert"),  # tests/test_kinds.py gives them arguments of other types
    "FarhorizonError",
    "FileFormatError",
    "InputError",
    "UnstableError",
    "ValidityWarning",
    "materials",
    "LatticeModel",
    "Load",
    "Probes",
    "BondLaw",
    "Shape",
    "Side",
    "Signal",
    "tuned",
}


def jobs():
    """Return each argument of each public callable and of the methods of a run with each odd value."""
    import farhorizon as fh

    found = []
    for name in fh.__all__:
        if name not in NOT_CALLED:
            for parameter in inspect.signature(getattr(fh, name)).parameters.values():
                if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                    found += [{"name": name, "argument": parameter.name, "odd": odd} for odd in odd_values()]
    for method, arguments in METHODS.items():
        found += [
            {"name": "Simulation." + method, "argument": argument, "odd": odd}
            for argument in arguments
            for odd in odd_values()
        ]
    return [{"seed": 0, "number": number, **job} for number, job in enumerate(found)]


METHODS = {
    "run": ("until", "every", "tolerance", "limit"),
    "step": ("count",),
    "save": ("path",),
    "load": ("path",),
    "plot": ("name", "path", "limits"),
}


def call(job):
    """Make the call, and use its result in a simulation."""
    import farhorizon as fh

    odd = odd_values()[job["odd"]]
    name, _, method = job["name"].partition(".")
    if method:
        sim = fh.Simulation(**{**good()["Simulation"], "initial": {"u": 0.0}})
        arguments = {
            "run": {"until": 0.5},
            "step": {},
            "save": {"path": "a.ckpt"},
            "load": {"path": "none.ckpt"},
            "plot": {},
        }[method]
        return getattr(sim, method)(**{**arguments, job["argument"]: odd})
    made = getattr(fh, name)(**{**good()[name], job["argument"]: odd})
    setup = {**good()["Simulation"], "initial": {"u": 0.0}}
    if name in (
        "Auto",
        "Extended",
        "Sponge",
        "LatticePML",
        "Higdon",
        "PlaneWave",
        "FirstOrder",
        "Fixed",
        "Free",
        "Impedance",
        "Periodic",
    ):
        fh.Simulation(**{**setup, "boundary": made}).step(1)
    elif name in ("Wave", "Diffusion", "Heat"):
        fh.Simulation(**{**setup, "model": made}).step(1)
    elif name in ("BilinearSoftening", "ExponentialSoftening", "ViscoelasticBond"):
        solid = {"model": fh.Elastic(fh.Kernel(1.0, 1), 1.0, law=made), "initial": {}}
        fh.Simulation(**{**setup, **solid}).step(1)
    elif name in ("FarField", "PowerThrough", "Receivers", "Spectra"):
        fh.Simulation(**{**setup, "initial": {"u": "exp(-9*(x**2 + y**2))"}, "observe": [made]}).step(2)
    elif name == "Reaction":
        held = [fh.Prescribed([[0.0, 0.0]], 1.0)]
        fh.Simulation(**{**setup, "constraints": held, "observe": [made]}).step(2)
    elif name in ("Impactor", "Impacts"):
        solid = {"model": fh.Elastic(fh.Kernel(1.0, 1), 1.0), "initial": {}, "boundary": fh.Free()}
        ball = fh.Impactor(fh.Disc(1.0, (0.0, 9.0)), 1.0) if name == "Impacts" else made
        fh.Simulation(**{**setup, **solid, "loads": [ball], "observe": [made] * (name == "Impacts")}).step(2)
    elif name == "CrackTips":
        breaking = {"model": fh.Elastic(fh.Kernel(1.0, 1), 1.0, critical_stretch=0.1), "initial": {}}
        fh.Simulation(**{**setup, **breaking, "cracks": [[(-9.0, 0.2), (0.5, 0.2)]], "observe": [made]}).step(2)
    elif name == "StressIntensity":
        fh.Simulation(**{**setup, "cracks": [[(-9.0, 0.2), (0.5, 0.2)]], "observe": [made]}).step(2)
    elif name == "ShellRecorder":
        fh.Simulation(**{**setup, "observe": [made]}).step(2)
    elif name == "IncidentField":
        fh.Simulation(**{**setup, "sources": [made]}).step(1)
    elif name in ("LineSource", "PhasedArray", "PointSource"):
        fh.Simulation(**{**setup, "sources": [made]}).step(1)
    elif name in ("MomentTensor", "PointForce"):
        solid = {"model": fh.Elastic(fh.Kernel(1.0, 1), 1.0), "initial": {"u": [0.0, 0.0]}}
        fh.Simulation(**{**setup, **solid, "sources": [made]}).step(1)
    elif name in ("Chirp", "Gaussian", "Ricker", "Samples", "Step", "ToneBurst"):
        fh.Simulation(**{**setup, "sources": [fh.PointSource((0.1, 0.2), time=made, interpolation="linear")]}).step(1)
    elif name in ("OfField", "Source"):
        fh.Simulation(**{**setup, "boundary": fh.Fixed(), "sources": [made]}).step(1)
    elif name == "Simulation":
        made.step(1)
    return made


def answer(job):
    import farhorizon as fh

    with tempfile.TemporaryDirectory() as here, contextlib.chdir(here), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            call(job)
        except fh.InputError as error:
            return {"class": "refused", "where": str(error)[:200]}
        except fh.UnstableError:
            return {"class": "unstable"}
        except Exception as error:
            if job["odd"] in ("function", "class") and isinstance(error, ZeroDivisionError | TypeError):
                return {"class": "refused"}  # raised by the user's own callable
            return {
                "class": "traceback",
                "where": f"{job['name']}({job['argument']}={job['odd']}): {type(error).__name__}: {str(error)[:120]}",
            }
    return {"class": "taken"}


def campaign(count, seed, processes, folder, report=print):
    """Return the number of answers by class, for at most `count` calls drawn at random."""
    every = jobs()
    chosen = machinery.random_of(seed).permutation(len(every))[:count]
    drawn = ({**every[int(k)], "seed": seed} for k in chosen)
    return machinery.table(machinery.answers(Path(__file__), drawn, processes, LIMIT, folder), BAD, folder, report)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--calls", type=int, default=10**6)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        machinery.serve(answer)
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-arguments-"))
        counts = campaign(options.calls, machinery.seed_of(options.seed), options.processes, folder)
        print(folder)
        sys.exit(1 if set(BAD) & set(counts) else 0)
