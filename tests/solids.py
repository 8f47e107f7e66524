"""A correspondence solid computed independently, with one matrix entry per bond."""

import itertools

import numpy as np

from farhorizon import Correspondence, Kernel, Lattice

KERNELS = {
    "gaussian": Kernel(2.7, 0, "gaussian", 0.9, volume="full"),
    "constant": Kernel(2.1, 0, volume="full"),
    "ramp": Kernel(2.0, 1),
}
MATERIAL = {"young": 1.0, "poisson": 0.25}


def lame_constants(young, poisson):
    """Return Lame's constants in plane strain and in 3D, as numbers or arrays."""
    shear = young / (2 * (1 + poisson))
    return 2 * shear * poisson / (1 - 2 * poisson), shear


def solid(name, **options):
    """Return a correspondence solid with one of the kernels."""
    return Correspondence(**{"kernel": KERNELS[name], **MATERIAL, **options})


def box(*nodes, lower=0.0):
    return Lattice(1.0, (lower,) * len(nodes), tuple(lower + n - 1.0 for n in nodes))


class Dense:
    """The same solid with one matrix entry per bond. It is free, or surrounded by `around` rows of held nodes; with
    two reaches of them the nodes next to them have all their bonds.

    Weights are taken from the kernel's own influence function and volumes, and scaled so that K of a complete family
    is 1. `material` gives Young's modulus, Poisson's ratio and density at given coordinates; beyond the shape the
    values at its edge apply. Bonds break by their stretch, or by their energy if `by_energy`; shape tensors are those
    of the remaining bonds, of the initial bonds if `by_energy`, or of all bonds of the uncracked body if `kept`.
    Nodes with few bonds carry less of their stress, or all of it if `unweakened`.
    """

    def __init__(
        self,
        shape,
        kernel,
        around=0,
        absent=None,
        drag=0.0,
        stabilisation=0.0,
        critical=1e9,
        kept=False,
        unweakened=False,
        by_energy=False,
        dt=0.1,
        material=None,
    ):
        grid = np.array(list(itertools.product(*[range(-around, n + around) for n in shape])), float)
        self.inside = ((grid >= 0) & (grid < shape)).all(1)
        self.shape, self.dim, self.dt, self.drag, self.critical = shape, len(shape), dt, drag, critical
        self.by_energy, self.frozen, self.unweakened = by_energy, by_energy or kept, unweakened
        self.xi = grid[None] - grid[:, None]
        family = np.array([o for o in itertools.product(range(-4, 5), repeat=self.dim) if any(o)], float)
        lengths = np.linalg.norm(family, axis=1)
        scale = (self._weight(kernel, lengths) * family[:, 0] ** 2).sum()
        self.longest = lengths[self._weight(kernel, lengths) > 0].max()
        self.w = self._weight(kernel, np.linalg.norm(self.xi, axis=2)) / scale
        np.fill_diagonal(self.w, 0)
        self.uncut = self.w.copy()
        if absent is not None:
            self.w = np.where(absent(grid[:, None], grid[None]), 0.0, self.w)
        young, poisson, self.density = (
            (1.0, 0.25, 1.0) if material is None else material(*np.clip(grid, 0, np.array(shape) - 1).T)
        )
        lame, shear = (np.broadcast_to(value, len(grid)) for value in lame_constants(young, poisson))
        self.lame, self.shear, self.pull = (
            np.array(value)[:, None, None] for value in (lame, shear, stabilisation * (lame + 2 * shear))
        )
        self.density = np.broadcast_to(self.density, len(grid))[:, None]
        self._invert(self.uncut if kept else self.w)
        self.u, self.v = np.zeros((2, len(grid), self.dim))
        self.steps = 0

    @staticmethod
    def _weight(kernel, r):
        share = np.clip(kernel.horizon + 0.5 - r, 0, 1) if kernel.volume == "ramp" else r <= kernel.horizon
        return kernel.influence_at(r) * share / np.maximum(r, 1e-9) ** kernel.exponent * (r > 0)

    def _invert(self, w):
        tensor = np.einsum("ij,ija,ijb->iab", w, self.xi, self.xi)
        good = np.linalg.det(tensor) >= 1e-3
        self.inverse = np.zeros_like(tensor)
        self.inverse[good] = np.linalg.inv(tensor[good])
        mean = np.where(good, self.dim / (1 / np.maximum(np.linalg.eigvalsh(tensor), 1e-9)).sum(1), 1.0)
        self.first = getattr(self, "first", mean)
        left = np.ones(len(mean)) if self.unweakened else np.minimum(1, (2 * mean / self.first) ** 2)
        self.left = left[:, None, None]

    def gradient(self):
        return np.einsum("ij,ija,ijb->iab", self.w, self.u[None] - self.u[:, None], self.xi) @ self.inverse

    def law(self, e, lame, shear):
        trace = np.trace(e, axis1=-2, axis2=-1)[..., None, None]
        return shear * (e + np.swapaxes(e, -1, -2)) + lame * trace * np.eye(self.dim)

    def states(self):
        e = self.gradient()
        return self.left * self.law(e, self.lame, self.shear) @ self.inverse - self.pull * e

    def lost(self, eta, p):
        """Return the energy lost with each bond, from elongations and the states of its first end."""
        own = self.w[..., None, None] * eta[..., :, None] * self.xi[..., None, :]
        lame, shear, pull = (value[:, None] + value[None] for value in (self.lame, self.shear, self.pull))
        states = p + np.swapaxes(p, 0, 1) - (self.law(own, lame, shear) - pull * own) / 2
        return (own * states).sum((2, 3)) + self.w * pull[..., 0, 0] * (eta**2).sum(2) / 2

    def beyond(self):
        """Return which bonds break; by energy, the limit is that of an intact body under uniform dilatation."""
        eta, lengths = self.u[None] - self.u[:, None], np.linalg.norm(self.xi, axis=2)
        longer = (eta * self.xi).sum(2)
        if not self.by_energy:
            return longer > self.critical * lengths**2
        stretch = (self.critical * self.longest / np.maximum(lengths, 1e-9))[..., None]
        even = (self.dim * self.lame + 2 * self.shear - self.pull)[:, None] * np.eye(self.dim)
        limit = self.lost(stretch * self.xi, stretch[..., None] * even)
        states = (self.first[:, None, None] * self.states())[:, None]
        return (longer > 0) & (self.lost(eta, np.broadcast_to(states, limit.shape + states.shape[2:])) > limit)

    def step(self, count=1, load=0.0):
        for _ in range(count):
            broken = self.beyond() & (self.w > 0)
            self.w = np.where(broken, 0.0, self.w)
            if broken.any() and not self.frozen:
                self._invert(self.w)
            p = self.states()
            a = np.einsum("ij,ijab,ijb->ia", self.w, p[:, None] + p[None], self.xi)
            a += np.einsum("ij,ija->ia", self.w * (self.pull[:, 0] + self.pull[:, 0].T), self.u[None] - self.u[:, None])
            a[:, 0] += load
            a /= self.density
            if not self.steps:
                self.v = (self.v - self.dt / 2 * a) * self.inside[:, None]
            if self.drag:
                bonds = self.w > 0
                number = bonds.sum(1)[:, None]
                mean = np.where(number, bonds @ self.v / np.maximum(number, 1), self.v)
                self.v = self.v + self.drag * self.dt * (mean - self.v)
            self.v = (self.v + self.dt * a) * self.inside[:, None]
            self.u = self.u + self.dt * self.v
            self.steps += 1

    def field(self, values):
        return np.moveaxis(values[self.inside].reshape(*self.shape, -1), range(self.dim), range(1, self.dim + 1))

    def start(self, u, v=None):
        for state, values in ((self.u, u), (self.v, v)):
            if values is not None:
                state[self.inside] = np.moveaxis(values, 0, -1).reshape(-1, self.dim)


def noise(shape, size, seed=1):
    return np.random.default_rng(seed).standard_normal((len(shape), *shape)) * size
