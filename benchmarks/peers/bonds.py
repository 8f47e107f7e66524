"""The same block of breakable peridynamic bonds by farhorizon and by LAMMPS (package PERI, pair style peri/pmb).

A free cube of a prototype microelastic brittle solid with 122 bonds a node, of which the outermost count in part, as
LAMMPS weighs them. A pulse of velocity in its middle strains it far below the stretch at which bonds break. Both
programs advance the same equations by velocity Verlet, so the difference of their displacements is that of two
roundings and of the few digits that strains leave of positions. The table has processor times a node and step, of the
difference of a long and a short run, on one process and one thread.

LAMMPS is a program, ``lmp`` (Debian: ``apt-get install lammps``). Run: ``python benchmarks/peers/bonds.py [--json
FILE] [--repeats N]``. Takes two minutes.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from one_thread import save, table

import farhorizon as fh

NODES, SPACING, HORIZON = 31, 5e-4, 3.0015  # a side; in m; in spacings: between the shells at 3 and at the root of 10
DENSITY, MICROMODULUS, STRETCH = 2200.0, 1.6863e22, 0.25  # of the glass of LAMMPS' own example
DT, SPEED, WIDTH = 1e-7, 0.01, 1.5e-3  # s, m/s, m
SHORT, LONG = 10, 110  # steps

SCRIPT = """units si
boundary s s s
atom_style peri
atom_modify map array
neighbor {skin} bin
lattice sc {spacing}
region block block -{half} {half} -{half} {half} -{half} {half} units box
create_box 1 block
create_atoms 1 region block
pair_style peri/pmb
pair_coeff * * {micromodulus} {horizon} {stretch} 0.0
set group all density {density}
set group all volume {volume}
variable vx atom "{speed}*exp(-(x*x+y*y+z*z)/{width}^2)"
velocity all set v_vx 0.0 0.0
fix 1 all nve
thermo 1000000
timestep {dt}
run {steps}
write_dump all custom {dump} x y z modify format float %20.17g sort id
"""


def part_of_cell(distance: np.ndarray) -> np.ndarray:
    """Part of a cell that counts, by its distance over the horizon: LAMMPS' ramp over the last half spacing."""
    return np.clip(HORIZON + 0.5 - HORIZON * distance, 0.0, 1.0)


def young(kernel: fh.Kernel) -> float:
    """Young's modulus for which our bonds are LAMMPS': both are proportional to it, and bonds of one spacing along x
    are compared.
    """
    stencil = fh.Elastic(kernel, 1.0).stencil(SPACING, 3)
    [bond] = np.flatnonzero((np.asarray(stencil.offsets) == (1, 0, 0)).all(axis=1))
    ours = 1.2 * float(np.asarray(stencil.weights)[bond, 0, 0]) / SPACING**2  # 1.2: the P-wave modulus, its unit
    return MICROMODULUS * SPACING**3 / SPACING / ours


def by_lammps(steps: int) -> tuple[np.ndarray, float]:
    """Displacements along x, (n, n, n), after some steps, and the processor time."""
    with tempfile.TemporaryDirectory() as folder:
        dump = Path(folder) / "end.dump"
        text = SCRIPT.format(
            skin=0.2 * SPACING,
            spacing=SPACING,
            half=(NODES // 2 + 0.01) * SPACING,
            micromodulus=MICROMODULUS,
            horizon=HORIZON * SPACING,
            stretch=STRETCH,
            density=DENSITY,
            volume=SPACING**3,
            speed=SPEED,
            width=WIDTH,
            dt=DT,
            steps=steps,
            dump=dump,
        )
        (Path(folder) / "in.block").write_text(text)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = ["lmp", "-in", "in.block", "-log", "none", "-screen", "none"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        places = np.array([line.split() for line in dump.read_text().splitlines()[9:]], float)
    nodes = np.round(places / SPACING)
    order = np.lexsort(nodes.T[::-1])
    moved = places[order, 0] - SPACING * nodes[order, 0]
    return moved.reshape((NODES,) * 3), after.ru_utime - before.ru_utime


def simulation() -> fh.Simulation:
    """The same block."""
    half = NODES // 2 * SPACING
    kernel = fh.Kernel(HORIZON * SPACING, exponent=1, influence=part_of_cell, volume="full", calibrate=False)
    model = fh.Elastic(kernel, young(kernel), density=DENSITY, critical_stretch=STRETCH)
    pulse = f"{SPEED}*exp(-(x**2+y**2+z**2)/{WIDTH}**2)"
    lattice = fh.Lattice(SPACING, (-half,) * 3, (half,) * 3)
    return fh.Simulation(lattice, model, fh.Free(), {"v": [pulse, "0", "0"]}, dt=DT, threads=1)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers here, too")
    parser.add_argument("--repeats", type=int, default=3, help="repeats of each timing (default 3)")
    given = parser.parse_args()
    if shutil.which("lmp") is None:
        parser.error("no program lmp: apt-get install lammps")
    sim = simulation()
    sim.step(LONG)
    ours = sim.fields["u"][0]
    theirs = by_lammps(LONG)[0]
    difference = float(np.abs(ours - theirs).max() / np.abs(ours).max())
    times: dict[str, list[float]] = {"farhorizon": [], "LAMMPS peri/pmb": []}
    for _ in range(given.repeats):
        begin = time.process_time()
        sim.step(LONG - SHORT)
        times["farhorizon"].append(time.process_time() - begin)
        times["LAMMPS peri/pmb"].append(by_lammps(LONG)[1] - by_lammps(SHORT)[1])
    rows = [
        {
            "122 bonds": name,
            "ns a node and step": 1e9 * statistics.median(spent) / (LONG - SHORT) / NODES**3,
            "times ours": statistics.median(a / b for a, b in zip(spent, times["farhorizon"], strict=True)),
            "difference": difference,
        }
        for name, spent in times.items()
    ]
    table(f"Steps of {NODES}^3 nodes with bonds that may break, one thread", rows)
    save(given.json, rows)


if __name__ == "__main__":
    main()
