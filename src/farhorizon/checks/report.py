"""The report of `Simulation.check`: what is known about a set-up before a run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NotRequired

import numpy as np
from typing_extensions import TypedDict

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.chain_modes import LatticeMedium
from farhorizon.analysis.layers.reflection import LayerSide
from farhorizon.analysis.resolution import ENOUGH, Band, band, faded, gain_of_spectrum, gain_of_time, resolution
from farhorizon.analysis.stability import Allowance, step_seconds
from farhorizon.boundaries import Fixed, Side
from farhorizon.checks.arrival import Arrival
from farhorizon.checks.certificate import BUDGET, NOT_CERTIFIED, Certificate, CertificateFacts, certify, rate_text
from farhorizon.checks.examined import Examined, Timed
from farhorizon.checks.facts import (
    bond_rows,
    lattice_rows,
    layer_rows,
    mebibytes,
    metal_rows,
    side_rows,
    size_rows,
    wave_rows,
)
from farhorizon.checks.reduced_setups import Strip
from farhorizon.checks.run_cost import RunCost, extended_run_cost, layered, run_cost, seconds_near_breaking, two_digits
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.files.html import listed, preformatted, table
from farhorizon.geometry.lattice import AXES
from farhorizon.inputs.signals import Signal
from farhorizon.machine import one_blas_thread
from farhorizon.medium.stencil import BackwardWaves
from farhorizon.pictures.style import frequency_text, length_text

ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
_FINE = tuple(np.linspace(0, 85, 35).tolist())  # angles of the picture
LEAST = 5.0  # seconds that an examination may always take, however short the run
_OF_REFLECTION = 0.4  # fraction of the budget for predictions of reflection; the certificate has the rest
_HARDLY = 20.0  # a signal that lasts longer than this many runs has hardly begun by the end
_STEEP = 60.0  # degrees: waves at larger angles are few, and layers absorb them worst
_EXACT = 1e-14  # reflection below this is rounding error
_ROUNDING = 1e-14  # error of layers, relative to the largest value, below which it is that of sums
_MUCH = 1e-3  # amplitude that a layer of given thickness may reflect without a warning
_MUCH_OF_SPONGE = 0.05  # the same for a sponge, which needs many wavelengths
_FITS = 1e-6  # of a step, by which the end of a run may lie after the last one
_WORTH = 1.0  # savings in seconds that are worth a note
_MORE = "farhorizon check CASE.toml --details, in Python print(report.details)"
_SHORT = (
    "near field",
    "materials",
    "wave speeds",
    "wavelengths",
    "shortest wave",
    "dispersion",
    "front",
    "cheapest sides",
    "fitted",
    "time",
    "time near breaking",
    "time in all",
    "outputs",
)
_LONG = 30 * 86400.0  # runs of more seconds than this cause a warning


@dataclass(frozen=True)
class Reflections:
    """Predicted reflection of plane waves by a side."""

    sides: str  # names of the sides that are alike
    side: LayerSide | Strip  # the equations of a layer, or the map of any side
    tables: dict[float, np.ndarray] = field(default_factory=dict)  # (pairs, angles) by wavelength, the typical first

    @property
    def angles(self) -> tuple[float, ...]:
        """Angles of incidence in the tables; only normal incidence in 1D."""
        return ANGLES if self.side.medium.stencil.dim > 1 else ANGLES[:1]

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Types of the incoming and the reflected wave; for a scalar field, one pair without names."""
        types = self.side.types
        return tuple((incoming, reflected) for incoming in types for reflected in types)

    @property
    def diffusive(self) -> bool:
        """Whether these are diffusion waves."""
        return isinstance(self.side, LayerSide) and self.side.diffusive

    @property
    def drawn(self) -> tuple[float, ...]:
        """Wavelengths of the picture: for vectors, which have a curve for each pair, only the typical one."""
        return tuple(self.tables) if len(self.pairs) == 1 else tuple(self.tables)[:1]

    @one_blas_thread()
    def amplitudes(self, wavelength: float, angles: tuple[float, ...]) -> np.ndarray:
        """Amplitudes of the reflected waves, shape (pairs, angles); nan where there is no such wave."""
        types = self.side.types
        amplitudes = np.full((len(types), len(types), len(angles)), np.nan)
        for incoming, (i, angle) in itertools.product(range(len(types)), enumerate(angles)):
            try:
                reflected = self.side.reflections(wavelength, angle, incoming=types[incoming])
            except InputError:
                continue
            for name, amplitude in reflected.items():
                amplitudes[incoming, types.index(name), i] = abs(amplitude)
        return amplitudes.reshape(-1, len(angles))

    def rows(self) -> Iterator[tuple[tuple[str, str], float, np.ndarray]]:
        """Pair, wavelength and amplitudes over the angles, without pairs that never occur, such as SH to P in a plane
        of symmetry.
        """
        for number, pair in enumerate(self.pairs):
            if len(self.pairs) == 1 or any(
                np.nanmax(np.append(table[number], 0.0)) > _EXACT for table in self.tables.values()
            ):
                for wavelength in sorted(self.tables, reverse=True):
                    yield pair, wavelength, self.tables[wavelength][number]


def _nominal(sim: Examined, until: float) -> float:
    """Seconds of the steps of a run on a typical core."""
    nodes = float(sim.engine.size)
    return until / sim.dt * step_seconds(nodes * sim.stencil.weights.size)


class ReflectionFacts(TypedDict):
    """What a side sends back of one plane wave."""

    sides: str
    """Names of the sides, which are of the same kind."""
    incoming: NotRequired[str]
    """Type of the incident wave, for vector fields: P, S, SV or SH."""
    sent: NotRequired[str]
    """Type of the reflected wave, for vector fields."""
    wavelength: float
    """Wavelength of the incident wave."""
    angle: float
    """Angle of incidence, in degrees."""
    amplitude: float | None
    """Amplitude of the reflected wave relative to that of the incident wave; null if there is no such wave."""


class TunedFacts(TypedDict):
    """A certified boundary condition, and what it reflects."""

    boundary: str
    """The condition as written in a case file."""
    amplitude: float
    """Largest reflected amplitude at a flat side, of plane waves of amplitude 1."""
    angle: float
    """Largest angle of incidence for which this holds, in degrees."""
    certificate: CertificateFacts
    """Certificate of the case with this condition."""


class ReportFacts(TypedDict):
    """What is known about a case before it runs."""

    facts: dict[str, str]
    """Rows of the printed report, by name."""
    numbers: dict[str, float]
    """Numbers by name: the time step, its limit, memory, the duration of the run."""
    warnings: list[str]
    """What speaks against the run."""
    notes: list[str]
    """What is allowed, but worth knowing."""
    certificate: CertificateFacts | None
    """Whether the run is stable; null if this was not examined."""
    reflection: list[ReflectionFacts]
    """What the absorbing sides reflect, ordered by side, type, wavelength and angle."""
    tuned: NotRequired[TunedFacts]
    """With `--tune`, the condition that was found."""


@dataclass
class Report:
    """Facts about a set-up; `str` formats them as a page.

    Attributes
    ----------
    rows : list of (str, str)
        Name and value.
    warnings : list of str
    notes : list of str
        What is allowed, but worth knowing.
    certificate : Certificate
        Whether the complete update is stable.
    reflections : list of Reflections
        One for each kind of absorbing side.
    numbers : dict of str to float
        Values of the rows for use by programs: "dt", "step_limit", "seconds", "steps", "memory"; where bonds may
        break "seconds_near_breaking", if all were strained to half of that; for the extended
        domain relative to this run "extended_nodes", "extended_cost", "extended_memory", or for layers relative to this
        run on an extended domain "layer_nodes", "layer_cost", "layer_memory"; for layers chosen for these data
        "returned"; from `farhorizon check` "seconds_in_all".
    omitted : list of str
        What is missing from the tables.
    until : float
        End of the run; infinite if unknown.
    """

    rows: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    certificate: Certificate | None = None
    reflections: list[Reflections] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)
    omitted: list[str] = field(default_factory=list)
    until: float = np.inf

    @classmethod
    def of(
        cls,
        sim: Examined,
        until: float | None = None,
        budget: float | None = None,
        more: Sequence[tuple[str, str]] = (),
    ) -> Report:
        """Examine a simulation, see `Simulation.check`; the rows `more` are appended."""
        report = cls(until=np.inf if until is None else until)
        waves = content(sim, until)
        report._describe(sim, waves)
        sides = {AXES[axis] + "-+"[side > 0]: b for (axis, side), b in sim.sides.items() if b.stretched}
        in_space = not sim.incident and all(space is not None for space, _ in sim.sources)  # all that sends waves
        if sides and sides.keys() == sim.thickness.keys() and in_space:
            predicted = {name: layer.predicted for name, layer in sim.thickness.items()}
            kept = all(predicted[name] <= b.wanted(sim.model.target) for name, b in sides.items())
            if kept and max(predicted.values()) > _ROUNDING:  # else nothing has come back yet
                report.numbers["returned"] = max(predicted.values())
        if until is not None:
            report._cut_short(sim, until)
            report._estimate(sim, until)
        usual = BUDGET if until is None else min(BUDGET, max(LEAST, _nominal(sim, until)))
        if wavelengths := _wavelengths(sim, waves, until):
            report._predict(sim, wavelengths, Allowance(_OF_REFLECTION * usual if budget is None else np.inf))
        backward = report._backward(sim)
        report._certify(sim, backward, (1 - _OF_REFLECTION) * usual if budget is None else budget)
        if any(b.held is not None for b in sim.sides.values()) and sim.engine.layers:
            report.warnings.append("a Fixed side reflects")
        report.rows += more
        report.notes += [note for note in sim.notes if note not in sim.doubts]
        report.warnings += sim.doubts
        report.warnings += [text for recorder in sim.recorders for text in recorder.doubts]
        report.warnings += [text for wave in sim.incident for text in wave.passage.doubts]
        return report

    @property
    def refused(self) -> bool:
        """Whether `farhorizon run` refuses the set-up because it grows."""
        return self.certificate is not None and self.certificate.grows_within(self.until)

    @property
    def headline(self) -> str:
        """The report in one line: whether to run it, how long that takes, what comes back, whether it is stable."""
        count, numbers = len(self.warnings), self.numbers
        verdict = "run refuses it" if self.refused else f"{count} warning{'s' * (count > 1)}" if count else "fine"
        parts = []
        if "seconds_in_all" in numbers:
            parts.append(f"about {seconds(numbers['seconds_in_all'])} in all")
        elif "seconds" in numbers:
            parts.append(f"about {seconds(numbers['seconds'])} of steps")
        if numbers.get("seconds_near_breaking", 0.0) > 2 * numbers.get("seconds", 0.0):
            parts.append(f"up to {seconds(numbers['seconds_near_breaking'])} of steps near breaking")
        parts.append(mebibytes(numbers["memory"]))
        if "returned" in numbers:
            parts.append(f"layers reflect {numbers['returned']:.1g} of the largest value")
        elif (largest := self._largest_returned()) is not None:
            longer, most = largest
            apart = most > max(2 * longer, _MUCH)
            at_most = _decibels(longer if apart else most)
            parts.append(f"reflections of plane waves at most {at_most} dB up to {_STEEP:g} degrees")
            if apart:
                parts[-1] += f", of the shortest {_decibels(most)} dB"
        if self.certificate is not None:
            parts.append(self.certificate.in_words(self.until))
        return f"{verdict}: {', '.join(parts)}"

    def _largest_returned(self) -> tuple[float, float] | None:
        """Largest amplitudes that absorbing sides reflect of plane waves that are not grazing: for all but the shortest
        wave, where there are others, and for all waves; None if there are no such waves.
        """
        of_waves = [reflections for reflections in self.reflections if not reflections.diffusive]
        shortest = min((length for some in of_waves if len(some.tables) > 1 for length in some.tables), default=0.0)
        steep = [
            (length, table[..., np.array(some.angles) <= _STEEP].ravel())
            for some in of_waves
            for length, table in some.tables.items()
        ]
        amplitudes = [
            np.concatenate([np.zeros(0), *(values[np.isfinite(values)] for length, values in steep if length > least)])
            for least in (shortest, 0.0)
        ]
        return None if not amplitudes[1].size else (amplitudes[0].max(initial=0.0), amplitudes[1].max())

    def _predict(self, sim: Examined, wavelengths: tuple[float, ...], allowance: Allowance) -> None:
        """Predict the reflection by each kind of absorbing side, the typical wave first; note what was omitted."""
        for names, side in _sides(sim):
            reflections = Reflections(names, side)
            for wavelength in wavelengths:
                if not allowance.take(len(reflections.angles) * side.seconds) and reflections.tables:
                    self.omitted.append(
                        f"the reflection of waves of length {wavelength:.3g} by {names} is not predicted: a larger "
                        "budget (--budget) includes it"
                    )
                else:
                    reflections.tables[wavelength] = reflections.amplitudes(wavelength, reflections.angles)
            self.reflections.append(reflections)
            boundary = sim.sides[AXES.index(names[0]), 1 if names[1] == "+" else -1]
            # for layers chosen for the data of the run, more is known than plane waves show
            if not reflections.diffusive and "returned" not in self.numbers:
                self._doubt(reflections, boundary, boundary.wanted(sim.model.target))

    def _doubt(self, reflections: Reflections, boundary: Side, target: float) -> None:
        """Warn of a side that reflects much of what it absorbs best: typical waves at normal incidence."""
        wavelength, table = next(iter(reflections.tables.items()))
        amplitude = float(np.nanmax(np.append(table[:, 0], 0.0)))
        most = _MUCH_OF_SPONGE if boundary.damped else _MUCH if boundary.nodes is not None else 10 * target
        if amplitude > most:
            aim = "" if boundary.nodes is not None else f", but the target is {target:g}"
            waves = f"waves of length {wavelength:.3g} along the normal"
            remedy = "a kernel of shorter reach, a Sponge of several wavelengths, or in 1D Exact"
            if boundary.damped:
                remedy = "several wavelengths of them, or a LatticePML"
            self.warnings.append(
                f"{reflections.sides} reflect {amplitude:.1g} of {waves}{aim}; use more nodes, {remedy}"
            )

    def _say(self, name: str, value: str) -> None:
        self.rows.append((name, value))

    def _describe(self, sim: Examined, waves: Band | None) -> None:
        """Add sizes, time step, layers and memory."""
        self.rows += [*lattice_rows(sim), *wave_rows(sim, waves)]
        arrival = None if sim.model.order == 1 or sim.stencil.strongest_reaction else Arrival.of(sim, waves)
        if arrival is not None:
            self._arrive(arrival)
        self._resolve(sim, arrival)
        self.rows += [*layer_rows(sim, waves), *side_rows(sim), *metal_rows(sim), *size_rows(sim), *bond_rows(sim)]
        self.numbers |= {"dt": sim.dt, "step_limit": sim.step_limit, "memory": float(sim.engine.nbytes)}

    def _arrive(self, arrival: Arrival) -> None:
        """Say how late waves arrive at what is observed, and note it if that is visible in a trace."""
        self._say("dispersion", arrival.in_words)
        self.numbers |= {"phase_cycles": arrival.cycles}
        if arrival.error is not None:
            self.numbers |= {"trace_error": arrival.error}
        if arrival.visible:
            self.notes.append(f"the dispersion of stencil and step is visible: {arrival.in_words}")

    def _resolve(self, sim: Examined, arrival: Arrival | None) -> None:
        """Say how many nodes the shortest wave of the signals has in the slowest medium, and warn of too few."""
        if sim.model.order == 1 or not sim.signals:
            return
        key, signal = max(sim.signals, key=lambda named: named[1].highest_frequency)
        highest = signal.highest_frequency
        if not np.isfinite(highest):
            self.warnings.append(f"{key} contains all frequencies, but the lattice carries only some of them")
            return
        rate = sim.model.coefficient * sim.weakest / sim.lattice.spacing**2
        scheme: Any = sim.model.integrator
        shortest = resolution(sim.stencil.beside(sim.weakest), rate, sim.dt, highest, scheme)
        resolving = shortest.scale * sim.lattice.spacing
        nodes = f"{shortest.nodes:.3g} nodes" if shortest.nodes else "shorter than the lattice carries"
        self._say("shortest wave", f"{nodes}, at {frequency_text(highest)}; a thousandth of {key} lies above")
        self.numbers |= {"shortest_wave_nodes": shortest.nodes, "resolving_spacing": resolving}
        if shortest.nodes < ENOUGH:
            finer = "" if arrival is None else arrival.on_finer(shortest.scale)
            spacing = f"spacing = {resolving:.2g}"
            self.warnings.append(
                f"the shortest waves of {key} are badly resolved ({nodes}, but {ENOUGH:g} are needed): {spacing} "
                f"resolves them, with as many spacings per horizon as here{finer}"
            )

    def _cut_short(self, sim: Examined, until: float) -> None:
        """Say which signals continue after the end of the run; if one hardly begins, its unit of time may be wrong."""
        for key, signal in sim.signals:
            if signal.end > until:
                remarks = self.warnings if signal.end > _HARDLY * until else self.notes
                remarks.append(
                    f"{key} continues to t = {signal.end:.4g}, but the run ends at {until:.4g}: the rest is not sent; "
                    "does it use the unit of time of the run?"
                )

    def _estimate(self, sim: Examined, until: float) -> None:
        """Estimate the time of the run, and of one on a domain so large that nothing returns."""
        steps = int(np.ceil(until / sim.dt - _FITS))
        as_given = run_cost(sim, self.estimate(sim, steps, until) / steps)
        breaks = sim.model.bond_law is not None and np.isfinite(sim.engine.bonds.limit)
        if breaks and sim.lattice.dim > 1:
            most = max(seconds_near_breaking(sim), as_given.seconds)
            self.numbers["seconds_near_breaking"] = most * steps
            ratio = two_digits(most / as_given.seconds)
            self._say(
                "time near breaking",
                f"up to {seconds(most * steps)}: a step takes {ratio} times as long while all bonds are strained to "
                "half of what breaks them",
            )
        if any(b.extended for b in sim.sides.values()):
            self._compare_with_layer(sim, as_given, until, steps)
            return
        if not sim.targets:
            return
        extended = extended_run_cost(sim, until, list(sim.targets))
        self._say(
            "extended domain",
            f"{extended.nodes:.3g} nodes until nothing returns, "
            f"{extended.nodes / np.prod(sim.lattice.shape):.3g} near fields: {extended.over(as_given)} of this run",
        )
        self.numbers |= {
            "extended_nodes": extended.nodes,
            "extended_cost": extended.seconds / as_given.seconds,
            "extended_memory": extended.memory / as_given.memory,
        }
        layers = "; layers save more in longer runs and in 3D" if sim.engine.layers else ""
        self._recommend(as_given, "extended", extended, steps, layers)

    def _compare_with_layer(self, sim: Examined, as_given: RunCost, until: float, steps: int) -> None:
        """Compare time and memory with those of layers in place of the extended domain."""
        try:
            twin = layered(sim, until)
        except InputError as error:
            self._say("layers instead", str(error))
            return
        with_layers = run_cost(twin)
        thickest = max(layer.columns for layer in twin.engine.layers.values())
        self._say("layers instead", f"of {thickest} nodes: {with_layers.over(as_given)} of this run")
        self.numbers |= {
            "layer_nodes": float(thickest),
            "layer_cost": with_layers.seconds / as_given.seconds,
            "layer_memory": with_layers.memory / as_given.memory,
        }
        self._recommend(as_given, "lattice-pml", with_layers, steps)

    def _recommend(self, as_given: RunCost, kind: str, instead: RunCost, steps: int, when: str = "") -> None:
        """Say which sides that keep the target are cheapest, and note savings that are worth it."""
        ratio, saved = instead.seconds / as_given.seconds, (as_given.seconds - instead.seconds) * steps
        if ratio >= 1:
            self._say("cheapest sides", f"as given; {kind} would take {two_digits(ratio)} times as long")
            return
        self._say("cheapest sides", f'type = "{kind}", {ratio:.2g} of the time of the steps{when}')
        if saved > _WORTH:
            self.notes.append(f'type = "{kind}" would save {seconds(saved)} of steps')

    def estimate(self, run: Timed, steps: int, until: float) -> float:
        """Say how long a run takes, return it in seconds, and warn if it is longer than anyone can intend."""
        duration = run.seconds_per_step() * steps
        self._say("time", f"about {seconds(duration)} for {steps} steps to t = {until:g}")
        self.numbers |= {"steps": float(steps), "seconds": duration}
        if duration > _LONG:
            self.warnings.append(
                f"the run would take about {seconds(duration)}: compare until = {until:g} with dt = {run.dt:.3g}, and "
                "check the units of speed, spacing and time"
            )
        return duration

    def _backward(self, sim: Examined) -> BackwardWaves:
        backward = sim.stencil.backward_waves()
        self._say(
            "backward waves",
            f"{100 * backward.fraction:.3g} % of the Brillouin zone from |k| spacing = {backward.first_wavenumber:.3g}"
            if backward
            else "none",
        )
        return backward

    def _certify(self, sim: Examined, backward: BackwardWaves, budget: float) -> None:
        self.certificate = certificate = certify(sim, budget, self.until, brief=False)
        self._say("stability", certificate.in_full(self.until))
        if certificate.verdict == NOT_CERTIFIED:
            self.warnings.append(f"the run is not stable: {certificate.reason}. {_remedy(sim, backward)}")
        elif remark := certificate.remark(self.until):
            self.warnings.append(remark)

    def as_json(self) -> ReportFacts:
        """Facts, numbers, warnings, notes, the certificate and the reflections as plain data."""
        rows = [
            _reflection_facts(some.sides, pair, wavelength, angle, value)
            for some in self.reflections
            for pair, wavelength, amplitudes in some.rows()
            for angle, value in zip(some.angles, amplitudes, strict=True)
        ]
        certificate = None if self.certificate is None else self.certificate.as_json()
        return {
            "facts": dict(self.rows),
            "numbers": self.numbers,
            "warnings": self.warnings,
            "notes": [*self.notes, *self.omitted],
            "certificate": certificate,
            "reflection": rows,
        }

    def draw(self, folder: Path, name: str, spacing: float) -> list[Path]:
        """Draw pictures into a folder: NAME-growing-mode.png where a mode grows, NAME-reflection.png where sides absorb
        waves.
        """
        from farhorizon.pictures.curves import reflection_picture
        from farhorizon.pictures.fields import mode_picture

        made = []
        worst = None if self.certificate is None else self.certificate.worst
        if self.certificate is not None and worst is not None and worst.field.size:
            made.append(folder / f"{name}-growing-mode.png")
            growth = f"grows by {rate_text(worst.growth.rate, self.certificate.crossing)}"
            mode_picture(worst.field, spacing, growth, made[-1])
        curves = [
            (
                ", ".join([*_named_pair(pair), f"wavelength {length_text(wavelength)}"])
                + f", {some.sides}" * (len(self.reflections) > 1),
                amplitudes,
            )
            for some in self.reflections
            if len(some.angles) > 1
            for wavelength in some.drawn
            for pair, amplitudes in zip(some.pairs, some.amplitudes(wavelength, _FINE), strict=True)
            if np.nanmax(np.append(amplitudes, 0.0)) > _EXACT
        ]
        if curves:
            made.append(folder / f"{name}-reflection.png")
            kind = "diffusion waves" if self.reflections[0].diffusive else "plane waves"
            sides = "an absorbing side" if len(self.reflections) > 1 else self.reflections[0].sides
            reflection_picture(np.array(_FINE), curves, f"{kind} reflected by {sides}", made[-1])
        return made

    def _reflection_lines(self) -> list[str]:
        lines = []
        for some in self.reflections:
            kind = "diffusion waves, most of which decay on the way," if some.diffusive else "plane waves"
            lines.append(f"predicted reflection by {some.sides} in dB, for {kind} by their angle to the normal")
            lines.append(f"{'wavelength':>18}" + "".join(f"{f'{a:g} deg':>9}" for a in some.angles))
            for pair, wavelength, amplitudes in some.rows():
                label = "  ".join([*_named_pair(pair), f"{wavelength:.3g}"])
                lines.append(f"{label:>18}" + "".join(f"{_decibels(v):>9}" for v in amplitudes))
        return lines

    @property
    def details(self) -> str:
        """The complete page, with all facts and tables."""
        notes = [f"note: {text}" for text in (*self.notes, *self.omitted)]
        return "\n".join([*self._head(), *_columns(self.rows), *self._reflection_lines(), *notes])

    def _head(self) -> list[str]:
        """The headline, and the warnings or that there is nothing to do."""
        return [self.headline, *([f"warning: {text}" for text in self.warnings] or ["to do: nothing, run it"])]

    def _repr_html_(self) -> str:
        lines = [*self._head()[1:], *(f"note: {text}" for text in (*self.notes, *self.omitted))]
        return table(self.rows, self.headline) + preformatted("\n".join(self._reflection_lines())) + listed(lines)

    def __str__(self) -> str:
        rows = [row for row in self.rows if row[0] in _SHORT]
        notes = [f"note: {text}" for text in self.notes]
        return "\n".join([*self._head(), *_columns([*rows, ("tables", _MORE)]), *notes])


def _columns(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Lines of names and values, in aligned columns."""
    width = max(len(name) for name, _ in rows)
    return [f"{name:<{width}}  {value}" for name, value in rows]


def _reflection_facts(
    sides: str, pair: tuple[str, str], wavelength: float, angle: float, amplitude: float
) -> ReflectionFacts:
    facts: ReflectionFacts = {
        "sides": sides,
        "wavelength": wavelength,
        "angle": angle,
        "amplitude": float(amplitude) if np.isfinite(amplitude) else None,
    }
    return {**facts, "incoming": pair[0], "sent": pair[1]} if pair[0] else facts


def content(sim: Examined, until: float | None = None) -> Band | None:
    """Wavelengths in initial data and sources, as far as these separate into space and time; None if there are none.

    The frequencies of a source restrict them where it is a signal or the end of the run is known. Nodes with prescribed
    values emit waves according to their time function; its initial value does not count as a wave as short as a node.
    """
    waves = sim.model.order == 2
    rate = np.sqrt(sim.model.coefficient * max(sim.strongest, 1e-300)) / sim.lattice.spacing
    # fields of the lattice, the order of the time derivative whose initial data they are, gain by wavenumber
    fields: list[tuple[np.ndarray, int, Callable[[np.ndarray], np.ndarray] | None]] = [
        (sim.start_u, sim.model.order - 1, None),
        (sim.start_v, 0, None),
    ]
    lowest = float(np.linalg.eigvalsh(np.atleast_2d(sim.engine.reaction))[0])
    if waves and sim.prescribed.driven:
        start = np.array(sim.start_u)
        fields[0] = (start, 1, None)
        for nodes, time_function in sim.prescribed.driven:
            start.flat[nodes] = 0.0
            if until is not None:
                emitter = np.zeros(start.shape)
                emitter.flat[nodes] = 1.0
                fields.append((emitter, 1, gain_of_time(time_function, until, rate, lowest)))
    for space, factor in sim.sources:
        if space is not None:
            fields.append((space, 0, _gain(factor, until, rate, lowest) if waves else None))
    scalars = [(part, order, gain) for field, order, gain in fields for part in field.reshape(-1, *sim.lattice.shape)]
    free = [(not sim.sides[axis, -1].bonded, not sim.sides[axis, 1].bonded) for axis in range(sim.lattice.dim)]
    for wave in sim.incident:
        if wave.passage.everywhere:
            parts = wave.field(wave.passage.midway).reshape(-1, *sim.lattice.shape)
            scalars += [(faded(part, free), sim.model.order - 1, None) for part in parts]
    components, orders, gains = zip(*scalars, strict=True)
    return band(components, sim.lattice.spacing, orders, gains)


def _gain(
    factor: Callable[..., Any], until: float | None, rate: float, lowest: float
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Factor by which a time function weights its source's waves, if its spectrum or the end of the run is known."""
    if isinstance(factor, Signal):
        return gain_of_spectrum(factor.spectrum, until or factor.end, rate, lowest)
    return None if until is None else gain_of_time(factor, until, rate, lowest)


def _wavelengths(sim: Examined, waves: Band | None, until: float | None) -> tuple[float, ...]:
    """Wavelengths for which reflection is predicted, the typical one first; for diffusion those of given periods, where
    the period is ``length^2 / (4 pi diffusivity)``.

    Diffusion is as slow as the run is long, so the periods are that of the run (ten times that in which the near field
    empties, if it is not known), the time in which the near field empties, and a tenth of it.
    """
    if sim.model.order == 2:
        return () if waves is None else tuple(dict.fromkeys((waves.typical, waves.shortest, waves.longest)))
    half = float((sim.lattice.upper - sim.lattice.lower).max()) / 2
    emptied = half**2 / sim.model.coefficient
    periods = (10 * emptied if until is None else until, emptied, emptied / 10)
    return tuple(dict.fromkeys(float(2 * np.sqrt(np.pi * sim.model.coefficient * period)) for period in periods))


def _sides(sim: Examined) -> list[tuple[str, LayerSide | Strip]]:
    """One absorbing side of each kind, with the names of all sides of that kind."""
    kinds: list[tuple[Any, list[str], LayerSide | Strip]] = []  # what makes sides alike, their names, one of them
    for (axis, side), boundary in sim.sides.items():
        if not (boundary.stretched or (boundary.damped and sim.model.order == 2)):
            continue
        name, reach = AXES[axis] + "-+"[side > 0], sim.stencil.reach[axis]
        layer = sim.engine.layers.get((3 - sim.lattice.dim + axis, side))
        stretch = boundary if layer is None else [layer.kappa.tolist(), layer.sigma.tolist(), layer.alpha.tolist()]
        for kind, names, _ in kinds:
            if kind == (stretch, reach):
                names.append(name)
                break
        else:
            ends = (Fixed(), boundary)
            alone = _layer_side(sim, axis, side, layer) if layer else Strip(sim, axis, 2 * reach + 2, ends)
            kinds.append(((stretch, reach), [name], alone))
    return [(", ".join(names), alone) for _, names, alone in kinds]


def _layer_side(sim: Examined, axis: int, side: int, layer: Layer) -> LayerSide:
    waves, coefficient = sim.model.order == 2, sim.coefficients[axis, side]
    recursion = Recursion.of(sim.model.integrator, sim.dt, sim.model.damping) if waves else Recursion(0.0, sim.dt, 1.0)
    stencil = sim.stencil.along(axis).beside(coefficient / sim.model.coefficient)
    return LayerSide(LatticeMedium(stencil, coefficient, sim.lattice.spacing, recursion, sim.dt), layer, not waves)


def _remedy(sim: Examined, backward: BackwardWaves) -> str:
    """Advice about growth in a layer."""
    if sim.closure is not None:
        poles = " Single nodes at the poles of a window grow; a radius of no whole number of spacings avoids them."
        calmer = {boundary.calmer() for boundary in sim.sides.values() if boundary.closing} - {""}
        scalar = ["Higdon(angles=(0, 45))", "settings that 'check --tune' finds"] * (sim.stencil.components == 1)
        return f"Use {', '.join([*sorted(calmer), *scalar, 'or a LatticePML'])}.{poles if sim.lattice.window else ''}"
    exact = "Exact ends, or " if sim.lattice.dim == 1 else ""
    if not backward:
        return f"Use {exact}a thicker layer or one with a gentler profile, a smaller step, or a Sponge."
    kernel = (
        "exponent 2 with a reach of at most 3 nodes"
        if sim.lattice.dim < 3
        else "exponent 2 with the linear influence function"
    )
    return (
        f"The stencil has backward waves, which grow in the layer, by up to {backward.growth:.2g} sigma per unit "
        "time, from rounding or noise. "
        f"Use {exact}a Sponge of several wavelengths, or {kernel}; or keep the data smooth and the run short."
    )


def _named_pair(pair: tuple[str, str]) -> list[str]:
    """The incoming and the reflected type in words; empty for scalar fields."""
    return [f"{pair[0]} to {pair[1]}"] if pair[0] else []


def _decibels(amplitude: float) -> str:
    """An amplitude in decibels; "none" where there is no such wave."""
    if not np.isfinite(amplitude):
        return "none"
    return f"{round(20 * np.log10(amplitude))}" if amplitude > _EXACT else f"< {20 * np.log10(_EXACT):.0f}"


def seconds(duration: float) -> str:
    """A duration in words."""
    for unit, length in (("years", 31557600.0), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if duration >= 2 * length:
            return f"{two_digits(duration / length)} {unit}"
    return f"{two_digits(duration)} s"
