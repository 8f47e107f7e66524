"""A finite-element mesh closed by plane waves: a pulse in a disc of triangles with a hole that scatters it.

u_tt = laplace u in 2D, with the speed 1, by linear triangles (scikit-fem) with lumped masses and explicit steps. The
near field is the part of a mesh within radius 1; the rim of the hole is free. The nodes on the outer rim have the
values that `update_matrix` fits to outgoing plane waves, which requires nodes and normals but no lattice. Wider clouds
with normals rotated to multiples of 45 degrees reflect less, but only if the nodes are nearly regular, as here;
otherwise they lead to growth. A mesh three times as wide represents the infinite medium until waves return from its
rim.

Prints the largest error next to those of a fixed and of a free rim. Takes some seconds:
``python examples/mesh_scatterer.py``.
"""

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, ElementTriP1, MeshTri
from skfem.helpers import dot, grad

import farhorizon as fh

WIDE, NEAR, HOLE = 3.0, 1.0, (0.35, 0.0, 0.2)  # radii of the meshes; position and radius of the hole
PULSE, WIDTH = (-0.35, 0.1), 0.12
TIMES = (1.0, 1.5, 2.0, 2.5, 3.0)


def mesh(radius):
    """Mesh of those triangles of a large disc whose centres lie within a radius and outside the hole."""
    whole = MeshTri.init_circle(6).scaled(WIDE)
    x, y = whole.p[:, whole.t].mean(1)
    inside = (np.hypot(x, y) < radius) & (np.hypot(x - HOLE[0], y - HOLE[1]) > HOLE[2])
    return whole.restrict(np.flatnonzero(inside))


def operator(triangles):
    """Matrix of the acceleration: minus stiffness over lumped mass."""
    basis = Basis(triangles, ElementTriP1())
    stiffness = BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    mass = BilinearForm(lambda u, v, _: u * v).assemble(basis)
    return -sparse.diags(1 / np.asarray(mass.sum(1)).ravel()) @ stiffness


def outer_nodes(triangles):
    """Nodes on the outer rim."""
    rim = triangles.boundary_nodes()
    return rim[np.hypot(*triangles.p[:, rim]) > 0.5 * (NEAR + np.hypot(*HOLE[:2]))]


SPACING = WIDE / 64  # of interior nodes
CLOSED = {
    "plane waves": fh.PlaneWave(),
    "plane waves, wide clouds": fh.PlaneWave(radius=3 * SPACING, normals="lattice"),
}
STEP = 0.004  # an eighth of the step limit


def run(triangles, rim="free"):
    """Fields at `TIMES` by velocity Verlet from rest; the outer rim is "free", "fixed" or one of `CLOSED`."""
    points, outer, a = triangles.p.T, outer_nodes(triangles), operator(triangles)
    closing = (
        fh.update_matrix(points, outer, points[outer], fh.Medium(2, 1.0, STEP), CLOSED[rim]) if rim in CLOSED else None
    )
    u = np.exp(-((points[:, 0] - PULSE[0]) ** 2 + (points[:, 1] - PULSE[1]) ** 2) / WIDTH**2)
    before = u + STEP**2 / 2 * (a @ u)
    found, steps = [], 0
    for t in TIMES:
        while steps < round(t / STEP):
            new = 2 * u - before + STEP**2 * (a @ u)
            if rim != "free":
                new[outer] = 0 if closing is None else closing @ np.concatenate([u, before])
            before, u = u, new
            steps += 1
        found.append(u)
    return found


def errors():
    """Largest error over the near field at each time, relative to the largest initial value, for each rim."""
    near, wide = mesh(NEAR), mesh(WIDE)
    _, same = cKDTree(wide.p.T).query(near.p.T)
    exact = run(wide)
    rims = (*CLOSED, "fixed", "free")
    return {rim: [float(np.abs(u - e[same]).max()) for u, e in zip(run(near, rim), exact, strict=True)] for rim in rims}


if __name__ == "__main__":
    print(f"{'t':26}" + "".join(f"{t:>10g}" for t in TIMES))
    for rim, values in errors().items():
        print(f"{rim:26}" + "".join(f"{value:>10.1e}" for value in values))
