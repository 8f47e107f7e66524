"""Run an example script, and draw what it computes: ``python docs/_extensions/scripts.py SCRIPT PICTURE``."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

import farhorizon as fh

Names = dict[str, Any]

#: Functions of scripts that take their time, and whose results pictures show as well as the script itself does: called
#: once more with the same arguments, they return what they have returned.
KEPT = {
    "block",
    "drawn",
    "errors",
    "gel",
    "half_space",
    "imaged",
    "located",
    "main",
    "measured",
    "mesh",
    "plate",
    "quake",
    "run",
    "seismograms",
    "shot",
    "shots",
    "struck",
}


# Each function is named like the script whose picture it draws.


def plane(sim: fh.Simulation, field: np.ndarray, title: str, colours: str = "viridis") -> Figure:
    """A field of the plane over its coordinates."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    panel = figure.add_subplot()
    x, y = sim.lattice.coordinates()
    drawn = panel.pcolormesh(x, y, field, cmap=colours, shading="nearest")
    panel.set(aspect="equal", xlabel="x", ylabel="y", title=title)
    figure.colorbar(drawn)
    return figure


def two_notches(names: Names) -> Figure:
    sim = names["main"]()
    largest = np.nanmax(np.abs(sim.fields["u"]))
    figure = plane(sim, sim.fields["u"], f"u at t = {sim.time:.0f}", "RdBu_r")
    figure.axes[0].collections[0].set_clim(-largest, largest)
    return figure


def heated_borehole(names: Names) -> Figure:
    dt, times = names["EARLY"]
    sim = names["ground"](dt).run(times[4], progress=False)
    return plane(sim, sim.fields["u"], f"temperature rise in K after {sim.time / 3600:.0f} hours", "inferno")


def insulating_crack(names: Names) -> Figure:
    return plane(sim := names["plate"](0.06), sim.fields["u"], "temperature of the steady state", "inferno")


def double_couple(names: Names) -> Figure:
    """The velocity in the plane of the circle times the distance, and the lobes on the circle beside the exact ones."""
    sim, circle = names["quake"]()
    earlier, _ = names["quake"](until=7.0)
    middle = sim.lattice.shape[2] // 2
    x, y, u, v = (part[:, :, middle] for part in (*sim.lattice.coordinates()[:2], *earlier.fields["v"][:2]))
    x_out, y_out = x - names["AT"][0], y - names["AT"][1]
    ways = {"P waves: radial velocity": u * x_out + v * y_out, "S waves: velocity along circles": v * x_out - u * y_out}
    ring = np.append(names["ANGLES"], names["ANGLES"][:1])
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    for number, (title, field) in enumerate(ways.items()):
        panel = figure.add_subplot(2, 2, number + 1)
        largest = np.abs(field[np.hypot(x_out, y_out) > 1.5]).max()
        panel.pcolormesh(x, y, field, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="gouraud", rasterized=True)
        panel.plot(*(names["AT"][:2, None] + names["RADIUS"] * np.array([np.cos(ring), np.sin(ring)])), "k:", lw=0.8)
        panel.set(aspect="equal", title=f"{title}\ntimes distance, t = {earlier.time:.0f}", xlabel="x", ylabel="y")
        panel = figure.add_subplot(2, 2, number + 3, projection="polar")
        ours, known = (np.abs(names["lobes"](one)[number]) for one in (circle.data["u"], names["exact"](circle.times)))
        panel.plot(ring, np.append(known, known[:1]), "k-", lw=0.8, label="Aki and Richards")
        panel.plot(names["ANGLES"], ours, f"C{number}.", ms=4, label="on the circle")
        panel.set_yticklabels([])
        panel.set_title("largest displacement", pad=16)
        panel.legend(loc="lower left", fontsize="x-small", bbox_to_anchor=(-0.15, -0.1))
    return figure


def shot_record(names: Names) -> Figure:
    """The ground with gun and streamer, and the record, louder the later."""
    sim, streamer = names["shot"]()
    x, y = sim.lattice.coordinates()
    figure = Figure(figsize=(10.0, 4.8), layout="constrained")
    model, record = figure.subplots(1, 2, width_ratios=(1.3, 1))
    drawn = model.pcolormesh(x, -y, names["ground"](sim.lattice), cmap="viridis", shading="nearest", rasterized=True)
    (away, level), (gun, depth) = streamer.points.T, names["GUN"]
    model.plot(away, -level, "C1-", lw=3, label="streamer", clip_on=False)
    model.plot(gun, -depth, "r*", ms=10, label="air gun", clip_on=False)
    model.set(xlabel="x in m", ylabel="depth in m", ylim=(-y.min(), 0), title="speed of sound in m/s")
    model.legend(loc="lower left", fontsize="small")
    figure.colorbar(drawn, ax=model, location="bottom", shrink=0.8)
    louder = streamer.data["u"] * streamer.times[:, None] ** 2
    largest = np.quantile(np.abs(louder), 0.99)
    record.pcolormesh(
        names["OFFSETS"], streamer.times, louder, cmap="gray", vmin=-largest, vmax=largest, shading="nearest"
    )
    # the peak of the pulse by the straight way and by that to the sea floor and back
    for depth, label in ((0.0, "direct wave"), (names["FLOOR"] - names["DEPTH"], "sea floor")):
        arrives = names["PULSE"].delay + np.hypot(names["OFFSETS"], 2 * depth) / names["WATER"]
        record.plot(names["OFFSETS"], arrives, "--", color="C3" if depth else "C0", lw=0.8, label=label)
    record.legend(loc="upper right", fontsize="small", title="by rays", title_fontsize="small")
    record.set(xlabel="offset in m", ylabel="time in s", ylim=(names["UNTIL"], 0), title="shot record, times t squared")
    return figure


def absorbing_gel(names: Names) -> Figure:
    """The wave between the hydrophones, and the absorption beside the power law and the closed form."""
    earlier, _ = names["gel"](until=20 * names["US"])
    _, line = names["gel"]()
    mm, megahertz, per_cm = names["MM"], names["MHZ"], names["DECIBELS"] / 100
    x, y = (part / mm for part in earlier.lattice.coordinates())
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    wave, curve = figure.subplots(1, 2, width_ratios=(1.7, 1))
    largest = np.abs(earlier.fields["u"]).max() / 2
    wave.pcolormesh(x, y, earlier.fields["u"], cmap="RdBu_r", vmin=-largest, vmax=largest, shading="nearest")
    wave.plot(names["HYDROPHONES"] / mm, [0, 0], "ko", ms=4)
    wave.set(aspect="equal", xlabel="x in mm", ylabel="y in mm", title="pressure after 20 µs, and the hydrophones")
    frequency = megahertz * np.geomspace(0.3, 3, 100)
    medium = names["GEL"]
    closed = np.pi * frequency / (medium.quality_at(frequency) * names["SPEED"] * medium.speed_at(frequency))
    curve.loglog(frequency / megahertz, closed * per_cm, color="C0", label="closed form")
    curve.loglog(frequency / megahertz, 3 * (frequency / megahertz) ** names["POWER"], "k:", label="power law")
    measured = names["absorption"](line) * per_cm
    curve.loglog(names["FREQUENCIES"] / megahertz, measured, "o", color="C3", label="measured")
    curve.set(xlabel="frequency in MHz", ylabel="absorption in dB/cm")
    curve.set_xticks([0.3, 1, 3], labels=["0.3", "1", "3"])
    curve.set_xticks([], minor=True)
    curve.legend(fontsize="small")
    return figure


def side_drilled_hole(names: Names) -> Figure:
    """The waves on their way to the hole, what each element received, and the A-scan."""
    sim, probe = names["block"]()
    earlier, _ = names["block"](until=5.2 * names["US"])
    mm, us = names["MM"], names["US"]
    x, y = (part / mm for part in sim.lattice.coordinates())
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    waves, section, scan = figure.subplots(1, 3, width_ratios=(1.3, 1, 1))
    speed = np.hypot(*earlier.fields["v"])
    waves.pcolormesh(x, y, speed, cmap="inferno", vmax=np.nanmax(speed) / 2, shading="nearest")
    waves.plot(*(names["ARRAY"].centres.T / mm), "s", color="C0", ms=4, clip_on=False)
    waves.set(aspect="equal", xlabel="x in mm", ylabel="y in mm")
    waves.set_title(f"speed of the steel at {earlier.time / us:.1f} µs")
    late = probe.times > 5 * us
    normal = probe.data["v"][late, :, 1]
    largest = np.abs(normal).max() / 2
    ticks = np.arange(1, normal.shape[1] + 1)
    section.pcolormesh(ticks, probe.times[late] / us, normal, cmap="gray", vmin=-largest, vmax=largest)
    section.set(xlabel="element", ylabel="time in µs", ylim=(11, 5), title="B-scan: normal velocity")
    total = names["a_scan"](probe)[late]
    scan.plot(total / np.abs(total).max(), probe.times[late] / us, lw=0.8)
    scan.axhline(
        names["echo"](names["a_scan"](probe), probe.times)[1] / us, color="C3", ls=":", label="time of the ray"
    )
    scan.set(ylim=(11, 5), xlabel="sum with delays", title="A-scan")
    scan.legend(loc="upper right", fontsize="x-small")
    return figure


def cylinders(names: Names) -> Figure:
    """Cross sections over frequency, measured at two spacings, beside the series."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    fine = np.linspace(names["FREQUENCIES"][0], names["FREQUENCIES"][-1], 60)
    for panel, rigid in zip(figure.subplots(1, 2), (False, True), strict=True):
        panel.plot(fine, [names["series"](frequency, rigid) for frequency in fine], "k-", lw=0.8, label="Hankel series")
        for spacing, marker in zip(names["SPACINGS"], "so", strict=True):
            _, total = names["measured"](spacing, rigid)
            panel.plot(names["FREQUENCIES"], total, marker, ms=4, label=f"spacing {spacing:g}")
        panel.axhline(4 * names["RADIUS"], color="0.6", ls=":", label="twice the shadow")
        panel.set(title="rigid" if rigid else "soft", xlabel="frequency", ylabel="cross section per length")
    panel.legend(fontsize="small")
    return figure


def penny_crack(names: Names) -> Figure:
    """The temperature, above and below the plane of the crack by themselves: it jumps there."""
    sim = names["ground"](0.0).run(2.0, progress=False)
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    panel = figure.add_subplot()
    x, _, z = sim.lattice.axes
    section = sim.fields["u"][:, sim.lattice.shape[1] // 2] + z
    half, cut = len(z) // 2, np.abs(x) < names["RADIUS"]
    between = section[:, half - 1 : half + 1].mean(1)
    for part in (slice(None, half), slice(half, None)):
        face = np.where(cut, section[:, half if part.stop is None else half - 1], between)
        heights = np.sort(np.append(z[part], 0.0))
        field = np.insert(section[:, part], 0 if part.stop is None else half, face, axis=1)
        drawn = panel.pcolormesh(x, heights, field.T, cmap="RdBu_r", vmin=z[0], vmax=z[-1], shading="gouraud")
        drawn.set_rasterized(True)
        panel.contour(x, heights, field.T, levels=np.linspace(z[0], z[-1], 20), colors="0.2", linewidths=0.4)
    panel.plot([-names["RADIUS"], names["RADIUS"]], [0, 0], "k-", lw=2)
    panel.set(aspect="equal", xlabel="x", ylabel="z", title="temperature in a plane through the centre of the crack")
    figure.colorbar(drawn)
    return figure


def indentation(names: Names) -> Figure:
    sim = names["half_space"](0.006).run(names["UNTIL"])
    figure = plane(sim, sim.fields["damage"], f"damage at t = {sim.time:.0f}", "magma_r")
    figure.axes[0].set(xlim=(-20, 20), ylim=(-12, 0.5))
    figure.set_size_inches(6.4, 2.6)
    return figure


def struck_plate(names: Names) -> Figure:
    """The cracks in both plates, and the velocity of the projectile."""
    figure = Figure(figsize=(9.6, 4.6), layout="constrained")
    *panels, course = figure.subplots(1, 3, width_ratios=(1, 1, 1.2))
    for panel, name in zip(panels, names["SIDES"], strict=True):
        sim, motion = names["struck"](name)
        x, y = (axis / names["MM"] for axis in sim.lattice.coordinates())
        panel.pcolormesh(x, y, sim.fields["damage"], cmap="magma_r", vmin=0, vmax=0.6, shading="nearest")
        panel.set(aspect="equal", xlabel="x in mm", title=f"damage, {name}")
        course.plot(motion.times / names["US"], motion.data["velocity"][:, 0, 0], label=name)
    panels[0].set_ylabel("y in mm")
    course.set(xlabel="time in µs", title="velocity of the projectile in m/s")
    course.legend()
    return figure


def quenched_face(names: Names) -> Figure:
    """Cracks that run in from a cold face, at three times."""
    return names["drawn"]()


def mesh_scatterer(names: Names) -> Figure:
    near = names["mesh"](names["NEAR"])
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, edge in zip(panels, ("plane waves, wide clouds", "fixed"), strict=True):
        u = names["run"](near, edge)[-1]
        drawn = panel.tripcolor(*near.p, near.t.T, u, cmap="RdBu_r", vmin=-0.1, vmax=0.1, shading="gouraud")
        panel.set(aspect="equal", xlabel="x", title=f"closed by {edge}" if edge != "fixed" else "fixed edge")
    figure.colorbar(drawn, ax=panels)
    return figure


def disc_of_quadrilaterals(names: Names) -> Figure:
    """The mesh, and the errors with three conditions on its circle."""
    mesh = names["disc"](8)
    figure = Figure(figsize=(7.6, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.add_collection(PolyCollection(mesh.p.T[mesh.t.T], facecolor="none", edgecolor="0.4", linewidth=0.6))
    left.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), xlabel="x", ylabel="y")
    for rim, marker in (("insulated", "s"), ("fixed", "^"), ("fitted", "o")):
        right.semilogy(names["TIMES"], names["errors"](8, rim), marker + "-", label=rim)
    right.set(xlabel="t", ylabel="largest error / largest value")
    right.legend()
    return figure


def hidden_inclusion(names: Names) -> Figure:
    """The true speed, and what was found with a layer and with a sponge on all sides."""
    found = {"true speed": names["TRUTH"]}
    found |= {f"found, with a {name}": names["maps"][name] for name in ("layer", "sponge")}
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for panel, (title, speed) in zip(panels, found.items(), strict=True):
        drawn = panel.imshow(speed.T, origin="lower", extent=(-24, 24, -24, 24), vmin=0.95, vmax=1.25)
        panel.plot(*names["ring"](32, 17.0).T, "w.", markersize=3)
        panel.set(title=title, xlabel="x")
    panels[0].set_ylabel("y")
    figure.colorbar(drawn, ax=panels, label="speed")
    return figure


def released_heat(names: Names) -> Figure:
    """The temperature at t = 0 that was found, with the true places and the sensors."""
    misfit = names["measured"]()
    figure = Figure(figsize=(5.4, 4.4), layout="constrained")
    panel = figure.add_subplot()
    drawn = panel.imshow(names["released"](misfit).T, cmap="inferno", origin="lower", extent=(-10, 10, -10, 10))
    panel.plot(*misfit.receivers.points.T, "w.", markersize=3, label="sensors")
    panel.plot(*np.array(list(names["SPOTS"])).T, "c+", markersize=10, label="true places")
    panel.set(title="temperature at t = 0, from what was measured later", xlabel="x", ylabel="y")
    panel.legend(loc="upper right", fontsize="small")
    figure.colorbar(drawn)
    return figure


def event_location(names: Names) -> Figure:
    """Where the reversed records meet, with what was found; and the seismograms at the surface beside those of it."""
    misfit, (stations, place) = names["seismograms"](), (np.array(names["STATIONS"]), names["PLACE"])
    image = fh.image([(names["ground"](), misfit)], names["UNTIL"], show="sources")
    first = names["meeting"](image)
    found, tensor = names["located"](misfit, first)
    line = fh.Receivers(stations)
    event = fh.MomentTensor(found, tensor, names["PULSE"])
    fh.Simulation.of(names["ground"](event), observe=[line]).run(names["UNTIL"], progress=False)
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    section, records = figure.subplots(1, 2, width_ratios=(1.5, 1))
    x, y = names["LATTICE"].coordinates()
    near = np.min([np.hypot(x - a, y - b) for a, b in stations], axis=0)
    largest = image[near > 6.0].max()
    drawn = section.pcolormesh(x, y, image / largest, cmap="magma", vmin=0.3, vmax=1.0, shading="gouraud")
    section.plot(*stations.T, "wv", ms=7, mec="k", label="stations", clip_on=False)
    section.plot(*first, "o", color="C9", ms=8, mfc="none", mew=1.5, label="records meet")
    section.plot(*place, "+", color="w", ms=16, mew=2, label="true place")
    section.plot(*found, "x", color="C2", ms=8, mew=2, label="by the gradient")
    legend = section.legend(loc="lower left", fontsize="small", framealpha=0.85, facecolor="0.6")
    legend.set_zorder(5)
    section.set(aspect="equal", xlabel="x", ylabel="y", title="largest displacement of the reversed records")
    figure.colorbar(drawn, ax=section, shrink=0.7)
    at_surface = stations[:, 1] == 0
    louder = 3.5 / np.abs(misfit.data["u"][:, at_surface, 1]).max()
    for number in np.flatnonzero(at_surface):
        for values, style in ((misfit.data["u"], "k-"), (line.data["u"], "C2-")):
            records.plot(stations[number, 0] + louder * values[:, number, 1], line.times, style, lw=0.8)
    records.plot([], [], "k-", label="with noise")
    records.plot([], [], "C2-", label="of the event that was found")
    records.set(xlabel="x", ylabel="t", title="vertical displacement at the surface", ylim=(names["UNTIL"], 0))
    records.legend(loc="upper right", fontsize="x-small")
    return figure


def surface_array(names: Names) -> Figure:
    """What the array records of one burst beside that of sound ground, and the image of all bursts with the crack."""
    shots, middle = names["shots"](), 4
    setup, misfit = shots[middle]
    line = fh.Receivers(names["ELEMENTS"])
    fh.Simulation.of(setup, observe=[line]).run(names["UNTIL"], progress=False)
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    record, section = figure.subplots(1, 2, width_ratios=(1, 1.7))
    echo = misfit.data["u"] - line.data["u"]
    largest = np.abs(echo).max()
    record.pcolormesh(
        names["ELEMENTS"][:, 0], line.times, echo, cmap="gray", vmin=-largest, vmax=largest, shading="nearest"
    )
    record.plot(setup.sources[0].at[0], 0, "r*", ms=10, clip_on=False, label="sends")
    record.set(xlabel="element at x", ylabel="t", title="echoes of one burst", ylim=(names["UNTIL"], 0))
    record.legend(loc="lower left", fontsize="small")
    x, y = names["LATTICE"].coordinates()
    image = names["imaged"](shots)
    image = image / np.abs(image).max()
    drawn = section.pcolormesh(x, y, image, cmap="RdBu_r", vmin=-1, vmax=1, shading="gouraud")
    section.plot(*names["CRACK"].T, "k-", lw=1.5, label="crack")
    section.plot(*names["ELEMENTS"].T, "v", color="0.3", ms=4, clip_on=False, label="array")
    sending = np.array([shot.sources[0].at for shot, _ in shots])
    section.plot(*sending.T, "r*", ms=9, clip_on=False, label="sends")
    section.set(aspect="equal", xlabel="x", ylabel="y", title="reverse-time image of all bursts", ylim=(-46, 0))
    section.legend(loc="lower left", fontsize="small")
    figure.colorbar(drawn, ax=section, shrink=0.7)
    return figure


def layered_inversion(names: Names) -> Figure:
    """The ground, the start, what was found, and the records of a gun in the middle."""
    shots = names["given"]
    shown = {"true ground": names["truth"](), "start": names["START"], "found": names["found"]}
    _, misfit = shots[len(shots) // 2]
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    panels = figure.subplots(2, 2)
    x, y = names["X"], names["Y"]
    for panel, (title, speed) in zip(panels.flat, shown.items(), strict=False):
        drawn = panel.pcolormesh(x, -y, speed, cmap="viridis", vmin=1500, vmax=2600, shading="nearest", rasterized=True)
        panel.set(title=title, xlabel="x in m", ylabel="depth in m", ylim=(990, 0), xlim=(0, 2990))
    guns = np.array([shot.sources[0].at for shot, _ in shots])
    panels[0, 0].plot(guns[:, 0], -guns[:, 1], "r*", ms=9, clip_on=False, label="guns")
    panels[0, 0].plot(*(misfit.receivers.points * (1, -1)).T, "w.", ms=1.5, label="hydrophones")
    panels[0, 0].legend(loc="lower left", fontsize="small", facecolor="0.6")
    figure.colorbar(drawn, ax=panels, label="speed of sound in m/s", shrink=0.7)
    data, record = misfit.data["u"], panels[1, 1]
    times, places = names["DT"] * np.arange(len(data)), misfit.receivers.points[:, 0]
    louder = data * times[:, None] ** 2
    largest = np.quantile(np.abs(louder), 0.98)
    record.pcolormesh(
        places, times, louder, cmap="gray", vmin=-largest, vmax=largest, shading="nearest", rasterized=True
    )
    record.set(
        xlabel="x in m", ylabel="time in s", ylim=(names["UNTIL"], 0), title="record of one gun, times t squared"
    )
    return figure


class Kept:
    """A function that remembers its results by its arguments: arrays by their values, other objects by themselves."""

    def __init__(self, function: FunctionType) -> None:
        self.function = function
        self.results: dict[Any, Any] = {}

    def __call__(self, *args: Any, **named: Any) -> Any:
        key = tuple(map(_mark, args)), tuple((name, _mark(value)) for name, value in sorted(named.items()))
        if key not in self.results:
            self.results[key] = self.function(*args, **named), args, named  # no other object takes a place of these
        return self.results[key][0]


def _mark(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return value if isinstance(value, (str, float, int, bool)) else id(value)


def executed(script: Path) -> Names:
    """Run a script, which prints, and return the names in it."""
    tree = ast.parse(script.read_text(encoding="utf-8"), str(script))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name in KEPT:
            node.decorator_list.append(ast.Name("Kept", ast.Load()))
    names: Names = {"__name__": "__main__", "__file__": str(script), "__doc__": ast.get_docstring(tree), "Kept": Kept}
    exec(compile(ast.fix_missing_locations(tree), str(script), "exec"), names)
    return names


def main() -> None:
    script, picture = map(Path, sys.argv[1:])
    sys.argv = [str(script)]
    globals()[script.stem](executed(script)).savefig(picture, dpi=150)


if __name__ == "__main__":
    main()
