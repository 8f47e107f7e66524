"""Diffusion on a disc of conforming quadrilaterals, closed by the condition of Shojaei et al. (2020).

u_t = laplace u in the plane, with the diffusivity 1, by bilinear elements (figure 5b of the paper) with lumped masses
and forward Euler. The elements follow the circle; only the nodes on it are absorbing: `fh.update_matrix` fits their
next values to modes that decay outwards, from a cloud of nodes around each, and requires nodes and normals but no
lattice. In clouds of irregular nodes some modes are nearly equal: the pseudo-inverse cuts them off (`rcond`), without
which they grow.

Prints the largest error over the disc, relative to the largest value at that time, against the closed form in the
infinite plane, next to those of a fixed and of an insulated circle. Takes some seconds:
``python examples/disc_of_quadrilaterals.py``.
"""

import numpy as np
from scipy import sparse
from skfem import Basis, BilinearForm, ElementQuad1, MeshQuad
from skfem.helpers import dot, grad

import farhorizon as fh

CENTRE, WIDTH = (0.2, -0.1), 0.25  # of the initial pulse, in a disc of radius 1
RADIUS = 1.2  # of clouds, times count: beyond the next row of nodes, which is up to 0.8 / count away
TIMES = (0.1, 0.2, 0.4)  # R^2 / (10 D) and later


def disc(count):
    """Mesh of 5 count^2 elements: a square with curved edges, and four blocks from its edges to the circle."""
    side = np.linspace(-1, 1, count + 1)
    s, t = (a.ravel() for a in np.meshgrid(side, side, indexing="ij"))
    bulge = 0.45 + 0.1 * (1 - np.stack([t, s]) ** 2)  # edges of the inner square, bent outwards
    blocks = [np.stack([s, t]) * bulge]
    angle, out = np.pi / 4 * t, (s + 1) / 2
    inner, outer = np.stack([0.45 + 0.1 * (1 - t**2), 0.45 * t]), np.stack([np.cos(angle), np.sin(angle)])
    x, y = (1 - out) * inner + out * outer
    blocks += [np.stack([x, y]), np.stack([-y, x]), np.stack([-x, -y]), np.stack([y, -x])]
    first = np.arange(count + 1)[:-1, None] * (count + 1) + np.arange(count)
    cells = np.stack([first, first + count + 1, first + count + 2, first + 1]).reshape(4, -1)
    points, where = np.unique(np.round(np.hstack(blocks), 9), axis=1, return_inverse=True)
    cells = np.hstack([cells + k * (count + 1) ** 2 for k in range(5)])
    return MeshQuad(points, where.ravel()[cells])


def operator(mesh):
    """Matrix of the rate: minus stiffness over lumped mass."""
    basis = Basis(mesh, ElementQuad1())
    stiffness = BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    mass = BilinearForm(lambda u, v, _: u * v).assemble(basis)
    return -sparse.diags(1 / np.asarray(mass.sum(1)).ravel()) @ stiffness


def exact(points, t):
    """Closed form in the infinite plane."""
    spread = WIDTH**2 + 4 * t
    return WIDTH**2 / spread * np.exp(-((points - CENTRE) ** 2).sum(1) / spread)


def errors(count, rim):
    """Largest error at each of `TIMES` over the largest value, with a "fitted", "fixed" or "insulated" circle."""
    mesh = disc(count)
    points, circle, a = mesh.p.T, mesh.boundary_nodes(), operator(mesh)
    dt = 0.5 / np.abs(a.diagonal()).max()
    if rim == "fitted":
        cloud = fh.PlaneWave(radius=RADIUS / count, wavenumber=2.0, rcond=1e-3)
        matrix = fh.update_matrix(points, circle, points[circle], fh.Medium(1, 1.0, dt), cloud)
    u, step, found = exact(points, 0.0), 0, []
    for t in TIMES:
        for _ in range(round(t / dt) - step):
            new = u + dt * (a @ u)
            if rim != "insulated":
                new[circle] = matrix @ u if rim == "fitted" else 0.0
            u, step = new, step + 1
        there = exact(points, step * dt)
        found.append(float(np.abs(u - there).max() / there.max()))
    return found


if __name__ == "__main__":
    print(f"{'t':34}" + "".join(f"{t:>9g}" for t in TIMES))
    for rim, count in (("fitted", 8), ("fitted", 16), ("fixed", 16), ("insulated", 16)):
        print(f"{rim + f', {5 * count**2} elements':34}" + "".join(f"{e:>9.1e}" for e in errors(count, rim)))
