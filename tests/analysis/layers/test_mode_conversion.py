"""Mode conversion at a wall, against packets that are reflected by the end of a long chain and against the equations of
a half-space with a free surface.
"""

from itertools import product

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.half_space import HalfSpace
from farhorizon.analysis.layers.mode_conversion import conversion
from farhorizon.medium.free_side import FreeSide

SCALAR = fh.Wave(fh.Kernel(3.0, 0)).stencil(1.0, 2)
SOLID = fh.Elastic(fh.Kernel(2.0, 1), young=1.0).stencil(1.0, 2)
ANGLES = (np.arange(32) + 0.5) * np.pi / 32  # at which amplitudes are known
NODES, WIDTH, START = 1500, 50.0, 450.0  # of a chain, and of a packet on it


def chain(stencil, along, free):
    """Matrix of a chain of rows with a wall at its first one, for waves with a wavenumber along the wall."""
    matrix = np.zeros((NODES, NODES), complex)
    rows = np.arange(NODES)
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        to = rows + offset[0]
        inside = (to >= 0) & (to < NODES)
        bonded = rows[inside | (to >= NODES)] if free else rows
        matrix[bonded, bonded] += weight
        matrix[rows[inside], to[inside]] -= weight * np.exp(1j * along * offset[1])
    return matrix.real


def turned(stencil, normal, along, free):
    """Amplitude of the backward waves that a wall makes of a wave: by the energies of a packet's parts after it has
    been reflected, since the energy that a part carries is that of its square times its group velocity.
    """
    squared, modes = np.linalg.eigh(chain(stencil, along, free))
    nodes = np.arange(NODES)

    def pace(angle):  # along the normal, per unit of time
        step = 1e-5
        ahead, behind = (np.sqrt(stencil.symbol(a, along)) for a in (angle + step, angle - step))
        return float((ahead - behind) / (2 * step))

    coming = normal if pace(normal) < 0 else -normal
    packet = np.exp(-(((nodes - START) / WIDTH) ** 2) / 2 + 1j * coming * nodes)
    time = (START + 5 * WIDTH) / abs(pace(normal))
    after = modes @ (np.exp(-1j * np.sqrt(np.maximum(squared, 0)) * time) * (modes.T @ packet))
    power = np.abs(np.fft.fft(after, 8 * NODES)) ** 2
    power /= power.sum()
    found, angles = 0.0, 2 * np.pi * np.fft.fftfreq(8 * NODES)
    line = np.linspace(-np.pi, np.pi, 20001)
    level = stencil.symbol(line, along) - stencil.symbol(normal, along)
    for angle in line[:-1][level[:-1] * level[1:] < 0]:
        slope = stencil.symbol(angle, along + 1e-5) - stencil.symbol(angle, along - 1e-5)
        if pace(angle) > 0 and np.sin(along) * slope < 0:
            share = power[np.abs(np.angle(np.exp(1j * (angles - angle)))) < 4 / WIDTH].sum()
            found += np.sqrt(share * abs(pace(normal) / pace(angle)))
    return found


@pytest.mark.parametrize("i, j", [(2, 12), (4, 12), (4, 15)])
def test_packets_at_the_end_of_a_chain(i, j):
    """Fixed and free walls, of which the one counts that converts more."""
    exact = max(turned(SCALAR, ANGLES[i], ANGLES[j], free) for free in (False, True))
    assert conversion(SCALAR).amplitudes[i, j, 0] == pytest.approx(exact, rel=0.01)
    assert exact > 0.5


def test_the_equations_of_a_half_space():
    """P and S waves below a free surface, by the equations from which incident waves are made; a fixed wall may convert
    more.
    """
    amplitudes, half_space, found = conversion(SOLID).amplitudes, HalfSpace(FreeSide(SOLID, 0, -1)), []
    for i, j, branch in product(range(6, 32, 8), range(6, 32, 8), range(2)):
        normal, along = ANGLES[i], ANGLES[j]
        squared, shapes = np.linalg.eigh(SOLID.symbol(normal, along))
        rise = np.linalg.eigvalsh(SOLID.symbol(normal + 1e-4, along))[branch] - squared[branch]
        if abs(rise) < 1e-5:
            continue
        coming, vector = (normal, shapes[:, branch]) if rise < 0 else (-normal, shapes[:, branch] * [-1, 1])
        column = half_space.total(squared[branch], np.array([along]), np.exp(-1j * coming), vector)
        backward = 0.0
        for factor, mode in zip(column.factors[:-1], column.vectors[:-1], strict=True):
            if abs(abs(factor) - 1) < 1e-6:
                around = (SOLID.symbol(np.angle(factor), along + step) for step in (1e-4, -1e-4))
                change = np.subtract(*around)
                if (mode.conj() @ change @ mode).real * np.sin(along) < -1e-9 * np.linalg.norm(mode) ** 2:
                    backward += np.abs(mode).max()
        found.append((backward, amplitudes[i, j, branch]))
    free, table = np.transpose(found)
    assert (free < 1.001 * table + 1e-4).all()
    assert (abs(free - table) < 1e-3 * table).sum() > 5 and (table > 0.1).sum() > 5


def test_nearest_neighbours_convert_nothing():
    assert not conversion(fh.Wave(fh.Stencil.finite_difference(2)).stencil(1.0, 2)).amplitudes.any()


def test_outermost_bonds_that_act_along_one_axis_only():
    """Their blocks are singular, so that a chain has fewer modes; weak ones must not change the result."""
    kernel = fh.Kernel(2.0, 3, "gaussian", volume="full")
    stencil = fh.Elastic(kernel, young=1.0).stencil(1.0, 2)
    near = np.abs(stencil.offsets).max(1) == 1
    nearest = fh.Stencil(stencil.offsets[near], stencil.weights[near])
    assert stencil.reach == (2, 2) and np.abs(stencil.weights[~near]).max() < 1e-3
    apart = np.abs(conversion(stencil).amplitudes - conversion(nearest).amplitudes)
    assert (apart > 1e-3).mean() < 0.01 and conversion(stencil).amplitudes.mean() > 0.1


def packet_of(i, j):
    """A wide packet and its envelope."""
    x, y = np.ix_(*[np.arange(128) - 64.0] * 2)
    envelope = np.exp(-(x**2 + y**2) / 12.0**2)
    return envelope * np.cos(ANGLES[i] * x + ANGLES[j] * y), envelope


def test_what_is_made_of_a_field():
    """A packet has the amplitude of its waves, and its energy; long waves are not converted. A field that hardly varies
    along the third axis is converted as in the plane.
    """
    turns, (packet, long) = conversion(SCALAR), packet_of(4, 12)
    amplitude, root = turns.turned(packet)
    assert amplitude == pytest.approx(turns.amplitudes[3:6, 11:14, 0].mean(), rel=0.3)
    assert root == pytest.approx(amplitude * np.sqrt((packet**2).sum()), rel=0.3)
    assert max(turns.turned(long)) < 1e-9 * amplitude
    assert turns.turned(packet + 4 * long) == pytest.approx((amplitude / 5, root / 5), rel=0.01)
    depth = np.exp(-((np.arange(32) - 15.5) ** 2) / 8.0**2)
    assert turns.turned(packet[..., None] * depth) == pytest.approx(
        (amplitude, root * np.sqrt((depth**2).sum())), rel=0.02
    )


def test_types_of_waves_are_converted_by_their_own_amplitudes():
    """Short P waves are backward ones, S waves of the same wavenumber turn into none; each component of a packet
    contains both.
    """
    turns, packet = conversion(SOLID), packet_of(26, 4)[0]
    slow, fast = turns.amplitudes[26, 4]
    shapes = np.abs(np.linalg.eigh(SOLID.symbol(ANGLES[26], ANGLES[4]))[1])
    assert slow == 0 and fast > 0.9 and shapes[0, 1] > 0.9
    assert turns.turned(packet, 0)[0] == pytest.approx(shapes[0, 1] * fast, rel=0.2)
    assert turns.turned(packet, 1)[0] == pytest.approx(shapes[1, 1] * fast, rel=0.2)
