"""Random case files: sound ones, of every model with other parts, and the same with an odd value in one place."""

from __future__ import annotations

import math
import tomllib

ODD_SHARE = 0.35  # part of the cases that are spoilt
RICH_SHARE = 0.3  # part of the cases with features that fit few others, so that many are refused
ODD = [
    "0",
    "-1",
    "-0.0",
    "1e300",
    "-1e300",
    "1e-300",
    "5e-324",
    "nan",
    "inf",
    "1e17",
    "'x'",
    "''",
    "[]",
    "{}",
    "true",
    "[[]]",
    "0.1",
    "3",
    "1" + "0" * 30,
    "'exp('",
    "'1/0'",
    "'x**x**x'",
    "'log(-1)'",
    "'t'",
    '"where(x > 0, 1, nan)"',
    "'" + "x" * 3000 + "'",
    "1" * 5000,
    "[" * 2000 + "]" * 2000,
]
ODD_TEXTS = [
    "linear",
    "free",
    "lattice-pml",
    "exact",
    "sponge",
    "extended",
    "auto",
    "periodic",
    "rk4",
    "rkc",
    "euler",
    "nonsense",
    "$\\\\frac$",
    "float32",
]


def toml(value) -> str:
    """Return a value as TOML, with inline dictionaries."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f"{toml(str(k)) if not k.isidentifier() else k} = {toml(v)}" for k, v in value.items())
            + " }"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    return repr(value) if isinstance(value, int | float) else str(value)


def text_of(case: dict) -> str:
    """Return a case file with one line per key."""
    return "\n".join(f"{key} = {toml(value)}" for key, value in case.items()) + "\n"


def crack_across(dim: int, at: float, reach: float) -> list[list[float]]:
    """Return the points of a crack across the x axis."""
    return {
        1: [[at]],
        2: [[at, -reach], [at, reach]],
        3: [[at, -reach, -reach], [at, reach, -reach], [at, reach, reach]],
    }[dim]


def with_record(text: str, file: str, dt: float) -> str:
    """Return the case of a second run with a crack in the box whose shell the first one has recorded."""
    first = tomllib.loads(text)
    spacing, dim = first["lattice"]["spacing"], len(first["lattice"]["lower"])
    second = {key: first[key] for key in ("lattice", "model", "boundary") if key in first}
    second["incident"] = [{"type": "incident-record", "record": file}]
    second["crack"] = [{"points": crack_across(dim, 0.3 * spacing, 0.9 * spacing)}]
    return text_of(second | {"run": first["run"] | {"dt": dt}})


class Draw:
    """A sound random case: plain numbers in random units, data that end well inside the near field."""

    def __init__(self, rng):
        self.rng = rng
        self.dim = int(rng.choice([1, 2, 3], p=[0.35, 0.5, 0.15]))
        self.length, self.time = (float(f"{10 ** rng.uniform(-4, 4):.3g}") for _ in range(2))
        self.spacing = 0.25 * self.length
        self.half = int(rng.integers(8, 17)) if self.dim == 1 else int(rng.integers(7, 11)) if self.dim == 2 else 6
        self.span = self.half * self.spacing
        self.names = "xyz"[: self.dim]
        self.solid = False  # whether the sides belong to a body that ends
        self.vector = False

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def one(self, *values):
        return values[int(self.rng.integers(len(values)))]

    def number(self, low: float, high: float) -> float:
        return float(f"{self.rng.uniform(low, high):.3g}")

    # --- parts -------------------------------------------------------------------------------------------------

    def bump(self, share: float = 0.55, height: float = 1.0) -> str:
        """Return a smooth function that is zero beyond a fraction of the near field."""
        squares = "+".join(f"{name}**2" for name in self.names)
        return f"{height!r}*max(0, 1-({squares})/{(share * self.span) ** 2!r})**3"

    def kernel(self) -> dict:
        reach = int(self.rng.integers(2, 4)) if self.dim == 1 else 2  # few shapes, since each is compiled once
        kernel = {
            "horizon": reach * self.spacing,
            "exponent": int(self.rng.integers(0, 3)),
            "influence": self.one("constant", "constant", "linear", "gaussian"),
        }
        if kernel["influence"] == "gaussian" and self.chance(0.5):
            kernel["width"] = self.number(0.3, 1.0) * kernel["horizon"]
        if self.chance(0.3):
            kernel["volume"] = self.one("ramp", "full")
        if self.chance(0.2):
            kernel["calibrate"] = self.chance(0.5)
        return kernel

    def operator(self) -> dict:
        return (
            {"stencil": self.one("finite-difference", "finite-element")}
            if self.chance(0.15)
            else {"kernel": self.kernel()}
        )

    def sides(self, open_ones: list[dict], closed: list[dict]) -> dict:
        """Return conditions on all sides, some with exceptions or with a periodic axis."""
        found = {"all": self.one(*open_ones)}
        for name in self.names:
            if self.chance(0.25):
                found[name] = self.one({"type": "periodic"}, *closed, *open_ones)
            elif self.chance(0.2):
                found[name + self.one("-", "+")] = self.one(*closed)
        return found

    def lattice(self) -> dict:
        return {"spacing": self.spacing, "lower": [-self.span] * self.dim, "upper": [self.span] * self.dim}

    def window(self) -> dict:
        return {
            "spacing": self.spacing,
            "window": {"disc" if self.dim == 2 else "ball": {"radius": (self.half + 0.3) * self.spacing}},
        }

    # --- models ------------------------------------------------------------------------------------------------

    @property
    def speed(self) -> float:
        return self.length / self.time

    def pml(self) -> dict:
        """Return a layer, sometimes an extended domain in its place, or the cheaper of the two."""
        if self.chance(0.15):
            return {"type": self.one("extended", "auto"), "target": self.one(1e-3, 1e-4, 1e-6)}
        found: dict = {"type": "lattice-pml"}
        if self.chance(0.6):
            found["nodes"] = int(self.rng.integers(6, 13))
        elif self.chance(0.5):
            found["target"] = self.one(1e-3, 1e-4, 1e-6)
        return found

    def attenuation(self) -> dict:
        """Return a quality factor, sometimes of a power law, and another one in a part of the medium."""
        highest = self.number(0.05, 0.4) / self.time
        lossy: dict = {"quality": self.number(5, 200), "band": [highest / self.one(5, 10, 50), highest]}
        if self.chance(0.3):
            lossy["exponent"] = self.number(-0.3, 0.3)
        if self.chance(0.3):
            region = {"box": {"lower": [0.0] * self.dim, "upper": [2 * self.span] * self.dim}}
            lossy["regions"] = [{"region": region, "quality": self.number(5, 200)}]
        return lossy

    def wave(self) -> dict:
        model = {"type": "wave", "speed": self.speed, **self.operator()}
        if self.chance(0.3):
            model["damping"] = self.number(0, 0.2) / self.time
        sponge = {"type": "sponge", "nodes": int(self.rng.integers(4, 12))}
        open_ones = [self.pml(), self.pml(), sponge] + [{"type": "exact", "compress": self.one(False, 1e-8, 1e-12)}] * (
            self.dim == 1
        )
        case = {
            "lattice": self.lattice(),
            "model": model,
            "boundary": self.sides(open_ones, [{"type": "fixed"}, {"type": "free"}]),
        }
        if self.dim == 2 and self.chance(0.25):
            case["lattice"], case["boundary"] = (
                self.window(),
                {"all": self.one(self.pml(), {"type": "plane-wave"}, {"type": "higdon"}, {"type": "first-order"})},
            )
        elif self.dim > 1 and self.chance(0.15):
            case["lattice"]["body"] = {"ball" if self.dim == 3 else "disc": {"radius": 0.9 * self.span}}
            case["boundary"] = {"all": {"type": "free"}}
            if self.chance(0.5):
                case["rim"] = self.one("free", "fixed")
        case["initial"] = {"u": self.bump()} | ({"v": self.bump(0.5, 1 / self.time)} if self.chance(0.3) else {})
        return case

    def diffusion(self) -> dict:
        model = {
            "type": "diffusion",
            "diffusivity": self.length * self.speed,
            "integrator": self.one("euler", "rk4", "rkc"),
            **self.operator(),
        }
        open_ones = [self.pml()] + [{"type": "exact"}] * (self.dim == 1 and model["integrator"] == "euler")
        case = {
            "lattice": self.lattice(),
            "model": model,
            "boundary": self.sides(open_ones, [{"type": "fixed"}, {"type": "free"}]),
        }
        if self.chance(0.2):
            case["background"] = self.number(-2, 2)
            case["boundary"] = {"all": self.pml()}
        case["initial"] = {"u": f"{case.get('background', 0.0)!r}+{self.bump()}"}
        return case

    def heat(self) -> dict:
        model = {
            "type": "heat",
            "density": 2.0,
            "specific_heat": 3.0,
            "conductivity": 6.0 * self.length * self.speed,
            "integrator": self.one("euler", "rk4", "rkc"),
            "kernel": self.kernel(),
        }
        if model["integrator"] == "rkc" and self.chance(0.5):
            model["stages"] = int(self.rng.integers(2, 12))
        side = self.one("x-", "x+")
        constraint = self.one(
            {"type": "temperature", "side": side, "value": self.one(1.0, f"1+0.1*t/{self.time!r}")},
            {"type": "insulated", "side": side},
            {"type": "flux", "side": side, "value": self.number(-1, 1)},
            {"type": "convection", "side": side, "value": 1.0, "transfer": self.speed},
        )
        boundary = {"all": self.pml(), side: {"type": "free"}} | {name: {"type": "periodic"} for name in self.names[1:]}
        return {
            "lattice": self.lattice(),
            "model": model,
            "boundary": boundary,
            "constraint": [constraint],
            "initial": {"u": self.bump()},
        }

    def corrosion(self) -> dict:
        model = {
            "type": "corrosion",
            "diffusivity": self.length * self.speed,
            "saturation": self.number(0.6, 0.95),
            "interface": self.number(0.1, 1.0),
            "kernel": self.kernel(),
        }
        radius = self.number(0.3, 0.5) * self.span
        region = (
            {"disc": {"radius": radius}}
            if self.dim == 2
            else {"ball": {"radius": radius}}
            if self.dim == 3
            else {"box": {"lower": [-radius], "upper": [radius]}}
        )
        case = {"lattice": self.lattice(), "model": model, "specimen": [{"region": region}]}
        if self.chance(0.5):
            case["boundary"] = {"all": self.pml()}
        return case

    def beam(self) -> dict:
        self.dim, self.names = 1, "x"
        return {
            "lattice": self.lattice(),
            "model": {"type": "beam", "stiffness": self.length**2 * self.speed**2},
            "initial": {"u": self.bump(0.4)},
            "boundary": {
                "all": self.one(
                    {"type": "exact"}, {"type": "periodic"}, {"type": "fixed"}, {"type": "sponge", "nodes": 8}
                )
            },
        }

    def elastic(self) -> dict:
        self.dim, self.names, self.vector = max(2, self.dim), "xyz"[: max(2, self.dim)], True
        material = self.one("bond-based", "bond-based", "state-based", "correspondence", "finite-element")
        twice = material in ("state-based", "correspondence")  # whose forces reach twice as far
        self.half = 5 if self.dim == 3 else 14 if twice else min(self.half, 9)
        self.span = self.half * self.spacing
        model = {"type": "elastic", "young": 2.5 * self.speed**2, "material": material, "density": 1.0}
        if material == "bond-based":
            kernel = self.kernel()
            kernel["exponent"] = int(self.rng.integers(0, 3))
            if self.chance(0.4):
                model |= {"nonlinear": True}
        else:
            model["poisson"] = self.number(0.1, 0.3)
            kernel = {"horizon": 2 * self.spacing, "exponent": 1}
        if material != "finite-element":
            model["kernel"] = kernel
            if self.chance(0.3):
                model["critical_stretch"] = self.one(0.3, 0.06)
                model["contact"] = self.chance(0.5)
                if self.chance(0.3):
                    varies = {"type": "weibull", "scale": 1.0, "modulus": 8.0, "cell": 3 * self.spacing, "seed": 1}
                    model["critical_stretch"] = self.one("1 + cos(x)**2", varies)
        if material == "correspondence":
            model["stabilisation"] = self.number(0.1, 0.9)
        support = {"type": "impedance", "stiffness": self.number(0, 2), "viscosity": self.number(0, 2)}
        closed = [{"type": "fixed"}] + [{"type": "free"}, support] * (material != "finite-element")
        case = {
            "lattice": self.lattice(),
            "model": model,
            "boundary": self.sides([self.pml(), {"type": "sponge", "nodes": 8}], closed),
        }
        still = ["0"] * (self.dim - 1)
        case["initial"] = {"u": [self.bump(0.5, 0.02 * self.length), *still]}
        if model.get("critical_stretch") == 0.06:  # the displacements are below it, and soon above
            case["initial"]["v"] = [self.bump(0.5, 0.2 * self.speed), *still]
        if self.chance(0.2):
            case["load"] = [
                {
                    "type": "body-force",
                    "value": [self.bump(0.4, 0.01 * self.speed / self.time)] + [0.0] * (self.dim - 1),
                    "time": f"sin(t/{self.time!r})",
                }
            ]
        return case

    def from_outside(self) -> dict:
        """Return a case of a wave that enters a box, often with a scatterer in it, sometimes below a free surface."""
        materials = {1: ["wave"], 2: ["wave", "bond-based", "state-based"], 3: ["wave", "bond-based"]}[self.dim]
        material = self.one(*materials)
        elastic, reach = material != "wave", 4 if material == "state-based" else 2
        length = 3 if self.dim == 2 else 1  # half length of a crack
        self.vector, self.half = elastic, {1: 14, 2: 6 * reach + 2, 3: 8}[self.dim]
        self.span = self.half * self.spacing
        model = {"type": "wave", "speed": self.speed}
        if elastic:
            model = {"type": "elastic", "young": self.speed**2, "material": material}
        if material == "state-based":
            model["poisson"] = 0.2
        model["kernel"] = {"horizon": 2 * self.spacing, "exponent": 1}
        case = {"lattice": self.lattice(), "model": model, "boundary": {"all": {"type": "lattice-pml", "nodes": 6}}}
        surface = material == "bond-based" and self.chance(0.4)
        if surface:
            case["boundary"]["y+"] = {"type": "free"}
        case["incident"] = [self.incident(elastic, surface)]
        inner = (2 * reach + length) * self.spacing  # two reaches inside its faces there is room for a crack
        if self.chance(0.5):
            within = {"lower": [-inner] * self.dim, "upper": [inner] * self.dim}
            if surface:
                within["upper"][1] = self.span
            case["incident"][0]["within"] = within
        if self.chance(0.6) and (self.dim < 3 or "within" in case["incident"][0]):
            case["crack"] = [{"points": crack_across(self.dim, 0.3 * self.spacing, 0.9 * length * self.spacing)}]
        return case

    def incident(self, elastic: bool, surface: bool) -> dict:
        """Return an incident wave that travels towards +x, towards a free surface or along it."""
        ahead = self.number(-1, 1)
        direction = [1.0, *([abs(ahead) + 0.2 if surface else ahead] * (self.dim - 1))]
        low = self.number(0.05, 0.15)
        plane = {
            "direction": direction,
            "signal": f"sin({2 * math.pi * low / self.time!r}*t)*sin({math.pi * low / self.time!r}*t)**2",
            "duration": self.time / low,
        }
        if elastic and self.dim == 2:
            plane["polarisation"] = self.one("P", "S")
        field = f"cos({0.3 / self.length!r}*x - {0.3 / self.time!r}*t)"
        given = {"type": "incident-field", "field": [field] + ["0"] * (self.dim - 1) if elastic else field}
        along = {"type": "rayleigh-wave"} | {key: plane[key] for key in ("signal", "duration")}
        along["direction"] = [1.0] + [0.0] * (self.dim - 1)
        return self.one(plane, plane, given, *[along] * (elastic and surface))

    def passing(self) -> dict:
        """Return a case of waves from a source beside a box, at whose surface a shell records them for another run."""
        elastic = self.dim > 1 and self.chance(0.5)
        self.vector, self.half = elastic, {1: 14, 2: 12, 3: 8}[self.dim]
        self.span = self.half * self.spacing
        model = {"type": "elastic", "young": self.speed**2} if elastic else {"type": "wave", "speed": self.speed}
        model["kernel"] = {"horizon": 2 * self.spacing, "exponent": 1}
        case = {"lattice": self.lattice(), "model": model, "boundary": {"all": {"type": "lattice-pml", "nodes": 6}}}
        inner, off = 5 * self.spacing, 8 * self.spacing
        lower, upper = [-inner] * self.dim, [inner] * self.dim
        if self.dim == 2 and self.chance(0.3):
            case["boundary"]["y+"] = {"type": "free"}
            upper[1] = self.span
        case["lattice"]["lower"][0] -= off
        place = f"((x+{self.span + off / 4!r})**2" + "".join(f"+{name}**2" for name in self.names[1:]) + ")"
        beside = f"max(0, 1-{place}/{(5 * self.spacing) ** 2!r})**3*sin(t/{self.time!r})"
        case["source"] = [{"value": [beside] + ["0"] * (self.dim - 1) if elastic else beside}]
        case["shell"] = [{"box": {"lower": lower, "upper": upper}}]
        return case

    def correspondence(self) -> dict:
        self.dim, self.names, self.vector = max(2, self.dim), "xyz"[: max(2, self.dim)], True
        self.half = 6 if self.dim == 2 else 5
        self.span = self.half * self.spacing
        model = {
            "type": "correspondence",
            "young": self.one(2.5 * self.speed**2, f"{2.5 * self.speed**2!r}*where(x > 0, 1, 2)"),
            "poisson": 0.25,
            "kernel": {"horizon": 2 * self.spacing, "exponent": 0, "influence": "gaussian"},
        }
        if self.chance(0.4):
            model["critical_stretch"] = 0.2
        if self.chance(0.3):
            model["stabilisation"] = 0.5
        if self.chance(0.3):
            model["drag"] = 0.05 / self.time
        boundary = {
            "all": self.one(
                {"type": "fixed"},
                {"type": "free"},
                {"type": "sponge", "nodes": 5},
                {"type": "nonlocal-pml", "nodes": 6},
            )
        }
        return {
            "lattice": self.lattice(),
            "model": model,
            "boundary": boundary,
            "initial": {"u": [self.bump(0.5, 0.02 * self.length)] + ["0"] * (self.dim - 1)},
        }

    def signal(self) -> dict:
        """Return a table with a signal that is resolved."""
        low, long = self.number(0.05, 0.2) / self.time, self.number(2, 8) * self.time
        return self.one(
            {"type": "ricker", "frequency": low},
            {"type": "tone-burst", "frequency": low, "cycles": self.number(1, 4)},
            {"type": "gaussian", "width": long},
            {"type": "step", "rise": long},
            {"type": "chirp", "first": low, "last": 1.5 * low, "duration": 4 / low},
            {"type": "samples", "values": [0.0, 0.1, self.number(0.5, 1.0), 0.3, 0.0, 0.0], "dt": long},
        )

    def local_source(self, vector: bool) -> dict:
        """Return a source between nodes, most of which have enough nodes around them for the sinc."""
        near = 0.4 * self.span
        at, end = ([self.number(-near, near) for _ in range(self.dim)] for _ in range(2))
        strength = [self.number(-1, 1) for _ in range(self.dim)] if vector else self.number(0.5, 1.0)
        rest = {"time": self.signal(), "interpolation": self.one("linear", "linear", "sinc")}
        line = {"type": "line-source", "points": [at, end], "strength": strength}
        array = {"type": "phased-array", "first": at, "last": end, "elements": 3, "strength": strength}
        array |= {"speed": self.length / self.time, "angle": self.number(-40, 40)}
        if not vector:
            return self.one({"type": "point-source", "at": at, "strength": strength}, line, array) | rest
        moment = {"type": "moment-tensor", "at": at, "moment": self.number(0.5, 1.0) * self.length}
        if self.dim == 3 and self.chance(0.5):
            moment |= {"strike": self.number(0, 360), "dip": self.number(0, 90), "rake": self.number(-180, 180)}
        return self.one({"type": "point-force", "at": at, "force": strength}, line, array, moment) | rest

    # --- what may stand around ---------------------------------------------------------------------------------

    def around(self, case: dict) -> dict:
        kind = case["model"]["type"]
        if "incident" not in case and "shell" not in case:
            case = self.acted_on(case, kind)
        case |= self.recorders(kind) | self.tips(case)
        case["run"] = {
            "until": self.number(2, 8)
            * self.time
            / (1 if kind in ("wave", "elastic", "beam", "correspondence") else 20)
        }
        if self.chance(0.08) and kind != "correspondence":
            case["run"]["dtype"] = "float32"
        if self.chance(0.2):
            case["run"]["threads"] = self.one(1, 2)
        output: dict = {"every": case["run"]["until"] / int(self.rng.integers(2, 6))} if self.chance(0.8) else {}
        if self.chance(0.4):
            output["probes"] = [[0.2 * self.span] * self.dim]
        if self.chance(0.25) and kind not in ("wave", "beam"):
            output["balance"] = True
        if output:
            case["output"] = output
        [self.rng] = self.rng.spawn(1)
        more = (self.more_recorders, self.more_output, self.more_loads, self.more_of_the_model, self.from_files)
        for add in self.rng.permutation(len(more))[: self.one(1, 1, 2)] if self.chance(RICH_SHARE) else ():
            more[add](case, kind)
        return case

    # --- what fewer cases have ----------------------------------------------------------------------------------

    def point(self, reach: float = 0.4) -> list[float]:
        return [self.number(-reach, reach) * self.span for _ in range(self.dim)]

    def places(self) -> dict:
        """Return where receivers or spectra are."""
        ends = sorted(self.point()), sorted(self.point())
        grid = {"lower": ends[0], "upper": [low + self.spacing for low in ends[0]], "counts": [2] * self.dim}
        return self.one(
            {"points": [self.point(), self.point()]},
            {"line": {"start": ends[0], "end": ends[1], "count": int(self.rng.integers(1, 6))}},
            {"grid": grid},
        )

    def region(self) -> dict:
        """Return a region of any kind inside the near field."""
        at, size = self.point(0.2), self.number(0.2, 0.5) * self.span
        box = {"box": {"lower": [x - size for x in at], "upper": [x + size for x in at]}}
        if self.dim == 1:
            return box
        ball = {"ball" if self.dim == 3 else "disc": {"radius": size, "centre": at}}
        corners = [[at[0] - size, at[1]], [at[0], at[1] - size], [at[0] + size, at[1] + size]]
        flat = [{"polygon": {"points": corners}}, {"text": {"text": self.one("A", "xy"), "height": size}}]
        return self.one(box, ball, {**box, "without": [ball]}, *(flat if self.dim == 2 else []))

    def more_recorders(self, case: dict, kind: str) -> None:
        """Add receivers, spectra, powers, the far field or a shell, of every form."""
        waves, low = kind in ("wave", "elastic"), self.number(0.02, 0.2) / self.time
        known = ["u", "gradient", *["v"] * waves, *["strain", "stress", "curl"] * (kind == "elastic")]
        record = [str(one) for one in self.rng.choice(known, 2, replace=False)]
        rest = {"interpolation": self.one("linear", "sinc"), "every": self.one(1, 2, 7)}
        surface = self.one({"region": self.region()}, {"axis": self.names[-1], "position": self.point()[0]})
        what = self.one("receivers", "spectra", "spectra", "power", "far_field", "shell", "two")
        if what in ("receivers", "two"):
            case.setdefault("receivers", []).append(
                {**self.places(), "record": record if self.chance(0.5) else ["u"], **rest, "name": "line"}
            )
        if what in ("spectra", "two"):
            where = self.one(self.places(), surface)
            frequencies = [low * k for k in range(1, int(self.rng.integers(2, 5)))]
            case.setdefault("spectra", []).append({**where, "frequencies": frequencies, **rest})
        if what == "power" and waves:
            case.setdefault("power", []).append({**surface, "frequencies": [low] if self.chance(0.6) else []})
        if what == "far_field":
            reach = 0.7 * self.span
            case["far_field"] = {"directions": self.one(1, 8, 36)}
            case["far_field"] |= {"frequencies": [low]} if waves else {"points": [[2.0 * self.span] * self.dim]}
            if self.chance(0.5):
                case["far_field"]["box"] = {"lower": [-reach] * self.dim, "upper": [reach] * self.dim}
        if what == "shell" and "shell" not in case and kind == "wave":
            reach = 0.3 * self.span
            case["shell"] = [{"box": {"lower": [-reach] * self.dim, "upper": [reach] * self.dim}}]

    def more_output(self, case: dict, kind: str) -> None:
        """Ask for other output, a run to its static state, or units."""
        output = case.setdefault("output", {})
        output |= self.one(
            {"fields": ["u", "stress"] if kind == "elastic" else ["u"]},
            {"fields": ["v"] if kind in ("wave", "elastic") else ["u"]},
            {"dtype": "float32", "compress": True},
            {"probes": [self.point()], "probe_every": case["run"]["until"] / 3},
            {"pictures": [0.0, case["run"]["until"]]},
        )
        if self.chance(0.2):
            limit = case["run"]["until"]
            case["run"] |= {"until": "static", "tolerance": self.one(1e-3, 0.5), "limit": limit}
        if self.chance(0.3):
            case["units"] = {"length": self.one("m", "mm"), "time": self.one("s", "us"), "mass": "kg"}

    def more_loads(self, case: dict, kind: str) -> None:
        """Add loads, prescribed regions, sides of the temperature, materials of regions or a background."""
        amount, still = 0.01 * self.length, [0.0] * (self.dim - 1)
        side = self.one("x", "y", "z")[: self.dim] + self.one("-", "+")
        loads = [
            {"type": "traction", "side": side, "value": [amount, *still], "time": f"sin(t/{self.time!r})"},
            {"type": "pressure", "points": crack_across(self.dim, 0.31 * self.span, 0.3 * self.span), "value": amount},
            {"type": "pressure", "region": self.region(), "value": amount},
            {"type": "body-force", "value": [amount, *still], "time": self.signal()},
            {"type": "thermal", "temperature": f"20+t/{self.time!r}", "expansion": 1e-3, "reference": 20.0},
        ]
        moved = {"type": "prescribed", "region": self.region(), "value": [amount, *still] if self.vector else amount}
        if self.vector and self.chance(0.7):
            case.setdefault("load", []).append(self.one(*loads))
        elif self.chance(0.5):
            case.setdefault("constraint", []).append(moved | ({"rate": 0.1} if self.chance(0.2) else {}))
        else:
            constants = {"speed", "young", "density"} & set(case["model"])
            given = {key: case["model"][key] for key in sorted(constants)}
            other = {key: self.one(0.7, 1.4) * value for key, value in given.items() if isinstance(value, float)}
            if other:
                case.setdefault("material", []).append({"region": self.region(), **other})
        if self.chance(0.1):
            case["background"] = self.one(0.5, f"{self.names[0]}/{self.length!r}")

    def more_of_the_model(self, case: dict, kind: str) -> None:
        """Add constants that few models have, or the temperature of a solid."""
        model = case["model"]
        if kind == "elastic" and self.chance(0.3):
            kernel = self.kernel()
            heat = {"density": 1.0, "specific_heat": 1.0, "conductivity": 0.1 * self.length * self.speed}
            elastic = {key: value for key, value in model.items() if key != "type"}
            case["model"] = {"type": "thermoelastic", "elastic": elastic, "heat": {**heat, "kernel": kernel}}
            case["model"] |= {"expansion": 1e-3, "reference": 300.0, "coupled": self.chance(0.5)}
            case["boundary_T"] = {"all": self.one({"type": "free"}, {"type": "fixed"}, self.pml())}
            return
        fitting = {
            "wave": [
                {"damping": self.number(0, 0.2) / self.time},
                {"density": self.number(0.5, 2.0)},
                {"attenuation": self.attenuation()},
            ],
            "diffusion": [{"stages": int(self.rng.integers(1, 20)), "integrator": "rkc"}],
            "heat": [{"stages": int(self.rng.integers(1, 20)), "integrator": "rkc"}, {"self_term": self.chance(0.5)}],
            "elastic": [
                {"density": self.number(0.5, 2.0)},
                {"plane": self.one("stress", "strain")},
                {"critical_stretch": 0.1, "softening": self.one("linear", "exponential")},
                {"law": {"type": self.one("bilinear-softening", "exponential-softening"), "onset": 0.1, "final": 0.3}},
                {"law": {"type": "viscoelastic-bond", "relaxing": self.number(0, 1), "time": self.time}},
                {"fracture_energy": self.number(0.1, 2.0)},
                {"damping": self.number(0, 0.2) / self.time},
                {"attenuation": self.attenuation()},
            ],
            "correspondence": [{"plane": self.one("stress", "strain")}, {"drag": 0.1 / self.time}],
        }
        model |= self.one(*fitting.get(kind, [{}]))

    def from_files(self, case: dict, kind: str) -> None:
        """Let a region or a signal come from a file, which `foreign.FILES` writes."""
        names = {1: ["v.npy"], 2: ["v.npy", "v.tif", "i.png", "e.msh"], 3: ["v.tif", "t.stl", "t.ply", "e.vtk"]}
        name = self.one(*names[self.dim])
        region = {
            "v": {"voxels": {"file": name, "size": 0.2 * self.span}},
            "i": {"image": {"file": name, "width": 1.5 * self.span}},
            "t": {"mesh": {"file": name, "scale": self.span}},
            "e": {"elements": {"file": name, "scale": self.span}},
        }[name[0]]
        samples = {"type": "samples", "values": self.one("s.npy", "s.txt", "s.csv"), "dt": self.time}
        if self.chance(0.4):
            strength = [1.0] * self.dim if self.vector else 1.0
            line = {"type": "line-source", "points": [self.point(), self.point()], "strength": strength}
            case.setdefault("source", []).append({**line, "time": samples, "interpolation": "linear"})
        elif "specimen" in case:
            case["specimen"] = [{"region": region}]
        elif "window" in case["lattice"]:
            case["lattice"]["window"] = region
        elif self.chance(0.5):
            case["lattice"]["body"] = region
            case["boundary"] = {"all": {"type": "free"}}
        else:
            if kind in ("wave", "elastic", "correspondence"):
                case["model"]["density"] = 1.0
            case.setdefault("material", []).append({"region": region, "density": 2.0})

    def acted_on(self, case: dict, kind: str) -> dict:
        """Add sources, a crack, a medium that varies, or nodes that are moved to a case."""
        body = kind == "correspondence"
        if self.chance(0.25) and kind in ("wave", "diffusion", "heat"):
            bump = self.bump(0.4, 1 / self.time**2)
            signal = self.one(f"sin(3*t/{self.time!r})", "1", f"exp(-t/{self.time!r})")
            case["source"] = [{"value": f"{bump}*{signal}"}]
        if self.chance(0.2) and kind in ("wave", "diffusion", "heat", "elastic"):
            case["source"] = [*case.get("source", []), self.local_source(kind == "elastic")]
        whole = case["model"].get("material") == "finite-element"  # its bonds are not cut one by one
        if (
            self.chance(0.25)
            and not whole
            and kind in ("wave", "diffusion", "elastic", "correspondence")
            and "window" not in case["lattice"]
        ):
            crack: dict = {"points": crack_across(self.dim, 0.31 * self.span, 0.35 * self.span)}
            if not body and kind != "elastic" and self.chance(0.4):
                crack |= {"factor": 0.3}
            if not body and self.chance(0.3):
                crack |= {"opens": 2 * self.time}
            case["crack"] = [crack]
        if self.chance(0.15) and kind in ("wave", "diffusion"):
            case = {
                "coefficient": f"1+0.5*{self.bump(0.5)}",
                "rule": self.one("both", "arithmetic", "harmonic"),
                **case,
            }
        if self.chance(0.2) and kind in ("wave", "elastic"):
            case |= self.uneven(case["model"])
        if self.chance(0.1) and kind == "wave" and "window" not in case["lattice"]:
            case["constraint"] = [
                {
                    "type": "prescribed",
                    "points": [[0.0] * self.dim],
                    "value": f"sin(t/{self.time!r})",
                    "until": 3 * self.time,
                }
            ]
        return case

    def uneven(self, model: dict) -> dict:
        """Let constants vary from node to node, in the table of the model, or return them by region."""
        model.setdefault("density", 1.0)
        names = [name for name in ("speed", "young", "poisson", "density") if name in model]
        if model.get("material") in ("bond-based", "finite-element"):
            names = ["density"] if model["material"] == "finite-element" else ["young", "density"]
        chosen = self.rng.choice(names, self.rng.integers(1, len(names) + 1), replace=False).tolist()
        other = {name: model[name] * self.one(0.7, 1.4) for name in chosen}
        if self.chance(0.5):
            return {"material": [{"region": {"ball" if self.dim == 3 else "box": self.half_of_it()}, **other}]}
        beyond = f"{self.names[-1]} > {self.number(-0.5, 0.5) * self.span!r}"
        for name, value in other.items():
            model[name] = f"where({beyond}, {value!r}, {model[name]!r})"
        return {}

    def half_of_it(self) -> dict:
        """Return a region: a ball in the middle, or the upper half."""
        if self.dim == 3:
            return {"radius": 0.6 * self.span}
        far = 10 * self.span
        return {"lower": [-far] * (self.dim - 1) + [0.1 * self.spacing], "upper": [far] * self.dim}

    def tips(self, case: dict) -> dict:
        """Return recorders of the tips of cracks in 2D."""
        if self.dim != 2 or case["model"]["type"] not in ("wave", "elastic") or not self.chance(0.5):
            return {}
        if "critical_stretch" in case["model"]:
            return {"crack_tips": [{"every": self.one(1, 5), "most": self.one(1, 7)}]}
        settled = "crack" in case and not {"opens", "factor"} & set(case["crack"][0])
        if not settled or "coefficient" in case or "nonlinear" in case["model"]:
            return {}
        return {"stress_intensity": [{"every": self.one(1, 5)}]}

    def recorders(self, kind: str) -> dict:
        """Return recorders at points, at frequencies, across surfaces and of the far field."""
        found: dict = {}
        if kind == "correspondence":
            return found
        waves = kind in ("wave", "elastic")
        if self.chance(0.2):
            record = ["u", "v"] if waves else ["u"]
            points = [[self.number(-0.2, 0.2) * self.span for _ in range(self.dim)] for _ in range(3)]
            found["receivers"] = [
                {
                    "points": points,
                    "record": record,
                    "every": self.one(1, 3),
                    "interpolation": self.one("linear", "sinc"),
                }
            ]
        if self.chance(0.1) and waves:
            point = [0.1 * self.span] * self.dim
            found["spectra"] = [{"points": [point], "frequencies": [0.05 / self.time], "interpolation": "linear"}]
        if self.chance(0.1) and waves:
            found["power"] = [{"axis": "x", "position": 0.1 * self.span, "frequencies": [0.05 / self.time]}]
        if self.chance(0.1) and kind in ("wave", "elastic", "diffusion"):
            found["far_field"] = {"points": [[3.0 * self.span] * self.dim]}
            if waves:
                found["far_field"]["frequencies"] = [0.05 / self.time]
        return found

    def case(self) -> dict:
        kinds = (
            "wave",
            "wave",
            "wave",
            "diffusion",
            "diffusion",
            "heat",
            "corrosion",
            "beam",
            "elastic",
            "elastic",
            "correspondence",
            "from_outside",
            "passing",
        )
        return self.around(getattr(self, self.one(*kinds))())


def places(value, path=()):
    """Yield all places in a case, including outer ones."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield (*path, key)
            yield from places(inner, (*path, key))


def spoilt(case: dict, rng) -> str:
    """Return a case file with one or two oddities: a value, a missing key, a wrong key, a character."""
    for _ in range(int(rng.integers(1, 3))):
        found = list(places(case))
        if not found:
            break
        path = found[int(rng.integers(len(found)))]
        owner = case
        for key in path[:-1]:
            owner = owner[key]
        what = rng.random()
        if what < 0.6:
            owner[path[-1]] = Odd(ODD[int(rng.integers(len(ODD)))])
        elif what < 0.7:
            owner[path[-1]] = ODD_TEXTS[int(rng.integers(len(ODD_TEXTS)))]
        elif what < 0.85 or not isinstance(owner, dict):
            del owner[path[-1]]
        elif isinstance(owner[path[-1]], float) and math.isfinite(owner[path[-1]]):
            owner[path[-1]] *= float(10 ** rng.uniform(-6, 6))
        else:
            owner[str(path[-1]) + "s"] = owner[path[-1]]
    text = text_of(case)
    if rng.random() < 0.05:
        at = int(rng.integers(len(text)))
        text = text[:at] + chr(int(rng.integers(1, 300))) + text[at + 1 :]
    return text


class Odd:
    """TOML text that is not a Python value."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __str__(self) -> str:
        return self.text


def random_case(rng, odd: float = ODD_SHARE) -> tuple[str, bool]:
    """Return the text of a case file, and whether it was spoilt."""
    case = Draw(rng).case()
    if rng.random() < odd:
        return spoilt(case, rng), True
    return text_of(case), False
