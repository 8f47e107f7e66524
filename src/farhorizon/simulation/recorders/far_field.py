"""The far field: waves that a run radiates beyond its near field, from the field recorded on the shell of a box."""

from __future__ import annotations

from collections.abc import Iterator
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
from farhorizon.analysis.references.driven import DrivenLattice
from farhorizon.arguments import Frequencies, InFile, Points, Toml
from farhorizon.errors import InputError
from farhorizon.files.records import Recorded
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.incidence import Region
from farhorizon.medium.shell import Shell
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.recorders.far_arrivals import FarArrivals
from farhorizon.simulation.recorders.far_box import (
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
    Recorder,
    RecordRequest,
    StepValues,
    check_begun,
    check_from_start,
    recorder_name,
)
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.outer_loop import checked_end, warn
from farhorizon.simulation.time.steps import last_step

_SEEN = 16  # steps between two checks of the largest field


class FarField(Recorder):
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
        self.name = recorder_name(name)
        if needed:
            check_kept(self.history, "history = true, or frequencies without points")
        self.notes: list[str] = []
        self._steps = -1

    def __repr__(self) -> str:
        return f"FarField({self.box}, {len(self.frequencies)} frequencies, name={self.name!r})"

    def __getstate__(self) -> dict[str, Any]:
        """Return what it has recorded, without the run."""
        return {name: value for name, value in self.__dict__.items() if name != "_parts"}

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: Parts) -> RecordRequest:
        near = parts.whole.near
        self._lattice, self._background, self._density = near.lattice, near.background, 1 / near.model.source_factor
        self._scheme = medium_outside(parts)
        self.frequencies = checked_frequencies(self._scheme, self.frequencies, "far_field.frequencies")
        self._every = steps_between_samples(near, self.frequencies)
        self._reach = near.lattice.spacing * np.array(self._scheme.stencil.reach, float)
        first, last = corner_nodes(near.lattice, self.box, self._scheme.stencil.reach)
        self._shell = Shell(self._scheme.stencil, first, last)
        corners = (near.lattice.lower + near.lattice.spacing * end for end in (first, last))
        self._faces = Box(*corners)
        self.notes = check_outside(setup, parts, self._faces, self._reach)
        if self.points is not None:
            self._receivers(self.points)
        as_directions(self.directions, near.lattice.dim, "far_field.directions")
        self._parts = parts
        self._judged = list[str]()
        self._end = -1  # the last step of the run, once it is known
        self._incident: list[tuple[Any, Region]] = [(one.wave, one.region) for one in parts.incident]
        nodes = np.ravel_multi_index(tuple(self._shell.nodes.T), near.lattice.shape)
        check_window(parts, nodes, self._faces)
        return RecordRequest(nodes, ())

    def foresee(self, until: float, steps: int) -> None:
        """Check, before a run to a given time, sources that do not split into space and time, and memory.

        Raises
        ------
        InputError
            Sources that extend beyond the box, a history that does not fit into memory.
        """
        self._end, notes = steps, check_moving(self._parts, self._faces, self._reach, until)
        notes += check_history(8 * self._count * (steps + 1) * self.history, len(self._shell.nodes), steps)
        self.notes += [note for note in notes if note not in self.notes]

    @property
    def _count(self) -> int:
        """How many numbers are recorded in a step."""
        return self._scheme.stencil.components * len(self._shell.nodes)

    def start(self, step: int, step_values: StepValues) -> None:
        check_from_start(step, "a far field", "far_field")
        self._rows: list[np.ndarray] = []
        self._sums = SampledSums(self.frequencies, self._scheme.dt, self._every, self._count)
        self._steps, self._largest, self._last = -1, 0.0, 0.0
        self.add(0, StepValues(step_values.nodes[-1:], ()))

    def add(self, step: int, step_values: StepValues) -> None:
        rows = np.array(step_values.nodes.swapaxes(1, 2).reshape(len(step_values.nodes), -1), float)
        if self.history:
            self._rows.append(rows)
        if self.frequencies.size:
            self._sums.add(step, rows)
        self._steps += len(rows)
        self._last = float(np.abs(rows[-1]).max(initial=0.0))
        self._largest = max(self._largest, self._last, float(np.abs(rows[::_SEEN]).max(initial=0.0)))
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

    def forget(self) -> None:
        """Do nothing: receivers need the complete history of the shell."""

    @property
    def names(self) -> list[str]:
        return [self.name, f"{self.name}_points", f"{self.name}_pattern"]

    def concluded(self) -> list[Recorded]:
        found = []
        if self.points is not None:
            times, values = self.at(self.points)
            places = self._lattice.lower + self._lattice.spacing * self._receivers(self.points)
            found.append(Recorded(f"{self.name}_points", places, times, {"u": values}))
        if self.frequencies.size:
            pattern = self.pattern(self.directions)
            crossed = pattern.cross_sections
            levels, what = (pattern.intensities, "intensity") if crossed is None else (crossed, "cross_section")
            spectra = {f"{what}_{wave}": levels[:, number] for number, wave in enumerate(pattern.waves)}
            spectra |= {wave: pattern.amplitudes[:, number] for number, wave in enumerate(pattern.waves)}
            name, still = f"{self.name}_pattern", np.zeros(0)
            found.append(Recorded(name, pattern.directions, still, {}, self.frequencies, spectra, directions=True))
        return found

    def state(self) -> Arrays:
        rows = np.concatenate([np.zeros((0, self._count)), *self._rows])
        return {"rows": rows, "counts": np.array([self._steps, self._largest, self._last]), **self._sums.state()}

    def take(self, state: Arrays) -> None:
        self._rows = [state["rows"]]
        steps, self._largest, self._last = (float(one) for one in state["counts"])
        self._steps = int(steps)
        self._sums.take(state)

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
        places = self._lattice.lower + self._lattice.spacing * receivers
        arrivals = FarArrivals(self._scheme, self._shell, receivers, places)
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
        unit = as_directions(self.directions if directions is None else directions, dim, "far_field.directions")
        parts = []
        for squared, force in zip(self._squares, self._spectral_forces, strict=True):
            parts.append(waves_sent(scheme, squared, self._places, force, unit))
        amplitudes, shapes, vectors, slopes = (np.stack(part) for part in zip(*parts, strict=True))
        area = spacing ** (dim - 1)
        strength = np.abs(amplitudes) ** 2 * slopes.real
        mass = self._density * spacing * self._rates[:, None, None]
        incident = self._arriving
        return Pattern(
            self.frequencies,
            unit,
            WAVES[scheme.stencil.components],
            (np.sqrt(area) * amplitudes).conj(),
            shapes.conj(),
            vectors.conj() / spacing,
            mass * area * strength,
            None if not incident else area * strength / 2 / np.array([one.strength for one in incident])[:, None, None],
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
        strength = np.array([one.strength for one in incident])
        work = [one.work(self._places, force) for one, force in zip(incident, self._spectral_forces, strict=True)]
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
        for number, one in enumerate(self._arriving if self._total else ()):
            # an incident wave that passes through the box radiates nothing outside, and minus itself inside
            field[number] -= one.field(self._places)
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
        return self._sums.values.conj().reshape(len(self.frequencies), self._scheme.stencil.components, -1)

    @property
    def _spectral_forces(self) -> np.ndarray:
        spectra = self._spectra
        found = self._shell.commutator @ spectra.reshape(len(spectra), -1).T
        return np.asarray(self._scheme.rate * found.T.reshape(spectra.shape))

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
        times = dt * np.arange(int(np.ceil(wave.duration / dt - 1e-9)) + 1)
        spectrum = np.exp(2j * np.pi * np.outer(self.frequencies, times)) @ [dt * wave.at(t) for t in times]
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
        found = spectral_notes(self._last, self._largest, self._sums.missed)
        self.notes = [one for one in self.notes if one not in self._judged] + found
        self._judged = found
        return found
