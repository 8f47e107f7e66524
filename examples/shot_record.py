"""A marine shot record over layered ground that is given as an array of speeds (SI units).

Physics: an air gun 10 m below the surface of the sea, whose pressure is zero, and a streamer of hydrophones 12.5 m
apart at the same depth. Below 280 m of water lie two layers of sediment and an anticline of rock. The ground is an
array of speeds on the nodes, such as one read from a file; the density is constant.

Neither the gun nor the hydrophones lie on columns of nodes. Prints what `check` reports about the shortest wave, the
difference of the direct wave and its image in the surface from the exact ones, and the time of the echo from the sea
floor.

Run: ``python examples/shot_record.py``; about ten seconds.
"""

import numpy as np

import farhorizon as fh
from farhorizon.analysis.references.full_space import scalar_wave_in_the_plane

SPACING, UNTIL = 5.0, 1.5
WATER, DEPTH, FLOOR = 1480.0, 10.0, 282.5  # the floor lies between two nodes
GUN, STRENGTH = (303.0, -DEPTH), 1e9
PULSE = fh.Ricker(14.0)
OFFSETS = np.arange(100.0, 1700.1, 12.5)


def ground(lattice: fh.Lattice) -> np.ndarray:
    """Speed of sound in m/s at the nodes."""
    x, y = lattice.coordinates()
    fold = np.exp(-(((x - 1250.0) / 300.0) ** 2))
    depths = [FLOOR, 480.0, 800.0 - 180.0 * fold]
    return np.select([-y < depth for depth in depths], [WATER, 1750.0, 2150.0], 2700.0)


def shot(until: float = UNTIL) -> tuple[fh.Simulation, fh.Receivers]:
    """Run the simulation; return it and the receivers of the streamer."""
    lattice = fh.Lattice(SPACING, (0.0, -1100.0), (2400.0, -SPACING))  # held nodes at the surface lie beyond
    streamer = fh.Receivers(np.column_stack([GUN[0] + OFFSETS, np.full(OFFSETS.size, -DEPTH)]))
    sim = fh.Simulation(
        lattice,
        fh.Wave(fh.Stencil.finite_difference(2), speed=ground(lattice)),
        boundary={"all": fh.LatticePML(nodes=16), "y+": fh.Fixed(0.0)},
        sources=[fh.PointSource(GUN, STRENGTH, PULSE)],
        observe=[streamer],
    )
    return sim.run(until, progress=False), streamer


def direct(streamer: fh.Receivers) -> tuple[np.ndarray, np.ndarray]:
    """Records of the first hydrophones before the echo from the sea floor arrives, and the exact direct wave minus its
    image in the surface; zeros later. Both have the shape (rows, hydrophones).
    """
    near = OFFSETS < 300.0
    times, offsets = streamer.times, OFFSETS[near]
    before = times[:, None] < np.hypot(offsets, 2 * (FLOOR - DEPTH)) / WATER
    known = [
        STRENGTH
        * (
            scalar_wave_in_the_plane(offset, times, PULSE, WATER)
            - scalar_wave_in_the_plane(np.hypot(offset, 2 * DEPTH), times, PULSE, WATER)
        )
        for offset in offsets
    ]
    return before * streamer.data["u"][:, near], before * np.transpose(known)


def main() -> tuple[fh.Simulation, fh.Receivers]:
    sim, streamer = shot()
    report = sim.check(until=UNTIL)
    print(f"shortest wave: {dict(report.rows)['shortest wave']}")
    ours, known = direct(streamer)
    error = np.abs(ours - known).max() / np.abs(known).max()
    print(f"direct wave and its image in the surface: {100 * error:.1f} % from the exact ones")
    echo = streamer.data["u"][:, 0] * (streamer.times > np.hypot(OFFSETS[0], 2 * (FLOOR - DEPTH)) / WATER)
    print(f"largest echo at an offset of {OFFSETS[0]:.0f} m: {1e3 * streamer.times[np.abs(echo).argmax()]:.0f} ms")
    return sim, streamer


if __name__ == "__main__":
    main()
