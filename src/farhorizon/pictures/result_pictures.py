"""Pictures of a results file: fields at given times, probes and other histories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.pictures.deformed import deformed_panels
from farhorizon.pictures.fields import field_panels, slice_panels
from farhorizon.pictures.fronts import front
from farhorizon.pictures.histories import history_pictures
from farhorizon.pictures.isosurfaces import isosurface_panels
from farhorizon.pictures.movie import movie
from farhorizon.pictures.panels import Look, Panel, comparable, magnitude
from farhorizon.pictures.scalars import Scalar, wanted_scalars
from farhorizon.pictures.style import DAMAGE, SEQUENTIAL, counted_in, time_text
from farhorizon.pictures.views import FLOOR, Slice, View
from farhorizon.pictures.words import axis_label, in_words

if TYPE_CHECKING:
    from farhorizon.files.results import Results

_FAINT = 1e-6  # of the largest value that is shown: fainter panels show only rounding and tails
_MARKS = "*\N{DAGGER}\N{DOUBLE DAGGER}\N{SECTION SIGN}"  # marks of the cautions that make a field doubtful
_FEW_REGIONS = 8  # largest number of regions whose outlines do not hide the field


def plot_results(
    results: Results, out_dir: str | Path, view: View | None = None, say: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Draw what a view requests of a results file into a directory, created if it does not exist; `say` is called with
    a message about each deviation from what was requested.

    The panels of a field share one colour scale unless its largest value changes more than fivefold between them.
    Panels in which a field is zero are left out. The files are ``FIELD.png`` for each field, which for vectors shows
    their length, next to ``FIELD_x.png`` and so on for the components (``front.png`` for the times of dissolution);
    ``probes.png``, ``NAME_QUANTITY.png`` for receivers, ``NAME_pattern.png`` for a far field, ``energy.png`` and
    ``balance.png`` if they were recorded; ``deformed.png``; ``FIELD.gif`` and ``FIELD.mp4`` for a movie.
    """
    view = view or View()
    with counted_in(results.units):
        return _Drawing(results, Path(out_dir), view, say, view.chosen(results, say)).draw()


@dataclass(frozen=True)
class _Drawing:
    """What the pictures of a results file have in common."""

    results: Results
    directory: Path
    view: View
    say: Callable[[str], None]
    outputs: Sequence[int]  # numbers of those that are drawn

    def draw(self) -> list[Path]:
        """Draw what the view requests, and return the paths."""
        results, view = self.results, self.view
        scalars, slices = wanted_scalars(results, view.fields), view.slices(results)
        if view.deformed is not None:
            return self._deformed(view.deformed)
        first = scalars if view.fields else scalars[:1]  # the others only on request, since films take time
        if view.isosurfaces is not None:
            return [self._surfaces(scalar) for scalar in first]
        if view.movie:
            return [path for scalar, cut in product(first, slices) for path in self._movie(scalar, cut)]
        self.directory.mkdir(parents=True, exist_ok=True)
        written = []
        for scalar, cut in product(scalars if self.outputs else (), slices):
            if scalar.name == "dissolved" and results.dim > 1:
                written.append(self._front(cut))
            else:
                written += self._panels(scalar, cut, self.say if cut == slices[0] else lambda text: None)
        if view.fields is None:
            written += history_pictures(results, self.directory, view.format, view.quantities)
        return written

    def _panels(self, scalar: Scalar, cut: Slice, say: Callable[[str], None]) -> list[Path]:
        """Draw one scalar at the chosen times; nothing if it is zero at all of them."""
        results, view = self.results, self.view
        drawn = self.outputs if scalar.name != "dissolved" else self.outputs[-1:]  # the last one contains all times
        fields = {k: scalar.of(results.field(scalar.field, k)) for k in drawn}
        kept = self._not_faint(scalar, fields, say)
        if not kept:
            return []
        solids = [self._solid(k) for k in kept] if "dissolved" in results.field_names else []
        path, shown = self._path(scalar, cut), [fields[k] for k in kept]
        look = self._look(scalar, kept)._replace(
            smooth=scalar.name != "damage" and not solids, regions=self._regions(), plane=cut.plane
        )
        if view.decibels:
            shown, look = view.levels(shown), look._replace(limits=view.limits or (FLOOR, 0.0))
        broken = self._broken(scalar, kept)
        panels = [
            Panel(self._time(k), values, solids[i] if solids else None, broken[i] if broken else None)
            for i, (k, values) in enumerate(zip(kept, shown, strict=True))
        ]
        shared = look.limits is not None or comparable([panel.seen for panel in panels])
        draw = slice_panels if results.dim == 3 and cut.plane is None and not solids else field_panels
        draw(panels, results.axes, path, look._replace(shared=shared))
        return [path]

    def _not_faint(self, scalar: Scalar, fields: dict[int, np.ndarray], say: Callable[[str], None]) -> list[int]:
        """Outputs whose fields are not zero, nor so small beside the others that only rounding is left; `say` is told
        which are left out.
        """
        sizes = {k: float(np.abs(np.nan_to_num(values)).max()) for k, values in fields.items()}
        if not any(sizes.values()):
            say(f"{scalar.label} is zero everywhere: no picture")
            return []
        empty = [k for k, size in sizes.items() if size == 0]
        scaled = self.view.decibels or self.view.limits is not None  # shows also what is faint
        faint = [k for k, size in sizes.items() if 0 < size < _FAINT * max(sizes.values()) and not scaled]
        for left_out, what in ((empty, "zero everywhere"), (faint, f"below {_FAINT:g} of its largest value")):
            if left_out:
                times = ", ".join(f"{self.results.times[k]:.4g}" for k in left_out)
                say(f"{scalar.label} is {what} at t = {times}: left out")
        return [k for k in fields if k not in empty + faint]

    def _movie(self, scalar: Scalar, cut: Slice) -> list[Path]:
        """Draw the chosen outputs one after the other as a film."""
        results, view = self.results, self.view
        values = [scalar.of(results.field(scalar.field, k)) for k in self.outputs]
        look = self._look(scalar, self.outputs)._replace(plane=cut.plane)
        if view.decibels and any(np.nan_to_num(field).any() for field in values):
            values, look = view.levels(values), look._replace(limits=view.limits or (FLOOR, 0.0))
        broken = self._broken(scalar, self.outputs)
        frames = [
            Panel(self._time(k), field, broken=broken[i] if broken else None)
            for i, (k, field) in enumerate(zip(self.outputs, values, strict=True))
        ]
        return movie(frames, results.axes, self.directory / f"{scalar.name}{cut.suffix}", look)

    def _surfaces(self, scalar: Scalar) -> Path:
        """Draw isosurfaces of one scalar at the chosen times, except those at which it is zero."""
        view = self.view
        panels = [Panel(self._time(k), scalar.of(self.results.field(scalar.field, k))) for k in self.outputs]
        panels = [panel for panel in panels if np.nan_to_num(panel.values).any()] or panels
        label = axis_label(scalar.label, scalar.quantity, view.quantities)
        look = Look(label, self._doubts(self.outputs), cracks=view.cracks)
        figure = isosurface_panels(panels, self.results.axes, None, look, view.isosurfaces or None)
        self.directory.mkdir(parents=True, exist_ok=True)
        path = self.directory / f"{scalar.name}-surfaces{view.suffix}.{view.format}"
        figure.savefig(path)
        return path

    def _deformed(self, factor: float) -> list[Path]:
        """Draw the deformed lattice at the chosen times."""
        results, view = self.results, self.view
        panels = [self._strained(k) for k in self.outputs]
        self.directory.mkdir(parents=True, exist_ok=True)
        path = self.directory / f"deformed{view.suffix}.{view.format}"
        damaged = "damage" in results.field_names
        label = axis_label(*(("damage", "damage") if damaged else ("|u|", "u")), view.quantities)
        look = Look(label, self._doubts(self.outputs), DAMAGE if damaged else SEQUENTIAL)
        deformed_panels(panels, results.axes, path, look, factor)
        return [path]

    def _strained(self, index: int) -> Panel:
        """Displacements of an output, and the values for their colours: damage, or their lengths."""
        results = self.results
        if results.dim != 2 or results.components.get("u") != 2:
            count = results.components.get("u")
            raise InputError(
                "only a run in 2D with displacements has a deformed shape",
                value=f"{results.dim}D, {f'u of {count} components' if count else 'no u'}",
                key="--deformed",
            )
        u = results.field("u", index)
        values = results.field("damage", index) if "damage" in results.field_names else magnitude(u)
        return Panel(self._time(index), values, moves=u)

    def _front(self, cut: Slice) -> Path:
        """Draw the times of dissolution up to the last of the chosen times."""
        path = self.directory / f"front{cut.suffix}.{self.view.format}"
        outside = np.isnan(self.results.field("u", 0)) if "u" in self.results.field_names else None
        look = Look(cracks=self.view.cracks, plane=cut.plane)
        front(self.results.field("dissolved", self.outputs[-1]), self.results.axes, path, look, outside)
        return path

    def _path(self, scalar: Scalar, cut: Slice) -> Path:
        return self.directory / f"{scalar.name}{cut.suffix}.{self.view.format}"

    def _look(self, scalar: Scalar, outputs: Sequence[int]) -> Look:
        """The look of a scalar; damage shows the cracks, including initial ones, which are not drawn over it."""
        view, damage = self.view, scalar.name == "damage"
        label = axis_label(scalar.label, scalar.quantity, view.quantities)
        if view.decibels:
            label = f"{in_words(scalar.label, view.quantities)} (dB below the largest)"
        colors = DAMAGE if damage and not view.decibels else None
        return Look(label, self._doubts(outputs), colors, view.limits, cracks=() if damage else view.cracks)

    def _regions(self) -> Regions | None:
        """Regions of the nodes, if there are few enough to draw, otherwise None."""
        results = self.results
        few = 1 < len(results.region_names) <= _FEW_REGIONS
        drawn = few and results.dim > 1 and "dissolved" not in results.field_names
        return Regions(results.regions, results.region_names) if drawn else None

    def _time(self, index: int) -> str:
        """Title of a panel: its time, and the marks of the cautions that apply by then."""
        time = float(self.results.times[index])
        marks = (mark for mark, caution in zip(_MARKS, self.results.cautions, strict=False) if caution.time <= time)
        return f"t = {time_text(time)}{''.join(marks)}"

    def _doubts(self, outputs: Sequence[int]) -> str:
        """Explanation of the marks at some outputs."""
        last = float(self.results.times[list(outputs)].max(initial=-np.inf))
        marked = zip(_MARKS, self.results.cautions, strict=False)
        return "; ".join(f"{mark} {caution.brief}" for mark, caution in marked if caution.time <= last)

    def _broken(self, scalar: Scalar, outputs: Sequence[int]) -> list[np.ndarray]:
        """Fraction of broken bonds of each node at some outputs, to be drawn over a scalar that does not show it.

        Bonds of initial cracks that are drawn as lines do not count.
        """
        if scalar.name == "damage" or "damage" not in self.results.field_names:
            return []
        lines = len(self.view.cracks) > 0 and self.results.times[0] == 0
        initial = self.results.field("damage", 0) if lines else 0.0
        return [self.results.field("damage", k) - initial for k in outputs]

    def _solid(self, index: int) -> np.ndarray:
        """Solid nodes of an output: nodes in the window without a time of dissolution."""
        metal = np.isnan(self.results.field("dissolved", index))
        return metal & np.isfinite(self.results.field("u", index)) if "u" in self.results.field_names else metal
