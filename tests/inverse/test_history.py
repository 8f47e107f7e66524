"""Histories that are kept as a whole, and those that are computed again."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.inverse.schedule import pieces_backward, repeats


def fewest(count, room):
    """Least number of pieces that are made in all, by trying all places of the next state."""
    known = {}

    def work(count, room):
        if count == 1:
            return 1
        if room == 1:
            return count * (count + 1) // 2
        if (count, room) not in known:
            ahead = range(1, count)
            known[count, room] = min(m + work(count - m, room - 1) + work(m, room) for m in ahead)
        return known[count, room]

    return work(count, room)


@pytest.mark.parametrize("room", [1, 2, 3, 5])
def test_every_piece_is_made_from_a_state_that_is_kept(room):
    for count in (1, 2, 3, 7, 20, 56):
        kept, made = set(), []
        for piece, start, keep in pieces_backward(count, room):
            kept = {one for one in kept if one <= piece}
            if not kept:
                kept = {0}
            made.append(piece)
            kept |= {start, *keep}
            assert len(kept) <= room and start <= piece and all(start < one <= piece for one in keep)
        assert made == list(range(count))[::-1]


@pytest.mark.parametrize("room", [1, 2, 3, 5])
def test_as_few_pieces_are_made_as_possible(room):
    """Beside the first run, which keeps states on its way."""
    for count in (1, 2, 3, 7, 20, 56):
        ahead = count - 1 if room > 1 else 0
        assert repeats(count, room) <= fewest(count, room) + ahead, count


def plate(model, **options):
    lattice = fh.Lattice(1.0, (-10.0, -9.0), (10.0, 9.0))
    pulse = fh.PointSource((-3.0, 2.0), time=fh.Ricker(0.08))
    return fh.Setup(lattice, model, fh.LatticePML(nodes=8), sources=[pulse], **options)


@pytest.mark.parametrize("kind", ["wave", "diffusion", "damped"])
def test_the_gradient_is_the_same_however_the_history_is_kept(kind):
    """To the last bit: states are restored exactly."""
    kernel = fh.Kernel(2.0)
    model, name = (fh.Diffusion(kernel), "diffusivity") if kind == "diffusion" else (fh.Wave(kernel), "speed")
    if kind == "damped":
        model = fh.Wave(kernel, damping=0.02)
    setup = plate(model)
    dt = fh.Simulation.of(setup).dt
    misfit = fh.LeastSquares(fh.Receivers([(4.0, -3.0), (0.0, 5.0)]), np.full((151, 2), 0.01))
    options = {"wrt": [name, "source"], "until": 150 * dt}
    whole = fh.gradient(setup, misfit, **options)
    for memory in (1.2e5, 2e5, 3e5):  # bytes; the history takes 4e5, a state 9e4
        pieces = fh.gradient(setup, misfit, **options, memory=memory)
        assert pieces.misfit == whole.misfit
        np.testing.assert_allclose(pieces[name], whole[name], rtol=1e-12, atol=1e-14 * np.abs(whole[name]).max())
        np.testing.assert_array_equal(pieces["source"], whole["source"])
    short = fh.gradient(setup, misfit, **options, precision="float32")
    np.testing.assert_allclose(short[name], whole[name], atol=1e-6 * np.abs(whole[name]).max())


def test_too_little_memory_is_refused():
    misfit = fh.LeastSquares(fh.Receivers([(4.0, -3.0)]), np.zeros((11, 1)))
    with pytest.raises(fh.InputError, match="does not fit") as told:
        fh.gradient(plate(fh.Wave(fh.Kernel(2.0)), dt=0.4), misfit, "speed", 4.0, memory=1000.0)
    assert told.value.key == "memory" and "float32" in str(told.value)
    bar = fh.Setup(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(2.0)), fh.Exact(), {"u": "exp(-x**2)"}, dt=0.4)
    bare = fh.LeastSquares(fh.Receivers([3.0]), np.zeros((11, 1)))
    with pytest.raises(fh.InputError, match="exact ends"):
        fh.gradient(bar, bare, "speed", 4.0, memory=1000.0)
