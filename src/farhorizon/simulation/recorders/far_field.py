"""The far field: waves that a run radiates beyond its near field, from the field recorded on the shell of a box."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.radiation import (
    KINDS,
    WAVES,
    ArrivingPlane,
    CrossSections,
    Pattern,
    as_directions,
    checked_frequencies,
    powers_sent,
    squared_frequency,
    waves_sent,
)
from farhorizon.analysis.references.infinite_lattice import DrivenLattice, Scheme, largest_speed
from farhorizon.arguments import Frequencies, InFile, Points, Toml
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.incidence import Region
from farhorizon.medium.shell import Shell
from farhorizon.rounding import MARGIN
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.far_field_checks import (
    LEFT,
    check_history,
    check_kept,
    check_moving,
    check_outside,
    check_window,
    corner_nodes,
    is_around,
    medium_outside,
    receiver_nodes,
    spectral_notes,
    steps_between_samples,
)
from farhorizon.simulation.recorders.fourier_sums import SampledSums
from farhorizon.simulation.recorders.recorder import (
    Arrays,
    LinearRecorder,
    RecordRequest,
    StepValues,
    check_begun,
    check_from_start,
)
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.outer_loop import checked_end, warn
from farhorizon.simulation.time.steps import last_step

_BLOCK = 16  # steps that share one maximum, which keeps the maxima small beside the history they come from
_STILL = 1e-6  # squared speeds below this part of the largest are rounding: such waves do not travel
_SEEN = 16  # steps between two checks of the largest field


class FarField(LinearRecorder):
    r"""Waves that a run radiates into the surrounding unbounded medium: receivers at any distance, patterns by
    direction and frequency, cross sections. It is passed to a run in ``observe=[...]``.

    After every step the field is recorded at the nodes within one reach of the faces of a box around everything that
    radiates or scatters. From it follow the forces :math:`f = L (\chi u) - \chi L u`, which radiate the same waves into
    the uniform infinite lattice as the contents of the box do, exactly and without any wave that only passes through,
    see `farhorizon.medium.shell.Shell`.

    Parameters
    ----------
    box : Box, optional
        Box around everything that radiates or scatters, all of which must lie at least one reach of the stencil inside
        its faces; outside it there must be one reach of the near field on each side. The largest such box unless given.
    frequencies : sequence of float
        Frequencies, in cycles per time, at which patterns and cross sections of waves are computed. Spectra follow the
        convention of `numpy.fft`, ``sum dt u exp(-2 pi i f t)``.
    points : array_like, shape (P, dim), or (P,) in 1D, optional
        Receivers outside the box, whose records are written to results files.
    directions : int or array_like, shape (D, dim)
        Number of directions of the pattern that is written to results files, evenly spaced from the x axis, in 3D in
        each of the planes xy, yz and zx; or the directions, as in `pattern`.
    history : bool, optional
        Keep the values on the shell for all steps, which `at` and `points` require: 8 bytes for each step, node and
        component. Spectra alone need memory by frequency only. None for what `points` and `frequencies` require, as in
        a case file that does not give it.
    name : str
        Name that distinguishes several of them in one run, in files and pictures.

    Attributes
    ----------
    notes : list of str
        Notes: parts of the data outside the box, points for which the nearest nodes were used. At the end of a run
        also, as a `ValidityWarning`: that it ended before the waves had left the box, or that something on the box is
        faster than all waves of the lattice.

    Raises
    ------
    InputError
        When the simulation is created: an unsuitable box, a medium that ends at some side or is not uniform from just
        inside the faces of the box outwards, data or sources outside the box, frequencies that the lattice does not
        support.

    Notes
    -----
    In electromagnetics this is called a near-to-far-field transformation, with a quadrature over a surface: Taflove and
    Hagness, Computational Electrodynamics (2005), chapter 8. Patterns follow from the wave surface of the lattice by
    the method of stationary phase, see `farhorizon.analysis.wave_surface`.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> far = fh.FarField(fh.Box((-10.0, -10.0), (10.0, 10.0)), frequencies=[0.05])
    >>> pulse = {"u": "exp(-(x**2 + y**2)/4)"}
    >>> lattice = fh.Lattice(1.0, (-14.0, -14.0), (14.0, 14.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), initial=pulse, observe=[far])
    >>> _ = sim.run(60.0)
    >>> times, u = far.at([(40.0, 0.0)])
    >>> bool(abs(times[np.argmax(u[:, 0])] - 40) < 4)  # of speed 1
    True
    >>> pattern = far.pattern(8)
    >>> pattern.amplitudes.shape  # frequencies, waves, directions
    (1, 1, 8)
    """

    several: ClassVar[bool] = False
    shared = True
    sums: SampledSums

    def __init__(
        self,
        box: Box | None = None,
        frequencies: Frequencies = (),
        points: Points | None = None,
        directions: Annotated[Any, Toml(int)] = 180,
        history: Annotated[bool | None, InFile(None)] = True,
        name: str = "far_field",
    ) -> None:
        self.box = None if box is None else kinds.instance(box, "far_field.box", Box, "a Box")
        self.frequencies = np.atleast_1d(kinds.array(frequencies, "far_field.frequencies"))
        self.points = None if points is None else kinds.array(points, "far_field.points")
        self.directions = directions
        needed = self.points is not None or not self.frequencies.size
        self.history = needed if history is None else kinds.flag(history, "far_field.history")
        super().__init__(name)
        if needed:
            check_kept(self.history, "history = true, or frequencies without points")
        self._steps = -1

    def __repr__(self) -> str:
        return f"FarField({self.box}, {len(self.frequencies)} frequencies, name={self.name!r})"

    def __getstate__(self) -> dict[str, Any]:
        """Return what it has recorded, without the run."""
        return {name: value for name, value in self.__dict__.items() if name != "_parts"}

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near = parts.whole.near
        self._lattice, self._background, self._density = near.lattice, near.background, 1 / near.model.source_factor
        self._scheme = medium_outside(parts)
        self.frequencies = checked_frequencies(self._scheme, self.frequencies, "far_field.frequencies")
        self._reach = near.lattice.spacing * np.array(self._scheme.stencil.reach, float)
        first, last = corner_nodes(near.lattice, self.box, self._scheme.stencil.reach)
        self._shell = Shell(self._scheme.stencil, first, last)
        corners = (near.lattice.lower + near.lattice.spacing * end for end in (first, last))
        self._faces = Box(*corners)
        self.notes = check_outside(setup, parts, self._faces, self._reach)
        if self.points is not None:
            self._receivers(self.points)
        self.sums = SampledSums(
            self.frequencies, self._scheme.dt, steps_between_samples(near, self.frequencies), self._count
        )
        as_directions(self.directions, near.lattice.dim, "far_field.directions")
        self._parts = parts
        self._judged = list[str]()
        self._end = -1  # the last step of the run, once it is known
        self._incident: list[tuple[Any, Region]] = [(incident.wave, incident.region) for incident in parts.incident]
        nodes = np.ravel_multi_index(tuple(self._shell.nodes.T), near.lattice.shape)
        check_window(parts, nodes, self._faces)
        return RecordRequest(nodes, ())

    def foresee(self, until: float, steps: int) -> None:
        """Check, before a run to a given time, sources that do not split into space and time, and memory; raises
        InputError for sources that extend beyond the box, and a history that does not fit into memory.
        """
        self._end, notes = steps, check_moving(self._parts, self._faces, self._reach, until)
        notes += check_history(8 * self._count * (steps + 1) * self.history, len(self._shell.nodes), steps)
        self.notes += [note for note in notes if note not in self.notes]

    @property
    def _count(self) -> int:
        """How many numbers are recorded in a step."""
        return self._scheme.stencil.components * len(self._shell.nodes)

    def functional(self, step_values: StepValues) -> np.ndarray:
        return np.array(step_values.nodes.swapaxes(1, 2).reshape(len(step_values.nodes), -1), float, order="C")

    def restart(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        check_from_start(step, "a far field", "far_field")
        self._rows: list[np.ndarray] = []
        self._steps, self._largest, self._last = -1, 0.0, 0.0
        self.keep(step, values[1:], forces)

    def keep(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        if self.history:
            self._rows.append(values)
        self._steps += len(values)
        self._last = float(np.abs(values[-1]).max(initial=0.0))
        self._largest = max(self._largest, self._last, float(np.abs(values[::_SEEN]).max(initial=0.0)))
        if self._steps == self._end and self.frequencies.size:
            for text in self._judge():
                warn(text)

    @property
    def recorded(self) -> Recorded:
        """Empty before the end of the run."""
        return Recorded(self.name, np.zeros((0, self._lattice.dim)), np.zeros(0), {})

    @property
    def asked(self) -> Arrays:
        """The frequencies, and the points if there are any."""
        return {"frequencies": self.frequencies} | ({} if self.points is None else {"points": self.points})

    @property
    def names(self) -> list[str]:
        return [self.name, f"{self.name}_points", f"{self.name}_pattern"]

    def concluded(self) -> list[Recorded]:
        records = []
        if self.points is not None:
            times, values = self.at(self.points)
            places = self._lattice.lower + self._lattice.spacing * self._receivers(self.points)
            records.append(Recorded(f"{self.name}_points", places, times, {"u": values}))
        if self.frequencies.size:
            pattern = self.pattern(self.directions)
            cross_sections = pattern.cross_sections
            levels, quantity = (
                (pattern.intensities, "intensity") if cross_sections is None else (cross_sections, "cross_section")
            )
            spectra = {f"{quantity}_{wave}": levels[:, number] for number, wave in enumerate(pattern.waves)}
            spectra |= {wave: pattern.amplitudes[:, number] for number, wave in enumerate(pattern.waves)}
            name, no_times = f"{self.name}_pattern", np.zeros(0)
            records.append(Recorded(name, pattern.directions, no_times, {}, self.frequencies, spectra, directions=True))
        return records

    def state(self) -> Arrays:
        rows = np.concatenate([np.zeros((0, self._count)), *self._rows])
        return {"rows": rows, "counts": np.array([self._steps, self._largest, self._last]), **self.sums.state()}

    def take(self, state: Arrays) -> None:
        self._rows = [state["rows"]]
        steps, self._largest, self._last = map(float, state["counts"])
        self._steps = int(steps)
        self.sums.take(state)

    # --- in time -----------------------------------------------------------------------------------------------

    def _forces(self, steps: int) -> Iterator[np.ndarray]:
        """Yield the forces on the shell at that many steps, which vanish after the run; shape (components * W,)."""
        for rows in self._rows:
            driven = self._scheme.rate * (self._shell.commutator @ rows[:steps].T).T
            steps -= len(driven)
            yield from driven
        yield from repeat(np.zeros(self._count), steps)

    def at(self, points: Any = None, until: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The field at points outside the box, in the near field or at any distance, exactly as in a run whose near
        field contains them.

        Parameters
        ----------
        points : array_like, shape (P, dim), or (P,) in 1D, optional
            Each point is replaced by the nearest node of the infinite lattice; those of the constructor unless given.
        until : float, optional
            End of the record; that of the run unless given, but what left the box by then may arrive later. If more
            than 1e-3 of it remains on the box, values are nan from when on what leaves after the run may arrive.

        Returns
        -------
        times : ndarray, shape (steps + 1,)
        values : ndarray, shape (steps + 1, P[, components])
            A `ValidityWarning` says that they contain nan, or end before the largest waves arrive.

        Raises
        ------
        InputError
            No history, a point inside the box, points so far away, or a run so long, that the computation does not fit
            into memory.
        """
        self._must_have_run()
        check_kept(self.history, "history = true, before the run")
        receivers, dt = self._receivers(self.points if points is None else points), self._scheme.dt
        last = self._steps if until is None else last_step(checked_end(until, dt), dt)
        driven = DrivenLattice(self._scheme, last, self._shell.nodes, receivers)
        values = driven.field(self._forces(last)) + self._background
        coordinates = self._lattice.lower + self._lattice.spacing * receivers
        arrivals = _Arrivals(self._scheme, self._shell, receivers, coordinates)
        unknown = arrivals.forget_unknown(values, self._steps, self._last, self._largest)
        for text in (doubts := arrivals.late(self._rows, last, self._total) + unknown):
            warn(text)
        self.notes += [text for text in doubts if text not in self.notes]
        return dt * np.arange(last + 1), values

    def _receivers(self, points: Any) -> np.ndarray:
        """Return the indices of the nodes nearest to points, also beyond the lattice."""
        nodes, notes = receiver_nodes(points, self._lattice, self._shell, self._faces)
        self.notes += [note for note in notes if note not in self.notes]
        return nodes

    # --- by frequency ------------------------------------------------------------------------------------------

    def pattern(self, directions: Any = None) -> Pattern:
        """Far-field radiation by frequency, wave and direction.

        Parameters
        ----------
        directions : int or array_like, shape (D, dim), optional
            Vectors along which energy travels; their length is irrelevant. Or a number of directions, evenly
            distributed: in 2D starting from the x axis, in 3D this number in each of the planes xy, yz and zx. Those of
            the constructor unless given.

        Raises
        ------
        InputError
            No frequencies; a frequency at which several waves of one kind travel in the same direction.
        """
        self._must_have_spectra()
        scheme, spacing, dim = self._scheme, self._lattice.spacing, self._lattice.dim
        unit_vectors = as_directions(self.directions if directions is None else directions, dim, "far_field.directions")
        waves_by_frequency = []
        for squared, force in zip(self._squares, self._spectral_forces, strict=True):
            waves_by_frequency.append(waves_sent(scheme, squared, self._places, force, unit_vectors))
        amplitudes, shapes, vectors, slopes = (np.stack(part) for part in zip(*waves_by_frequency, strict=True))
        area = spacing ** (dim - 1)
        strength = np.abs(amplitudes) ** 2 * slopes.real
        mass = self._density * spacing * self._rates[:, None, None]
        incident = self._arriving
        return Pattern(
            self.frequencies,
            unit_vectors,
            WAVES[scheme.stencil.components],
            (np.sqrt(area) * amplitudes).conj(),
            shapes.conj(),
            vectors.conj() / spacing,
            mass * area * strength,
            None
            if not incident
            else area * strength / 2 / np.array([wave.strength for wave in incident])[:, None, None],
        )

    def energy(self) -> np.ndarray:
        """Energy that leaves the box, by frequency; its integral over positive frequencies is the radiated energy.

        It is the work of the forces on the shell on the field that they radiate, with the velocity of the scheme,
        ``(u(t + dt) - u(t - dt)) / (2 dt)``, whose factor is ``sin(omega dt) / dt``: on the lattice, exactly the energy
        that crosses any closed surface around them.

        Returns
        -------
        ndarray, shape (F,)

        Raises
        ------
        InputError
            No frequencies; a medium with damping, which absorbs energy.
        """
        self._must_have_spectra(undamped=True)
        mass = self._density * self._lattice.spacing**self._lattice.dim
        return 2 * mass * self._rates * self._outflow()

    def energies(self) -> dict[str, np.ndarray]:
        """Energy of the pattern in all directions, by wave and frequency: the shares of P and S waves in `energy`.

        It is an integral over the wave surfaces of the lattice, over all directions of wave vectors. The integral of
        `Pattern.intensities`, over directions in which energy travels, is the same, except for S waves in 3D, some of
        which reach one point along several paths.

        Returns
        -------
        dict of str to ndarray, shape (F,)
            "wave" for a scalar field, "P" and "S" for a solid, where in 3D both S waves are combined.

        Raises
        ------
        InputError
            As in `energy`.
        """
        self._must_have_spectra(undamped=True)
        mass = self._density * self._lattice.spacing**self._lattice.dim
        powers = [
            powers_sent(self._scheme, squared.real, self._shell.nodes, force)
            for squared, force in zip(self._squares, self._spectral_forces, strict=True)
        ]
        energies = 2 * mass * self._rates * np.transpose(powers)
        return dict(zip(KINDS[self._scheme.stencil.components], energies, strict=True))

    def cross_sections(self) -> CrossSections:
        """Scattering and total cross sections of the contents of the box, for the incident wave of the run.

        Raises
        ------
        InputError
            No frequencies; not exactly one incident wave.
        """
        self._must_have_spectra(undamped=True)
        incident = self._arriving
        if not incident:
            raise InputError(
                "cross sections are those of one incident wave, a plane one",
                value=f"{len(self._incident)} incident waves",
                limit="1",
                key="incident",
                remedy="a run for each wave",
            )
        area = self._lattice.spacing ** (self._lattice.dim - 1)
        strength = np.array([wave.strength for wave in incident])
        work = [wave.work(self._places, force) for wave, force in zip(incident, self._spectral_forces, strict=True)]
        return CrossSections(area * self._outflow() / strength, area * np.array(work) / strength)

    def _outflow(self) -> np.ndarray:
        """``Im sum f* v`` of the forces and their field, shape (F,): twice the mean power over mass and frequency."""
        if self._total and not self._arriving:
            raise InputError(
                "what leaves a box inside that of an incident wave is known only for a single plane wave",
                value="a box inside that of another wave",
                limit="a box around that of the wave",
                key="far_field.box",
                remedy="leave it out: the widest box is around that of the wave",
            )
        inside = self._shell.inside
        field = np.where(inside, 0.0, self._spectra)
        for number, plane_wave in enumerate(self._arriving if self._total else ()):
            # an incident wave that passes through the box radiates nothing outside, and minus itself inside
            field[number] -= plane_wave.field(self._places)
        return np.asarray((self._spectral_forces.conj() * field).sum((1, 2)).imag)

    @property
    def _places(self) -> np.ndarray:
        """Positions of the shell's nodes relative to the origin, in spacings."""
        return self._lattice.lower / self._lattice.spacing + self._shell.nodes

    @property
    def _squares(self) -> list[complex]:
        return [squared_frequency(self._scheme, frequency) for frequency in self.frequencies]

    @property
    def _rates(self) -> np.ndarray:
        """``sin(omega dt) / dt``: velocity over displacement."""
        return np.sin(2 * np.pi * self.frequencies * self._scheme.dt) / self._scheme.dt

    @property
    def _spectra(self) -> np.ndarray:
        """Spectra of the field on the shell, with time dependence ``exp(-i omega t)``; shape (F, components, W)."""
        return self.sums.values.conj().reshape(len(self.frequencies), self._scheme.stencil.components, -1)

    @property
    def _spectral_forces(self) -> np.ndarray:
        spectra = self._spectra
        forces = self._shell.commutator @ spectra.reshape(len(spectra), -1).T
        return np.asarray(self._scheme.rate * forces.T.reshape(spectra.shape))

    @property
    def _total(self) -> bool:
        """Whether the field on the shell is the total field, which includes the incident wave."""
        return any(not is_around(self._faces, wave) for wave, _ in self._incident)

    @property
    def _arriving(self) -> list[ArrivingPlane]:
        """The incident wave at each frequency; empty unless there is exactly one, and it is plane."""
        if len(self._incident) != 1 or not self._incident[0][0].plane:
            return []
        ((wave, region),), spacing, dt = self._incident, self._lattice.spacing, self._scheme.dt
        times = dt * np.arange(int(np.ceil(wave.duration / dt - MARGIN)) + 1)
        spectrum = np.exp(2j * np.pi * np.outer(self.frequencies, times)) @ (dt * wave.at(np.asarray(times)))
        vector, place = wave.vector(self._scheme.stencil.components), wave.start(region) / spacing
        return [
            ArrivingPlane.of(self._scheme, squared, wave.along, vector, complex(amplitude), place)
            for squared, amplitude in zip(self._squares, spectrum, strict=True)
        ]

    # --- checks ------------------------------------------------------------------------------------------------

    def _must_have_run(self) -> None:
        check_begun(self._steps >= 0, "far field", "far_field")

    def _must_have_spectra(self, undamped: bool = False) -> None:
        self._must_have_run()
        if not self.frequencies.size:
            key, remedy = "far_field.frequencies", "frequencies=[...]"
            raise InputError("no frequencies were recorded", value="none", limit="at least 1", key=key, remedy=remedy)
        if undamped and any(squared.imag > 1e-12 * abs(squared) for squared in self._squares):
            raise InputError(
                "damping absorbs what is radiated: no energy arrives far away",
                value="a damped medium",
                limit="damping = 0",
                key="model.damping",
                remedy="damping = 0, or FarField.pattern",
            )
        self._judge()

    def _judge(self) -> list[str]:
        """Return why the spectra so far may be doubtful, and update the notes."""
        judged = spectral_notes(self._last, self._largest, self.sums.missed)
        self.notes = [note for note in self.notes if note not in self._judged] + judged
        self._judged = judged
        return judged


@dataclass(frozen=True)
class _Arrivals:
    """When what leaves a box arrives at receivers, given the medium outside, the shell of the box, and the nodes and
    coordinates of the receivers, each of shape (P, dim).
    """

    scheme: Scheme
    shell: Shell
    receivers: np.ndarray
    places: np.ndarray

    def late(self, rows: Sequence[np.ndarray], last: int, passing: bool) -> list[str]:
        """Return the warning that records which end with step `last` lack something: a value on the faces towards a
        receiver that is larger than all that arrive there by then, or, where an incident wave passes through the box
        and hides how large the others are, one that is not faint beside it.

        `rows` has the values on the shell, each of shape (steps, components * W), components first.
        """
        factor = LEFT if passing else 1 + LEFT
        steps, sizes = _block_maxima(rows, self.scheme.stencil.components)
        lacks: list[tuple[float, float, int]] = []  # step of arrival, largest value until then, receiver
        for number, receiver in enumerate(self.receivers):
            which, delays = _delays(self.scheme, self.shell, receiver)
            arrivals, size = steps[:, which] + delays, sizes[:, which]
            largest_arrived = size[arrivals <= last].max(initial=0.0)
            lacking = np.where(arrivals <= last, 0.0, size)
            if lacking.max(initial=0.0) > factor * largest_arrived:
                lacks.append((float(arrivals.flat[lacking.argmax()]), float(largest_arrived / lacking.max()), number))
        if not lacks:
            return []
        arrival, ratio, number = max(lacks)
        end, later = (f"t = {step * self.scheme.dt:.6g}" for step in (last, arrival))
        return [
            f"the far field {self._at(number, len(lacks))} ends at {end}, but the largest of the waves on the box "
            f"arrives there at about {later}, and of those that arrive before the end the largest has {ratio:.2g} of "
            "its amplitude on the box; FarField.at(points, until=...) with a later end, or a longer run, contains it"
        ]

    def forget_unknown(self, values: np.ndarray, end: int, remaining: float, largest: float) -> list[str]:
        """Overwrite values, of shape (steps + 1, P[, components]), by nan from the step on at which what leaves the box
        after the run may have arrived; return the warning that says so. `remaining` and `largest` are the largest
        values on the shell at the end of the run and in all of it.
        """
        if remaining <= LEFT * largest:
            return []
        last_known = [end + _steps_of_travel(self.scheme, self.shell, receiver) for receiver in self.receivers]
        for number, step in enumerate(last_known):
            values[step + 1 :, number] = np.nan
        short = [(step, number) for number, step in enumerate(last_known) if step + 1 < len(values)]
        if not short:
            return []
        step, number = min(short)
        when, run_end = (f"t = {number * self.scheme.dt:.6g}" for number in (step, end))
        return [
            f"the far field {self._at(number, len(short))} is known up to {when} and is nan after it: at the end of "
            f"the run, at {run_end}, {remaining / largest:.2g} of the largest value remains on the box, and what "
            "leaves it later may arrive; a longer run supplies it"
        ]

    def _at(self, number: int, count: int) -> str:
        among = f" (the worst of {count} points)" if count > 1 else ""
        return f"at {shown(self.places[number].round(12))}{among}"


def _block_maxima(rows: Sequence[np.ndarray], components: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest value at each node within each few steps, and its step; each of shape (blocks, W)."""
    steps, sizes, first = [], [], 0
    for values in rows:
        for begin in range(0, len(values), _BLOCK):
            size = np.abs(values[begin : begin + _BLOCK]).reshape(-1, components, values.shape[1] // components).max(1)
            steps.append(first + begin + size.argmax(0))
            sizes.append(size.max(0))
        first += len(values)
    return np.array(steps), np.array(sizes)


def _delays(scheme: Scheme, shell: Shell, receiver: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the shell's nodes at the faces that a receiver sees, and how many steps the slowest long
    wave takes from each of them; for diffusion, after how many steps a release there is largest, ``r^2 / (2 dim D)``.
    """
    first, last, reach = map(np.array, (shell.first, shell.last, shell.stencil.reach))
    facing = (receiver > last) & (shell.nodes > last - reach) | (receiver < first) & (shell.nodes < first + reach)
    which = np.flatnonzero(facing.any(1))
    distance = np.linalg.norm(receiver - shell.nodes[which], axis=1)
    direction = receiver - (first + last) / 2
    squared_speeds = _squared_speeds(scheme, direction / np.linalg.norm(direction))
    if scheme.order == 1:
        return which, distance**2 / (2 * len(first) * squared_speeds.max() * scheme.recursion.scale)
    return which, distance / (np.sqrt(squared_speeds[squared_speeds > _STILL * squared_speeds.max()].min()) * scheme.dt)


def _squared_speeds(scheme: Scheme, direction: np.ndarray) -> np.ndarray:
    """Squared speeds of long waves along a direction, in nodes per time; for diffusion, diffusivities."""
    along = (scheme.stencil.offsets @ direction) ** 2 / 2
    tensor = np.tensordot(along, scheme.stencil.weights, 1) * scheme.rate
    return np.asarray(np.linalg.eigvalsh(np.atleast_2d(tensor)))


def _steps_of_travel(scheme: Scheme, shell: Shell, receiver: np.ndarray) -> int:
    """Return in how many steps the fastest wave of the lattice travels from a box to a receiver; 0 for diffusion, which
    has no front.
    """
    if scheme.order == 1:
        return 0
    first, last = shell.nodes.min(0), shell.nodes.max(0)
    distances = np.maximum(np.maximum(first - receiver, receiver - last), 0)
    return int(np.linalg.norm(distances) / (largest_speed(scheme.stencil) * np.sqrt(scheme.rate) * scheme.dt))
