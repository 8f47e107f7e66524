"""An ultrasonic A-scan of a steel block with a side-drilled hole by a phased array (SI units).

Physics: sixteen elements on the free surface of a block push one after the other, such that their longitudinal waves
meet in a hole of 3 mm, drilled across the plane 20 mm below. The same elements receive the echoes, which are added with
the same delays. The block is unbounded at its sides and at the bottom. It is in plane strain, of a state-based material
with Poisson's ratio of steel, 0.29.

Prints the arrival time of the echo from the hole, next to the travel time of longitudinal waves to its top and back.

Run: ``python examples/side_drilled_hole.py``; about half a minute.
"""

import numpy as np

import farhorizon as fh

MM, US = 1e-3, 1e-6
SPACING, UNTIL = 0.15 * MM, 11 * US
HOLE, RADIUS = np.array([3.0 * MM, -20.0 * MM]), 1.5 * MM
BURST = fh.ToneBurst(1e6, 3)
STEEL = fh.Elastic(fh.Kernel(2 * SPACING), young=206e9, poisson=0.29, density=7850.0, material="state-based")
ARRAY = fh.PhasedArray(
    (-9.0 * MM, 0.0), (9.0 * MM, 0.0), 16, (0.0, -1e6), BURST, speed=STEEL.p_speed, focus=HOLE, width=0.9 * MM
)


def block(hole: bool = True, until: float = UNTIL) -> tuple[fh.Simulation, fh.Receivers]:
    """Run the simulation; return it and the receivers in the middle of the elements."""
    lower, upper = (-18.0 * MM, -26.1 * MM), (18.0 * MM, 0.0)
    around = fh.Box(lower, upper)
    body = around - fh.Disc(RADIUS, HOLE) if hole else None
    probe = fh.Receivers(ARRAY.centres, record="v")
    sim = fh.Simulation(
        fh.Lattice(SPACING, lower, upper, body=body),
        STEEL,
        boundary={"all": fh.LatticePML(nodes=16), "y+": fh.Free()},
        sources=[ARRAY],
        observe=[probe],
    )
    return sim.run(until, progress=False), probe


def a_scan(probe: fh.Receivers) -> np.ndarray:
    """Sum of the normal velocities of the elements, each delayed as much as its push; shape (rows,)."""
    normal = probe.data["v"][:, :, 1]
    late = [
        np.interp(probe.times - d, probe.times, one, left=0.0) for d, one in zip(ARRAY.delays, normal.T, strict=True)
    ]
    return np.sum(late, axis=0)


def echo(scan: np.ndarray, times: np.ndarray) -> tuple[float, float]:
    """Arrival time of the largest echo, from its envelope, and the expected time; the delays compensate for the
    different distances of the elements from the focus.
    """
    from scipy.signal import hilbert

    latest = ARRAY.delays.max() + np.linalg.norm(ARRAY.centres - HOLE, axis=1).min() / STEEL.p_speed
    expected = 2 * (latest - RADIUS / STEEL.p_speed) + BURST.end / 2
    late = times > 5 * US  # the surface has come to rest
    return float(times[late][np.abs(hilbert(scan[late])).argmax()]), float(expected)


def main() -> tuple[fh.Simulation, fh.Receivers]:
    sim, probe = block()
    report = sim.check(until=UNTIL)
    print(f"shortest wave: {dict(report.rows)['shortest wave']}")
    found, expected = echo(a_scan(probe), probe.times)
    print(f"echo of the hole at {found / US:.2f} us, by the way to its top and back {expected / US:.2f} us")
    return sim, probe


if __name__ == "__main__":
    main()
