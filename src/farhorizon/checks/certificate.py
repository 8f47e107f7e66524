"""Stability of a set-up: proofs where they hold, otherwise the spectral radius of the complete update, examined first
for pairs of sides and then for corners.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from typing_extensions import TypedDict

from farhorizon import kinds
from farhorizon.analysis import stability
from farhorizon.analysis.stability import (
    DENSE,
    Allowance,
    Growth,
    LinearMap,
    dense_growth,
    fastest,
    krylov_growth,
    noise_growth,
    step_seconds,
    white_noise,
)
from farhorizon.boundaries import Fixed
from farhorizon.boundaries.plane_wave import largest_update
from farhorizon.checks import reduced_setups as strips
from farhorizon.checks.examined import Examined
from farhorizon.checks.reduced_setups import (
    NARROW,
    Strip,
    crossing_rounds,
    like_sides,
    one_corner,
    plain_twin,
    small_lattice,
)
from farhorizon.engine import state
from farhorizon.engine.engine import NEVER
from farhorizon.engine.state import State
from farhorizon.errors import InputError
from farhorizon.files.cache import cache_folder, keep, kept
from farhorizon.files.html import table
from farhorizon.geometry.lattice import AXES
from farhorizon.machine import one_blas_thread, progress

#: What is examined, and what examines it within an allowance: the result, and what was left out.
Examination = tuple[str, Callable[[Allowance], tuple["ExaminedPart", list[str]]]]
Verdict = Literal["certified", "not certified", "undecided"]
CERTIFIED: Verdict = "certified"
NOT_CERTIFIED: Verdict = "not certified"
UNDECIDED: Verdict = "undecided"
BUDGET = 30.0  # seconds that a certificate may take on a typical core
_WIDE = 1500  # numbers in the state of a strip on a line, or of one widened where a mode grows, at most
_CROSSINGS = 200_000  # longest run from noise whose map is known as a matrix
_KEPT = ("verdict", "reason", "rate", "error", "crossing", "seconds", "quiet", "work")  # of a certificate in the cache
PATIENCE = 2.0  # seconds for which rising noise may be followed before a run, on a typical core
_WHOLE = 10.0  # seconds up to which noise may run in a set-up as it is, or half of the run where that is longer
_MATTERS = 10.0  # a run is refused if something grows by this factor within it
_ALIKE = 4  # noise runs in the set-up itself if it has at most this many times the nodes of the small copy
_ESCAPES = 0.5  # growth per crossing below which sides along a strip may absorb a mode before it has grown
_MARGIN = 1 - 1e-9  # at the step limit itself the shortest wave grows linearly


@dataclass(frozen=True)
class ExaminedPart:
    """One update whose spectral radius was computed.

    Attributes
    ----------
    name : str
        What was examined.
    growth : Growth
    field : ndarray of complex
        The growing mode on the near field and its unstretched margins; empty if unknown.
    drifts : bool
        Whether the whole state grows, linearly in time, and no mode; `growth` is the rate at the end of a long run.
    """

    name: str
    growth: Growth
    field: np.ndarray
    drifts: bool = False


class PartFacts(TypedDict):
    """One update whose growth was computed."""

    what: str
    """What was examined."""
    rate: float | None
    """Growth rate per crossing."""
    error: float | None
    """Uncertainty of the rate; null if unknown."""
    angle: float
    """Phase of the mode per step, in radians."""
    hidden: float
    """Growth per crossing that a run from noise could have missed; 0 for rates from eigenvalues."""


class CertificateFacts(TypedDict):
    """Whether the complete update is stable, and how that is known."""

    verdict: Verdict
    """Certified: no mode grows by more than 1e-10 per crossing."""
    reason: str
    """How the verdict was reached, or what grows."""
    rate: float | None
    """Growth rate of the fastest-growing mode per unit time, negative if it decays; null for a proof or if unknown."""
    error: float | None
    """Uncertainty of the rate."""
    crossing: float | None
    """Crossing time of the set-up, the unit of time in which growth is judged; null for a proof."""
    rate_per_crossing: float | None
    """The growth rate per crossing time, which is dimensionless."""
    parts: list[PartFacts]
    """The parts that were computed."""
    skipped: list[str]
    """What would also have to be computed, and why it was not."""
    seconds: float
    """Computing time in seconds."""
    quiet: float
    """Time over which white noise did not grow in an initial run; 0 if there was none."""


@dataclass(frozen=True)
class Certificate:
    """Whether the complete update (near field and all memory of the boundaries) is stable, and how this was determined.

    Attributes
    ----------
    verdict : {"certified", "not certified", "undecided"}
        Certified: no mode grows by more than 1e-10 per crossing, except as a medium with a negative reaction lets it.
    reason : str
    rate : float
        Growth rate of the fastest-growing mode per unit time; negative if it decays; nan for a proof and if nothing
        could be determined.
    error : float
        Uncertainty of the rate.
    crossing : float
        Crossing time of the set-up, see `Run.crossing`: the unit of time in which growth is judged; nan for a proof.
    parts : tuple of ExaminedPart
        The parts that were computed; their rates are growth rates per crossing.
    skipped : tuple of str
        What would also have to be computed, and why it was not.
    seconds : float
        Computing time.
    quiet : float
        Time over which white noise did not grow in an initial run; 0 if there was none, as for proofs and for
        eigenvalues of the complete update.
    work : float
        Operations that were performed, in seconds of a typical core: they, not the clock, are limited by the budget, so
        that a verdict depends on neither the machine nor its load.

    Examples
    --------
    >>> import farhorizon as fh
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(2.0)), fh.Fixed(), {"u": "exp(-x**2)"})
    >>> sim.certificate().verdict
    'certified'
    """

    verdict: Verdict
    reason: str
    rate: float = np.nan
    error: float = 0.0
    crossing: float = np.nan
    parts: tuple[ExaminedPart, ...] = ()
    skipped: tuple[str, ...] = ()
    seconds: float = 0.0
    quiet: float = 0.0
    work: float = 0.0

    @property
    def rate_per_crossing(self) -> float:
        """The growth rate per crossing time, which is dimensionless."""
        return self.rate * self.crossing

    @property
    def worst(self) -> ExaminedPart | None:
        """The part with the fastest-growing mode; None if nothing grows."""
        growing = [p for p in self.parts if p.growth.stable is False]
        return max(growing, key=lambda p: p.growth.rate) if growing else None

    def __str__(self) -> str:
        return self.in_full(np.inf)

    def _repr_html_(self) -> str:
        parts = [(part.name, part.growth.rate) for part in self.parts]
        rows = [("verdict", self.verdict), ("reason", self.reason), ("rate per unit time", f"{self.rate:.3g}")]
        rows += [(name, f"{rate:.3g} per crossing") for name, rate in parts]
        return table([*rows, *(("not examined", what) for what in self.skipped)], "stability")

    def grows_within(self, until: float) -> bool:
        """Whether known growth reaches a factor of ten in a run of the given length: less is irrelevant, since growth
        starts from rounding errors or leakage.
        """
        return self.verdict == NOT_CERTIFIED and not self.rate * until < np.log(_MATTERS)

    def in_words(self, until: float) -> str:
        """Summary, in a few words, of what is known about a run of the given length."""
        return self.reason if self._enough(until) else f"stability {self.verdict}"

    def in_full(self, until: float) -> str:
        """What is known about a run of the given length, how it was determined, and what was not examined."""
        verdict = self.reason if self._enough(until) else f"{self.verdict}: {self.reason}"
        return verdict + "".join(f"; not examined: {part}" for part in self.skipped)

    def _enough(self, until: float) -> bool:
        """Whether there is no verdict but none is needed, because noise did not grow for as long as the run lasts."""
        return self.verdict == UNDECIDED and until <= self.quiet

    def remark(self, until: float) -> str:
        """What the user should know before a run of the given length; empty if there is nothing to report."""
        if self.verdict == NOT_CERTIFIED:
            exponent = min(self.rate * until, 700)  # whose exponential is a finite number
            factor = f"{np.exp(exponent):.2g}-fold " if np.isfinite(self.rate) else ""
            return f"not stable, {factor}in this run: {self.reason}"
        if self.verdict == UNDECIDED and not self._enough(until):
            longer = ", but the run is longer" if self.quiet else ""
            return (
                f"stability is undecided, {self.reason}{longer}: farhorizon check --budget 60 (certificate(60.0) in "
                "Python) examines it further"
            )
        return ""

    def as_json(self) -> CertificateFacts:
        """The certificate as plain numbers and words; None for what is not known."""

        def known(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        rows: list[PartFacts] = [
            {
                "what": p.name,
                "rate": known(p.growth.rate),
                "error": known(p.growth.error),
                "angle": p.growth.angle,
                "hidden": p.growth.hidden,
            }
            for p in self.parts
        ]
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "rate": known(self.rate),
            "error": known(self.error),
            "crossing": known(self.crossing),
            "rate_per_crossing": known(self.rate_per_crossing),
            "parts": rows,
            "skipped": list(self.skipped),
            "seconds": self.seconds,
            "quiet": self.quiet,
        }


@one_blas_thread()
def certify(sim: Examined, budget: float = BUDGET, until: float = np.inf, brief: bool = True) -> Certificate:
    """Examine the one-step map of a simulation.

    Where no proof holds, a state of up to 700 numbers is examined as it is. Otherwise white noise runs for ten crossing
    times of a small copy of the near field, and what grows there is refused. Then each pair of absorbing sides is
    examined by itself, with a medium between them that extends indefinitely along the other axes: its map is a chain
    for each tangential wavenumber, and all eigenvalues of that chain are computed. Corners, edges and faces that run
    into a layer are examined on a small copy of the near field by Krylov spaces of powers of the map. A medium that
    varies is examined as it is, or, for noise that would take too long in it, in a copy that contains all pairs of
    adjoining media; a uniform medium says nothing about it. Where there are layers on all sides and both sides of an
    axis are the same, that copy keeps one of them and the other side is held fixed, because all corners are alike. A
    mode between two sides that grows so slowly that the other sides may absorb it first (as they do long surface waves)
    is examined on the near field as it is.

    `budget` is in seconds of a typical core, by number of operations; what would take longer is skipped, and the
    certificate says so. Noise runs at most for the length `until` of the run. With `brief` a run is about to begin:
    noise then takes as long as it needs, and if it ran for as long as the run, or grew, no modes are examined;
    otherwise noise takes at most half of the budget, and modes are examined afterwards.
    """
    budget = kinds.number(budget, "budget", least=0)
    if (simpler := _simpler(sim)) is not None:
        certificate = certify(simpler[0], budget, until, brief)
        return replace(certificate, reason=f"{certificate.reason}; {simpler[1]}")
    begin = time.monotonic()
    proof = _proof(sim)
    if proof:
        return Certificate(CERTIFIED, proof, seconds=time.monotonic() - begin)
    if sim.model.dissolution is not None and (sim.engine.get("phases.dissolved") == NEVER).any():
        certificate = certify(sim.remade(specimens=()), budget, until, brief)
        return replace(certificate, reason=f"{certificate.reason}; that of the linear form, all liquid")
    path = _cache_file(sim)
    cached = _recall(path)
    if cached is not None:
        return cached
    with progress(bar_format="stability: {desc}") as bar:
        certificate, complete, work = _examined(sim, budget, until, brief, bar.set_description_str)
    certificate = replace(certificate, seconds=time.monotonic() - begin, work=work)
    if complete:
        _keep(path, certificate)
    return certificate


def _simpler(sim: Examined) -> tuple[Examined, str] | None:
    """A set-up whose stability is that of this one, and what the certificate says of it; None if there is none."""
    given = {name: sim.given[name] for name in ("boundary", "coefficient", "dt")}
    if sim.model.bond_law is not None:
        heats = " and nothing heats" if any(getattr(load, "coupled", False) for load in sim.given["loads"]) else ""
        linear = sim.remade(model=sim.given["model"].linearised, **given, balance=False, loads=())
        return linear, f"that of the linear form, in which no bond breaks{heats}"
    if sim.of_field:
        linear = sim.remade(model=sim.given["model"].at_background, sources=(), **given)
        return linear, "that of the linear form, as at the background, without sources"
    if sim.growth:
        neutral = sim.given["model"].with_stencil(sim.stencil.with_reaction(0.0))
        remark = f"apart from the growth of the medium itself, {sim.growth:.3g} per unit time"
        return sim.remade(model=neutral, **given), remark
    if any(b.extended for b in sim.sides.values()):
        sides = {AXES[a] + "-+"[s > 0]: Fixed(sim.background) if b.extended else b for (a, s), b in sim.sides.items()}
        return sim.remade(boundary=sides), "extending the medium beyond the sides changes nothing"
    return None


def _examined(
    sim: Examined, budget: float, until: float, brief: bool, report: Callable[[str], None]
) -> tuple[Certificate, bool, float]:
    """The certificate, whether nothing was left out, and the operations; `report` is called with what is examined."""
    parts: list[ExaminedPart] = []
    slow: list[ExaminedPart] = []
    skipped: list[str] = []
    report("a run from white noise")
    follows = brief and bool(np.isfinite(until))
    rounds = until / sim.dt / sim.engine.every
    short = Allowance(max(_WHOLE, rounds * _cost(sim) / 2) if follows else budget / 2)
    further = Allowance(PATIENCE if follows else budget / 3)
    grown, quiet, where = _noise_part(sim, short, further, until)
    allowance = Allowance(budget if follows else budget - short.used - further.used)

    def work() -> float:
        return short.used + further.used + allowance.used

    if follows and grown is not None:
        return judge([grown], [], sim.crossing), False, work()
    if brief and until <= quiet:
        return judge([], ["modes, as the run is no longer"], sim.crossing, quiet, where), False, work()
    try:
        for name, examine in _examinations(sim):
            if allowance.left <= 0:
                skipped.append(f"{name} (nothing left of a budget of {budget:.3g})")
                continue
            report(f"{name}, about {allowance.left:.0f} s at most")
            try:
                part, left_out = examine(allowance)
            except TimeoutError:
                skipped.append(f"{name} (needs a budget of more than {budget:.3g})")
                continue
            skipped += left_out
            if part.growth.rate == 0 and np.isinf(part.growth.error):
                skipped.append(f"{name} (not settled with a budget of {budget:.3g})")
                continue
            if part.growth.stable is False and _escapes(sim, part):
                slow.append(part)
                continue
            parts.append(part)
            if part.growth.stable is False:
                break
        else:
            if slow:
                parts, skipped = _with_whole(sim, slow, parts, skipped, allowance)
    except InputError:  # such as a window that a smaller copy does not have
        skipped.append("pairs of sides and corners, of which no smaller copy can be made")
    certificate = judge(parts, skipped, sim.crossing, quiet, where)
    examined = certificate.verdict == CERTIFIED and bool(slow)  # the complete set-up, which says more than a copy
    if grown is not None and certificate.verdict != NOT_CERTIFIED and not examined:
        certificate = judge([*parts, grown], skipped, sim.crossing)
    return _short_lived(sim, certificate), not skipped, work()


def rate_text(rate: float, crossing: float) -> str:
    """A growth per crossing in words; a crossing takes the time `crossing`."""
    return f"{rate:.2g} per crossing ({rate / crossing:.2g} per unit time)"


def judge(
    parts: list[ExaminedPart], skipped: list[str], crossing: float, quiet: float = 0.0, where: str = ""
) -> Certificate:
    """Verdict that follows from the parts that were computed and those that were skipped; white noise did not grow over
    the time `quiet` in the set-up named `where`.
    """
    noise = f"white noise in {where} does not grow for t = {quiet:.3g}" if quiet else ""
    if not parts:
        reason = noise or "nothing could be examined"
        return Certificate(UNDECIDED, reason, crossing=crossing, skipped=tuple(skipped), quiet=quiet)
    growths = [p.growth for p in parts]
    growth = fastest(growths) if any(g.stable is not True for g in growths) else max(growths, key=lambda g: g.rate)
    part = next(p for p in parts if p.growth is growth)
    rate, error = growth.rate / crossing, growth.error / crossing
    blank = Certificate(UNDECIDED, "", rate, error, crossing, tuple(parts), tuple(skipped), quiet=quiet)
    if growth.stable is False:
        tenfold = np.log(10) * crossing / growth.rate
        reason = f"a mode grows by {rate_text(growth.rate, crossing)}, tenfold in {tenfold:.3g} ({part.name})"
        return replace(blank, verdict=NOT_CERTIFIED, reason=part.name if part.drifts else reason)
    unclear = [p.name for p in parts if p.growth.stable is None]
    if unclear:
        doubt = f"the fastest mode could not be distinguished from a growing one ({', '.join(unclear)})"
        return replace(blank, reason="; ".join(filter(None, [noise, doubt])))
    names = ", ".join(p.name for p in parts)
    if skipped:
        so_far = f"nothing grows as far as was examined ({names})"
        return replace(blank, reason="; ".join(filter(None, [noise, so_far])))
    noisy = [p for p in parts if p.growth.hidden]
    if noisy:
        without_noise = ", ".join(p.name for p in parts if p not in noisy)
        decays = "white noise decays ({})".format(
            ", ".join(
                f"{p.name}, where growth below {p.growth.hidden:.1g} per crossing would go unnoticed" for p in noisy
            )
        )
        reason = f"no mode grows ({without_noise}); {decays}" if without_noise else decays
    elif growth.rate < 0:
        reason = f"the slowest mode decays by {rate_text(-growth.rate, crossing)} ({names})"
    else:
        reason = f"no mode grows by more than {growth.rate + growth.error:.1g} per crossing ({names})"
    return replace(blank, verdict=CERTIFIED, reason=reason)


def _short_lived(sim: Examined, certificate: Certificate) -> Certificate:
    """The certificate; certified if exact ends let nothing grow e-fold in the steps for which their sums are made, over
    which they follow the infinite chain, whose energy does not grow.
    """
    ends = sim.exact_ends
    if ends is None or sim.engine.layers or certificate.verdict == CERTIFIED:
        return certificate
    exponent = certificate.rate * ends.steps * sim.dt
    if not exponent < 1:
        return certificate
    gain = f"until then their fastest mode grows by a factor of {np.exp(exponent):.3g}"
    reason = f"the ends follow the infinite chain for {ends.steps} steps and are then recomputed; {gain}"
    return replace(certificate, verdict=CERTIFIED, reason=reason)


# --- cached certificates ---------------------------------------------------------------------------------------


_PROGRAM = b"".join(
    Path(str(file)).read_bytes() for file in (__file__, stability.__file__, state.__file__, strips.__file__)
)


def _cache_file(sim: Examined) -> Path:
    """File of the certificate of this map, as computed by this version of the program."""
    mark = hashlib.sha256(state.digest(sim.engine).encode())
    mark.update(repr((sim.lattice.shape, sim.crossing, [type(b).__name__ for b in sim.sides.values()])).encode())
    mark.update(_PROGRAM)
    return cache_folder() / f"certificate_{mark.hexdigest()[:24]}.npz"


def _recall(path: Path) -> Certificate | None:
    arrays = kept(path)
    if arrays is None:
        return None
    words = json.loads(str(arrays["words"]))
    parts = []
    for i, (name, rate, error, real, imaginary, hidden, drifts) in enumerate(words.pop("parts")):
        growth = Growth(rate, error, complex(real, imaginary), np.zeros(0), hidden)
        parts.append(ExaminedPart(name, growth, arrays[f"field{i}"], drifts))
    return Certificate(**words, parts=tuple(parts))


def _keep(path: Path, certificate: Certificate) -> None:
    words = {name: getattr(certificate, name) for name in _KEPT}
    words["parts"] = [
        (p.name, g.rate, g.error, g.factor.real, g.factor.imag, g.hidden, p.drifts)
        for p in certificate.parts
        for g in [p.growth]
    ]
    keep(path, words=json.dumps(words), **{f"field{i}": p.field for i, p in enumerate(certificate.parts)})


# --- proofs ----------------------------------------------------------------------------------------------------


def _proof(sim: Examined) -> str:
    """Why nothing can grow, where a proof exists; otherwise empty."""
    model, sides = sim.model, sim.sides.values()
    ends = sim.exact_ends
    if ends is not None and ends.convolved and not any(b.stretched for b in sides):
        return (
            "the full history beyond the ends is kept: the run is part of one on the infinite chain, whose energy "
            "does not grow"
        )
    positive = sim.stencil.positive
    if sim.closure is not None:
        return _outline_proof(sim, positive)
    if not all(b.passive for b in sides):
        return ""
    damped = max((b.damping(1, model.coefficient, sim.lattice.spacing).max() for b in sides if b.damped), default=0.0)
    if sim.conditions.nodes.size:
        rows = np.add.reduceat(np.abs(np.append(sim.conditions.weights, 0.0)), sim.conditions.starts[:-1]) * (
            np.diff(sim.conditions.starts) > 0
        )
        coefficient, mobility = sim.engine.get("material.coefficient"), sim.engine.get("mobility")
        lightest = float(coefficient.max() * mobility.max()) if mobility.size else 0.0
        bonds = (lightest or sim.strongest) * float(sim.engine.weights.sum())
        change = sim.dt * (bonds + sim.engine.reaction + float(sim.leak.max(initial=0)) + damped)  # of the old value
        if model.integrator.name == "forward Euler" and positive and change <= 1 and rows.max(initial=0) <= 1 + 1e-12:
            return (
                "each new value is, up to its sign, a mean of old ones with non-negative weights: the maximum "
                "cannot grow"
            )
        return ""
    complete = all(b.bonded for b in sides) and not (sim.engine.absent.count or sim.varied)  # no bond is missing
    limit = sim.step_limit if model.order == 2 else model.integrator.step_limit(sim.rate_limit + damped)
    if (positive or complete) and sim.dt <= limit * (_MARGIN if model.order == 2 else 1 + 1e-12):
        return (
            "bonds act alike in both directions and the step is below the limit: the energy of the scheme cannot grow"
            + ("; relaxation only takes energy" if model.attenuation is not None else "")
        )
    return ""


def _outline_proof(sim: Examined, positive: bool) -> str:
    """Why a condition along an outline cannot make anything grow; empty without a proof."""
    closure, model = sim.closure, sim.model
    if (
        closure is None
        or sim.conditions.nodes.size
        or sim.conditions.leaks
        or not all(b.closing or not b.endless for b in sim.sides.values())
    ):
        return ""
    if model.order == 1:
        change = sim.dt * sim.strongest * float(sim.engine.weights.sum())  # of the old value
        largest = 1 + stability.TOLERANCE * sim.dt / sim.crossing
        if positive and change <= 1 and largest_update(closure.update) <= largest:
            return "each new value, fitted ones included, is at most a mean of old ones: the maximum cannot grow"
        return ""
    if not all(b.passive for b in sim.sides.values()):
        return ""
    # stiffness added by the sides
    held = 2 * float(np.sqrt(model.coefficient)) * model.damping * sim.lattice.dim / sim.lattice.spacing
    if (positive or not sim.engine.absent.count) and sim.dt <= _MARGIN * 2 / np.sqrt(sim.rate_limit + held):
        return (
            "bonds act alike in both directions, the sides add damping and stiffness, neither of them negative, and "
            "the step is below the limit"
        )
    return ""


def _escapes(sim: Examined, part: ExaminedPart) -> bool:
    """Whether a mode between two sides grows so slowly that absorbing sides along them may absorb it first."""
    axis = AXES.index(part.name[len("sides ")]) if part.name.startswith("sides ") else None
    along = [] if axis is None else [a for a in range(sim.lattice.dim) if a != axis]
    if not any(sim.sides[a, s].stretched or sim.sides[a, s].damped for a in along for s in (-1, 1)):
        return False
    return part.growth.rate < _ESCAPES


def _with_whole(
    sim: Examined, slow: list[ExaminedPart], parts: list[ExaminedPart], skipped: list[str], allowance: Allowance
) -> tuple[list[ExaminedPart], list[str]]:
    """Examined and skipped parts, with the complete update in place of modes that grow slowly between two sides."""
    worst = max(slow, key=lambda p: p.growth.rate)
    name = (
        "the complete update, because with infinitely long sides a mode would grow by "
        f"{rate_text(worst.growth.rate, sim.crossing)} ({worst.name})"
    )
    complete = _krylov_part(name, plain_twin(sim), sim.crossing, allowance)
    if not (complete.growth.rate == 0 and np.isinf(complete.growth.error)):
        return [*parts, complete], skipped
    return parts, [*skipped, f"{name} (the budget is used up)"]


# --- what is examined ------------------------------------------------------------------------------------------


def _cost(sim: Examined) -> float:
    """Seconds of a round of steps on a typical core."""
    return sim.engine.every * step_seconds(sim.engine.size * sim.stencil.weights.size)


def _examinations(sim: Examined) -> Iterator[Examination]:
    """What must be stable for the set-up to be stable, cheapest first; each is called with what it may use."""
    if sim.exact_ends is not None and not sim.exact_ends.steps:
        raise InputError("the kernel of the exact ends is computed when the run begins")
    if sim.engine.size <= DENSE and State(sim.engine).size <= DENSE:
        yield "the complete update", lambda _: (_dense_part("the complete update", plain_twin(sim)), [])
        return
    complete: Examination = (
        "the complete update",
        lambda allowance: (_krylov_part("the complete update", plain_twin(sim), sim.crossing, allowance), []),
    )
    # what grows at the sides of a uniform medium says nothing about one that varies, nor a copy about a guide
    if sim.varied or _guides(sim):
        yield complete
        return
    layered = [axis for axis in range(sim.lattice.dim) if any(sim.sides[axis, s].stretched for s in (-1, 1))]
    examined: list[int] = []
    # what is stable between sides close together is also stable between sides farther apart
    for axis in sorted(layered, key=lambda axis: sim.lattice.shape[axis]):
        if not any(_same_sides(sim, axis, earlier) for earlier in examined):
            yield f"sides {AXES[axis]}", partial(_side_part, sim, axis)
            examined.append(axis)
    beside_layers = [b for (axis, _), b in sim.sides.items() if axis not in layered[:1]]
    if layered and all(b.periodic for b in beside_layers) and not sim.conditions.nodes.size:
        return
    # whether the condition along an outline grows depends on the course of the outline
    if sim.conditions.nodes.size or sim.conditions.leaks or sim.closure is not None:
        yield complete
        return
    small = small_lattice(sim)
    name = f"{'corners' if len(layered) > 1 else 'faces'} on a copy of {_by(small.shape)} nodes"
    corners = one_corner(sim)
    yield (name, lambda allowance: (_krylov_part(name, plain_twin(sim, small, corners), sim.crossing, allowance), []))


def _noise_part(
    sim: Examined, short: Allowance, further: Allowance, until: float
) -> tuple[ExaminedPart | None, float, str]:
    """What grows in a short run from white noise, None if nothing does; the time for which noise ran, and in what."""
    ends = sim.exact_ends
    if ends is not None and (ends.convolved or not ends.steps):
        return None, 0.0, ""  # a history that is kept in full is not a finite state
    twin, where = _noisy(sim, until)
    state, crossing = State(twin.engine), crossing_rounds(twin)
    period = state.every * twin.dt
    asked = until / (crossing * period)
    update = LinearMap(state.after_rounds, state.size, period / sim.crossing, crossing, _cost(twin))
    noise = state.at_rest(white_noise(state.size_of_field))  # as that of initial data: without momentum
    growth, crossings = noise_growth(update, noise, further, short, asked)
    quiet = float(until if asked <= crossings * (1 + 1e-9) else crossings * crossing * period)
    if growth is None:
        return None, quiet, where
    mode = state.portrait(growth.mode) if growth.mode.size else np.zeros(0)
    return ExaminedPart(f"white noise, {where}", growth, mode), quiet, where


def _noisy(sim: Examined, until: float) -> tuple[Examined, str]:
    """The set-up without sources if it is small, if it varies, or if sides that reflect, conditions or an outline would
    make a copy a different problem; otherwise a small copy. Of a large medium that varies, a copy with shorter
    stretches of equal planes. And its name.
    """
    small = small_lattice(sim)
    special = sim.conditions.nodes.size or sim.conditions.leaks or sim.closure is not None or _guides(sim)
    if sim.varied:
        rounds = min(until / sim.dt, stability.SHORT * crossing_rounds(sim)) / sim.engine.every
        shorter = None if special or rounds * _cost(sim) <= _WHOLE else sim.shortened()
        if shorter is not None:
            return plain_twin(shorter), f"a copy with shorter strata, of {_by(shorter.lattice.shape)} nodes,"
    elif not special and np.prod(sim.lattice.shape) > _ALIKE * np.prod(small.shape):
        return plain_twin(sim, small), f"a copy of {_by(small.shape)} nodes"
    return plain_twin(sim), "this set-up"


def _guides(sim: Examined) -> bool:
    """Whether two sides that reflect guide waves into a layer: which waves, and how fast they grow where some run
    backward, depends on both lengths of the guide.
    """
    walls = [
        not any(sim.sides[axis, s].endless or sim.sides[axis, s].periodic for s in (-1, 1))
        for axis in range(sim.lattice.dim)
    ]
    return any(walls) and any(b.stretched for b in sim.sides.values())


def _by(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))


def _dense_part(name: str, sim: Examined) -> ExaminedPart:
    complete = State(sim.engine)
    matrix = np.stack([complete.after_rounds(unit) for unit in np.eye(complete.size)], axis=1)
    period = complete.every * sim.dt / sim.crossing
    of_modes = growth = dense_growth(matrix, period)
    name = f"{name}, all {complete.size} modes"
    if growth.stable is not False:
        growth, verb = _with_noise(growth, matrix, crossing_rounds(sim), period)
        name = f"{verb} ({name})" if verb else name
    drifts = growth is not of_modes and growth.stable is False
    return ExaminedPart(name, growth, complete.portrait(growth.mode), drifts)


def _with_noise(growth: Growth, matrix: np.ndarray, crossing: int, dt: float) -> tuple[Growth, str]:
    """Growth from eigenvalues that do not grow, checked by a run from noise, and what noise does if it does not decay.

    The run takes 24 crossing times. Modes that are nearly alike add up first, so it is doubled until the noise decays
    over its last third. Noise that still grows linearly in time indicates a double eigenvalue 1: no eigenvalue grows,
    or rounding hides it, but the state does.
    """
    third, length, sizes = np.linalg.matrix_power(matrix, 8 * crossing), 24, [0.0, 0.0]
    noise = np.random.default_rng(0).standard_normal(len(matrix))
    while length <= _CROSSINGS:
        before = third @ (third @ noise)
        sizes = [float(np.linalg.norm(before)), float(np.linalg.norm(third @ before))]
        if sizes[1] <= sizes[0]:
            return growth, ""
        third, length = third @ third, 2 * length
    if sizes[1] > 1.4 * sizes[0]:  # 3/2 for a growth like time
        return replace(
            growth, rate=np.log(sizes[1] / sizes[0]) / (length / 6 * crossing * dt), error=0.0
        ), "white noise grows linearly in time (it drifts)"
    return replace(growth, error=np.inf), f"white noise does not decay within {_CROSSINGS} crossing times"


def _krylov_part(name: str, sim: Examined, crossing: float, allowance: Allowance) -> ExaminedPart:
    """The fastest-growing mode of a set-up; `crossing` is the unit of time of its growth."""
    complete = State(sim.engine)
    period = complete.every * sim.dt / crossing
    update = LinearMap(complete.after_rounds, complete.size, period, crossing_rounds(sim), _cost(sim))
    growth = krylov_growth(update, allowance)
    if growth.hidden and any((layer.sigma[layer.alpha == 0] > 0).any() for layer in sim.engine.layers.values()):
        # static fields do not decay in such a layer: a double eigenvalue 1, slower than any run shows
        growth = replace(growth, error=np.inf)
        name = f"layers with alpha = 0, which let fields of zero frequency drift: {name}"
    return ExaminedPart(name, growth, complete.portrait(growth.mode) if growth.mode.size else np.zeros(0))


def _side_part(sim: Examined, axis: int, allowance: Allowance) -> tuple[ExaminedPart, list[str]]:
    """The worst mode between two sides over all tangential wavenumbers; and what the allowance did not suffice for."""
    nodes = sim.lattice.shape[axis]
    strip = Strip(sim, axis, min(nodes, max(NARROW, 2 * sim.stencil.reach[axis] + 1)), allowance=allowance)
    name = f"sides {AXES[axis]}, near field of {strip.width} nodes"
    if sim.lattice.dim == 1 and strip.size > _WIDE:
        return _krylov_part(name, strip.sim, sim.crossing, allowance), []
    growths: dict[tuple[float, ...], Growth] = {}  # by tangential wavenumbers times spacing
    sample = list(strip.sample())
    for angles in sample:
        if growths and not allowance.take(strip.seconds):
            break
        growths[angles] = strip.growth(*angles)
    missed = (
        [f"sides {AXES[axis]} at {len(sample) - len(growths)} of {len(sample)} tangential wavenumbers"]
        if len(growths) < len(sample)
        else []
    )
    for angles in sorted(growths, key=lambda a: -growths[a].rate)[:2]:
        if growths[angles].stable:
            _climb(strip, angles, growths, allowance)
    worst = fastest(list(growths.values()))
    # a wider near field can be stable where a narrow one is not
    if worst.stable is False and strip.width < nodes and strip.size < _WIDE:
        strip = Strip(sim, axis, min(nodes, strip.width + (_WIDE - strip.size) // 2))
        growths |= {angles: strip.growth(*angles) for angles, growth in growths.items() if growth.stable is False}
        worst = fastest(list(growths.values()))
        name = f"sides {AXES[axis]}, near field of {strip.width} nodes"
    angles = next(a for a, g in growths.items() if g is worst)
    if angles:
        name += (
            f", tangential wavenumber times spacing {', '.join(f'{a:.3g}' for a in angles)}"
            if worst.stable is not True
            else (f", {len(growths)} tangential wavenumber{'s' * (len(growths) > 1)}")
        )
    return ExaminedPart(name, worst, strip.profile(worst.mode) if worst.stable is False else np.zeros(0)), missed


def _climb(
    strip: Strip, angles: tuple[float, ...], growths: dict[tuple[float, ...], Growth], allowance: Allowance
) -> None:
    """Climb from a tangential wavenumber to a nearby maximum of the growth rate, axis by axis."""
    for number in range(len(angles)):
        step = np.pi / strip.coarse / 2
        while step > np.pi / strip.coarse / 10:
            before = angles
            for shift in (-step, step):
                angle = float(np.clip(before[number] + shift, strip.longest, np.pi))
                moved = (*before[:number], angle, *before[number + 1 :])
                if moved not in growths:
                    if not allowance.take(strip.seconds):
                        return
                    growths[moved] = strip.growth(*moved)
                if growths[moved].rate > growths[angles].rate:
                    angles = moved
            if angles == before:
                step /= 2


def _same_sides(sim: Examined, first: int, second: int) -> bool:
    """Whether the sides of two axes pose the same problem: same boundaries and same stencil."""
    alike = all(like_sides(sim, (first, side), (second, side)) for side in (-1, 1))
    return alike and sim.stencil.same_along(first, second)
