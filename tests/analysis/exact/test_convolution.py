"""Online convolution against direct summation."""

import numpy as np
import pytest

from farhorizon import InputError
from farhorizon.analysis.exact.convolution import BlockConvolution


def feed(convolution, samples, start=0):
    """Results at all steps, with the products within a block added as a caller adds them."""
    out = np.zeros((len(samples), convolution.kernel.shape[1]))
    for n in range(start, len(samples)):
        at = n % convolution.block
        if at == 0 and n > 0:
            convolution.next_block()
        convolution.samples[at] = samples[n]
        own = sum((convolution.head[a] @ convolution.samples[at - a] for a in range(1, at + 1)), np.zeros(out.shape[1]))
        out[n] = convolution.past[at] + own
    return out


@pytest.mark.parametrize("block", [1, 4, 5, 64, None])
@pytest.mark.parametrize("steps", [3, 63, 64, 65, 200])
def test_every_pair_of_steps_is_met_once(block, steps):
    """The samples are integers, so that the sums are exact up to the rounding of the FFT."""
    rng = np.random.default_rng(1)
    kernel, samples = (
        rng.integers(-3, 4, (steps + 1, 2, 3)).astype(float),
        rng.integers(-3, 4, (steps + 1, 3)).astype(float),
    )
    expected = [sum((kernel[a] @ samples[n - a] for a in range(1, n + 1)), np.zeros(2)) for n in range(steps + 1)]
    np.testing.assert_allclose(feed(BlockConvolution(kernel, block), samples), expected, atol=1e-10)


def test_a_longer_kernel_takes_over():
    """Extended in the middle of a block, the convolution continues as if it had had the long kernel from the start."""
    rng = np.random.default_rng(2)
    kernel, samples = rng.standard_normal((101, 2, 2)), rng.standard_normal((101, 2))
    whole = feed(BlockConvolution(kernel, 8), samples)
    short = BlockConvolution(kernel[:44], 8)
    feed(short, samples[:43])
    longer = short.extended(kernel)
    np.testing.assert_allclose(feed(longer, samples, start=43)[43:], whole[43:], atol=1e-12)


def test_bad_input():
    with pytest.raises(InputError, match="shape"):
        BlockConvolution(np.zeros((5, 2)))
    convolution = BlockConvolution(np.zeros((5, 1, 1)), 5)
    with pytest.raises(InputError, match="outlives"):
        convolution.next_block()
