"""Sources, loads and incident waves of a run, as functions of space times functions of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.impactors import Impactor
from farhorizon.inputs.incidence import Incidence, Incident, medium_outside, standing_on
from farhorizon.inputs.loads import Traction, force_density
from farhorizon.inputs.local_sources import LocalSource
from farhorizon.inputs.pressure import Pressure, pressing_force
from farhorizon.inputs.signals import SMALL, Signal
from farhorizon.inputs.sources import Source, as_source, by_component, largest_component, space_and_time, split, steady
from farhorizon.inputs.thermal_loads import ThermalLoad
from farhorizon.medium.integrators import Verlet
from farhorizon.medium.of_field import OfField
from farhorizon.medium.stratified_medium import Strata, StratifiedMedium
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, Setup, Sides, keys, side_name
from farhorizon.simulation.sides.exterior import Exterior
from farhorizon.simulation.time.outer_loop import warn

# samples of a factor of time for its largest value: how many, the steps that count as early, and the last step
_LOOKS, _SOON, _LAST = 512, 2**10, 2**16
_THIN = 32  # nodes along an axis on which a source that does not split is sampled
# samples of a factor of time between two steps, and the largest number of steps that are sampled; in so many steps it
# has to deviate from a straight line, by this fraction of its size, to count as undersampled
_BETWEEN, _STEPS, _BENT, _OFF = 8, 4096, 3, 0.25
_HELD = 4  # number of first samples over which a load that may begin with a jump is constant

SourceTerm = tuple[np.ndarray | None, Callable[..., Any]]


@dataclass(frozen=True)
class SourceTerms:
    """Sources and loads of a run."""

    # (space, time) of each source, for vector fields of each of its components, as from
    # `farhorizon.inputs.sources.split`
    sources: list[SourceTerm]
    # sources that do not split into space and time, as functions of the coordinates and t
    unsplit: list[Callable[..., Any]]


class SourceChecks:
    """Checks over the length of a run: of sources that do not split into space and time, functions of the coordinates
    and t, beyond the absorbing sides; and of the factors of time in `time_histories`, by name, which the steps have to
    resolve.
    """

    def __init__(
        self,
        sources: Sequence[Callable[..., Any]],
        exterior: Exterior,
        dt: float,
        time_histories: Sequence[tuple[str, Callable[[float], float]]] = (),
    ) -> None:
        self._sources, self._exterior, self._dt = sources, exterior, dt
        self._courses = [_FactorOfTime(key, time) for key, time in time_histories]
        self._looked = 0.0  # time up to which all has been checked
        self._peaks: dict[int, float] = {}

    def check(self, until: float) -> None:
        """Evaluate sources at up to 64 equidistant times, and factors of time between steps, from the time that has
        been checked before to a new one. For each factor that changes within a step, issue a `ValidityWarning` and a
        note, once. Raises InputError if the near field would miss more of a source than the side's target.
        """
        if until > self._looked:
            for course in self._courses:
                if text := course.doubt(self._looked, until, self._dt):
                    self._exterior.notes.append(text)
                    warn(text)
            times = np.linspace(self._looked, until, min(64, int(np.ceil((until - self._looked) / self._dt))) + 1)
            for number, source in enumerate(self._sources):
                self._peaks[number] = self._exterior.check_moving(source, times, self._peaks.get(number, 0.0))
            self._looked = until


class _FactorOfTime:
    """A factor of time, and what samples between steps have shown of it."""

    def __init__(self, key: str, time: Callable[[float], float]) -> None:
        self._key, self._time, self._over = key, time, False
        self._largest, self._bent, self._sums = np.zeros(2), 0, np.zeros(2)

    def doubt(self, since: float, until: float, dt: float) -> str:
        """Return, once, a warning if much of it between two times is not seen at the steps; otherwise an empty text."""
        first, last = int(since / dt), int(np.ceil(until / dt))
        shares = np.arange(_BETWEEN + 1) / _BETWEEN
        for step in np.unique(np.linspace(first, max(first, last - 1), min(_STEPS, last - first)).astype(int)):
            if self._over:
                break
            try:
                values = np.array([float(self._time(dt * (step + share))) for share in shares])
            except (ArithmeticError, LookupError, TypeError, ValueError, InputError):
                self._over = True  # a function need not be defined beyond its run
                break
            off = np.abs(values - values[0] - shares * (values[-1] - values[0]))
            self._largest = np.maximum(self._largest, [np.abs(values).max(), np.abs(values[[0, -1]]).max()])
            self._bent += int(off.max() > _OFF * self._largest[0])
            self._sums += (off**2).sum(), (values**2).sum()
        between, at = self._largest
        bent = self._bent >= _BENT and self._sums[0] > _OFF**2 * self._sums[1]
        if self._over or not (between > 2 * at or bent):
            return ""
        self._over = True
        seen = f"it is up to {between:.3g} between them, {at:.3g} at them" if between > 2 * at else "they alias it"
        return (
            f"{self._key} changes within the steps of {dt:.3g}: {seen}, but the run uses only its values at the steps; "
            "use a shorter dt, or a slower function of time"
        )


def given(setup: Setup, near: NearField, sides: Sides) -> list[tuple[str, Any]]:
    """Return the sources other than incident waves, and the loads as sources, each with its name in messages; local
    sources are replaced by their values on nodes.
    """
    plain, cuts = _plain(setup), [crack.cut for crack in setup.cracks]
    sources = [
        (key, part)
        for key, source in zip(keys("source", plain), plain, strict=True)
        for part in (
            source.placed(near.lattice, near.stencil.components, key, cuts)
            if isinstance(source, LocalSource)
            else [source]
        )
    ]
    loads = [
        (f"load[{i}]", _of_load(load, setup, near, sides, f"load[{i}]"))
        for i, load in enumerate(setup.loads)
        # no force, see `farhorizon.simulation.heat.thermal_strains`, or one that depends on the field
        if not isinstance(load, ThermalLoad | Impactor)
    ]
    return sources + loads


def _plain(setup: Setup) -> list[Any]:
    """Return the sources other than incident waves and those that depend on the field."""
    return [source for source in setup.sources if not isinstance(source, Incident | OfField)]


def signals(setup: Setup) -> list[tuple[str, Signal]]:
    """Return the signals with known spectra of sources, incident waves, loads and prescribed nodes, each with its name
    in messages.
    """
    waves = [source for source in setup.sources if isinstance(source, Incident)]
    named = [("source", _plain(setup)), ("incident", waves), ("load", setup.loads), ("constraint", setup.constraints)]
    timed = [
        (f"{key}.{name}", part)
        for table, given in named
        for key, source in zip(keys(table, given), given, strict=True)
        for name in ("time", "signal", "value", "velocity")
        for part in _entries(getattr(source, name, None))
    ]
    return [(key, time) for key, time in timed if isinstance(time, Signal)]


def _entries(given: Any) -> list[Any]:
    """Return the entries of a list, one for each component, or a list of a single given value."""
    return given if isinstance(given, list) else [given]


def check_signals(setup: Setup, near: NearField) -> None:
    """Raise InputError for a signal with half of its amplitude above the highest frequency of the lattice, and for the
    factor of time of a local source that varies, but does not begin at rest.
    """
    if near.model.order == 1:
        return
    plain = _plain(setup)
    for key, source in zip(keys("source", plain), plain, strict=True):
        time = getattr(source, "time", None) if isinstance(source, LocalSource) else None
        if time is not None and not isinstance(time, Signal):
            _check_rest(time, near.dt, f"{key}.time")
    limit = float(np.arcsin(min(1.0, np.sqrt(near.rate_limit) * near.dt / 2)) / (np.pi * near.dt))
    for key, signal in signals(setup):
        if signal.median_frequency > limit:
            raise InputError(
                "half of the signal's amplitude lies at frequencies that the lattice does not carry",
                value=f"from {signal.median_frequency:.4g} cycles per time on",
                limit=f"{limit:.4g}",
                key=key,
                remedy="a lower frequency in the units of the run, or a finer lattice",
            )


def _check_rest(time: Callable[[float], Any], dt: float, key: str) -> None:
    """Raise InputError for a factor of time that is changing at the start and not small there."""
    share = jump_of(time, dt, key)
    if share > SMALL:
        raise InputError(
            "the signal does not begin at rest: the run would start with a jump",
            value=f"{share:.3g} of its largest value at t = 0",
            limit=f"{SMALL:g}",
            key=key,
            remedy="a Ricker, a ToneBurst or another signal, or an expression that is 0 at t = 0; a load that is put "
            "on at once and held, as 1 or where(t < 2, 1, 0), may begin with a jump",
        )


def jump_of(time: Callable[[float], Any], dt: float, key: str) -> float:
    """Return the magnitude of a factor of time at the start as a share of the largest; 0 if it begins at rest.

    A load that is applied at once and held, which has the same value over the first steps, such as a constant or a
    rectangular pulse, also counts as beginning at rest: its jump is intended. The jump of a changing factor is the cut
    through a signal that began earlier, most often one whose delay was forgotten. The initial value also counts as
    small if it is negligible relative to much later values.
    """
    first = [float(kinds.array(time(t), key, shape=())) for t in dt * np.arange(_HELD)]
    start = abs(first[0])
    if start == 0 or np.ptp(first) == 0:
        return 0.0
    largest = 0.0
    for step in np.unique(np.geomspace(1, _LAST, _LOOKS).astype(int)):
        try:
            value = abs(float(kinds.array(time(dt * step), key, shape=())))
        except (ArithmeticError, LookupError, ValueError):  # a function need not be defined beyond its run
            break
        largest = max(largest, start, value)
        if start <= (SMALL if step <= _SOON else SMALL**2) * largest:
            return 0.0
    return start / max(largest, start)


def jumps(setup: Setup, near: NearField) -> list[str]:
    """Return notes on sources and loads other than local ones that begin with a jump and keep changing; none for
    diffusion. They are not refused: a point emits waves of all lengths, the shortest of which a jump in time makes
    large, but a shape emits none that are shorter than itself.
    """
    if near.model.order == 1:
        return []
    shares = {
        key: max([jump_of(time, near.dt, key) for time in _factors(source, near)], default=0.0)
        for key, source in _named(setup)
        if not isinstance(source, LocalSource)
    }
    return [
        f"{key} begins with a jump, {share:.3g} of its largest value at t = 0, and keeps changing: the waves that it "
        "emits are as short as its shape; a signal that is cut there needs a delay"
        for key, share in shares.items()
        if share > SMALL
    ]


def time_histories(setup: Setup, near: NearField) -> list[tuple[str, Callable[[float], float]]]:
    """Return the factors of time of sources and loads whose spectra are not known, each with its name in messages; for
    a source that does not split, its largest value on some of the nodes.
    """
    return [(key, time) for key, source in _named(setup) for time in _factors(source, near)]


def _named(setup: Setup) -> list[tuple[str, Any]]:
    """Return sources, and loads as sources with their factors of time, each with its name in messages."""
    plain = _plain(setup)
    loads = [(f"load[{i}]", Source(1.0, load.time)) for i, load in enumerate(setup.loads) if hasattr(load, "time")]
    return [*zip(keys("source", plain), plain, strict=True), *loads]


def _factors(source: Any, near: NearField) -> list[Callable[[float], float]]:
    """Return the factors of time of the parts of a source, apart from signals."""
    if isinstance(source, LocalSource):
        time = getattr(source, "time", None)
        return [time] if callable(time) and not isinstance(time, Signal) else []
    times: list[Callable[[float], float]] = []
    for part, _ in by_component(source, near.lattice, near.stencil.components):
        space, time = space_and_time(part)
        if space is None:
            axes = [axis[:: -(-axis.size // _THIN)] for axis in near.lattice.axes]
            times.append(partial(_largest_at, largest_component(time), np.meshgrid(*axes, indexing="ij")))
        elif time is not None and not isinstance(time, Signal):
            times.append(time)
    return times


def _largest_at(size: Callable[..., np.ndarray], at: Sequence[np.ndarray], t: float) -> float:
    return float(size(*at, t).max())


def _of_load(load: Any, setup: Setup, near: NearField, sides: Sides, key: str) -> Source:
    """Return a load as a source, its force per volume."""
    lattice = setup.lattice
    if isinstance(load, Traction):
        value: Any = force_density(load, lattice, sides, key)
    elif isinstance(load, Pressure):
        periodic = {axis: sides[axis, -1].periodic for axis in range(lattice.dim)}
        value = pressing_force(load, lattice, near.model, setup.cracks, setup.rim, periodic, key)
    else:
        value = list(load.value)
    source: Source = as_source(Source(value, load.time or steady), lattice.dim, f"{key}.value")
    return source


def ends_of(sides: Sides) -> dict[Key, bool]:
    """Return the sides at which the medium ends, and whether each is a free surface."""
    return {key: not b.bonded for key, b in sides.items() if not (b.endless or b.periodic)}


def incident_waves(
    setup: Setup, near: NearField, sides: Sides, cuts: Sequence[Cut], team: ProcessGroup = ALONE
) -> list[Arriving]:
    """Return the incident waves, each with its box and the medium outside it; `sides` are those of the whole. Raises
    InputError for an unsuitable box, a medium in which no such wave travels, or one that scatters outside the box.
    """
    ends = ends_of(sides)
    waves = [source for source in setup.sources if isinstance(source, Incident)]
    return [_arriving(wave, near, ends, cuts, setup.bond_rule, team) for wave in waves]


class Arriving(NamedTuple):
    """An incident wave on its way to a near field."""

    wave: Incident  # the wave with its box
    factor: float  # factor on the bonds outside the box; 1 if there are strata
    free: list[Key]  # free sides
    known: list[Key]  # the free sides on which the box stands
    strata: StratifiedMedium | None  # strata outside the box


def split_source_terms(sources: Sequence[tuple[str, Any]], near: NearField, exterior: Exterior) -> SourceTerms:
    """Return sources as functions of space times functions of time if they split; raises InputError if the near field
    would miss a part of a source.
    """
    source_terms = SourceTerms([], [])
    for key, source in sources:
        for part, unit in by_component(source, near.lattice, near.stencil.components):
            source_terms.sources.append(_split_part(part, unit, key, near, exterior, source_terms.unsplit))
    return source_terms


def _split_part(
    source: Any, unit: Any, key: str, near: NearField, exterior: Exterior, unsplit: list[Callable[..., Any]]
) -> SourceTerm:
    """Split one part of a source, to be multiplied with `unit`; the part is a scalar if that is a unit vector."""
    space, time = space_and_time(source)
    as_given = np.ndim(unit) == 0
    values, moment = split(source, near.lattice, near.stencil.components if as_given else 1)
    if space is None or values is None:
        unsplit.append(near.function(time))
        return None, lambda t: unit * moment(t)
    if isinstance(space, np.ndarray):
        exterior.check_values(near.size(values) if as_given else values, key)
    else:
        peak = float(np.abs(values if near.closed is None else values[near.closed]).max(initial=0))
        exterior.check_function(near.function(space), peak, key, missed="source value")
    return unit * values, moment


def incident_wave_notes(incident: Sequence[Incidence], until: float) -> list[str]:
    """Return notes on incident waves in a run to a time; issue a `ValidityWarning`, once, for what makes them doubtful.
    Raises InputError for a wave that is not known for so long.
    """
    notes = []
    for wave in incident:
        told = wave.passage.doubts
        notes += wave.passage.foresee(until)
        for text in wave.passage.doubts:
            if text not in told:
                warn(text)
    return notes


def scheme_of(near: NearField, factor: float) -> Scheme:
    """Return the medium of the near field, with bonds multiplied by a factor, and its time integration."""
    rate = factor * near.model.coefficient / near.lattice.spacing**2
    return Scheme.of(near.stencil.beside(factor), rate, near.model.integrator, near.dt, near.model.damping)


def _arriving(
    wave: Incident, near: NearField, ends: dict[Key, bool], cuts: Sequence[Cut], rule: str, team: ProcessGroup
) -> Arriving:
    lattice, model = near.lattice, near.model
    if not isinstance(model.integrator, Verlet) or (model.damping and wave.undamped):
        raise InputError(
            "an incident wave needs an undamped medium of second order in time"
            if wave.undamped
            else "an incident wave needs a medium of second order in time",
            value=type(model).__name__,
            key="incident",
            limit="Wave or Elastic with damping = 0" if wave.undamped else "Wave or Elastic",
            remedy="a source, or initial data",
        )
    free = [key for key, is_free in ends.items() if is_free]
    constants = near.constants

    def found(reach: Sequence[int]) -> tuple[Incident, float | tuple[int, np.ndarray]]:
        placed = wave.resolved(lattice.whole, reach, ends)
        return placed, medium_outside(placed, lattice, reach, cuts, near.material, constants, free, team.gather)

    placed, medium = found(near.stencil.reach)
    if isinstance(medium, tuple) and near.states is not None:  # the model's own stencil may have no states
        placed, medium = found(2 * np.abs(near.states.offsets).max(0))
    assert placed.within is not None
    known = standing_on(placed.within, lattice.whole, free)
    if not isinstance(medium, tuple):
        return Arriving(placed, medium, free, known, None)
    axis, rows = medium
    side = known[0] if known else (axis, wave.heads(axis))
    return Arriving(placed, 1.0, free, known, _strata(near, rule, rows, side, not known))


def _strata(near: NearField, rule: str, rows: np.ndarray, end: Key, continued: bool) -> StratifiedMedium:
    """Return a medium with given constants of the rows of the near field along an axis, down from one of its ends; if
    it is continued beyond this end, the first rows are beyond it, as far as forces reach, and like the last one there.
    """
    (axis, side), beyond = end, 0
    rows = rows if side < 0 else rows[::-1]
    if continued:
        beyond = near.stencil.reach[axis] if near.states is None else 2 * int(np.abs(near.states.offsets).max())
        rows = np.concatenate([np.repeat(rows[:1], beyond, axis=0), rows])
    differ = np.flatnonzero((rows != rows[-1]).any(1))
    rows = rows[: differ[-1] + 2]
    moduli = None if near.variation.moduli is None else rows[:, 2:]
    strata = Strata(rows[:, 0], rows[:, 1], moduli, rule if moduli is None else "arithmetic")
    edge = -beyond if side < 0 else near.lattice.whole.shape[axis] - 1 + beyond
    return StratifiedMedium(near.stencil, axis, side, edge, near.states, strata, continued)


def incidence(arriving: Arriving, near: NearField, sides: Sides, notes: list[str]) -> Incidence:
    """Return the incidence that joins the total field inside a wave's box to the scattered one outside; appends to
    `notes`.
    """
    walls = [side_name(*key) for key, b in sides.items() if not (b.endless or b.shared or key in arriving.known)]
    if walls:
        notes.append(f"only what is scattered meets {', '.join(walls)}: an incident wave does not account for them")
    incidence_on_lattice = Incidence(
        arriving.wave, near.lattice, scheme_of(near, arriving.factor), arriving.free, near.states, arriving.strata
    )
    notes += incidence_on_lattice.passage.notes
    return incidence_on_lattice
