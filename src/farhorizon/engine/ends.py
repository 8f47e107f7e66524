"""The exact ends of a bar in the compiled loop: what the half-infinite chains beyond do to the nodes next to them, the
drivers.

An end is a sum of exponentials (states of which each step costs the same) or a convolution in blocks (the past of
earlier blocks is known, the block's own samples act here). See `farhorizon.analysis.exact.chain` for the kernels.
"""

from farhorizon.engine.rows.compiled import njit

_ANY_ORDER = {"reassoc", "contract", "nsz"}  # sums may be taken in vectors


@njit(error_model="numpy", fastmath=_ANY_ORDER, cache=True)
def force_of_states(end, outputs, states, forces):
    """Force of one end, four drivers at a time."""
    for i in range(0, forces.shape[1], 4):
        f0, f1, f2, f3 = 0.0, 0.0, 0.0, 0.0
        for p in range(states.shape[1]):
            y = states[end, p]
            f0 += outputs[end, i, p] * y
            f1 += outputs[end, i + 1, p] * y
            f2 += outputs[end, i + 2, p] * y
            f3 += outputs[end, i + 3, p] * y
        forces[end, i], forces[end, i + 1], forces[end, i + 2], forces[end, i + 3] = f0, f1, f2, f3


@njit(error_model="numpy", fastmath=_ANY_ORDER, cache=True)
def advance_states(end, poles, inputs, sample, states):
    """``y <- z (y + c . u)`` for one end, four drivers at a time."""
    for m in range(0, sample.size, 4):
        u0, u1, u2, u3 = sample[m], sample[m + 1], sample[m + 2], sample[m + 3]
        for p in range(states.shape[1]):
            near = u0 * inputs[end, m, p] + u1 * inputs[end, m + 1, p]
            states[end, p] += near + (u2 * inputs[end, m + 2, p] + u3 * inputs[end, m + 3, p])
    count = poles.shape[2]
    real, imaginary = states[end, :count], states[end, count:]
    for p in range(count):
        a, b, x, y = poles[end, 0, p], poles[end, 1, p], real[p], imaginary[p]
        real[p] = a * x - b * y
        imaginary[p] = a * y + b * x


@njit(error_model="numpy", cache=True)
def convolve(step, heads, past, history, force):
    """Add the share of earlier blocks, and that of this block's own samples."""
    reach, place = past.shape[1], step % heads.shape[0]
    for i in range(reach):
        force[i] += past[place, i]
    for lag in range(1, place + 1):
        sample, head = history[step - lag], heads[lag]
        for i in range(reach):
            total = 0.0
            for m in range(reach):
                total += head[i, m] * sample[m]
            force[i] += total


@njit(error_model="numpy", cache=True)
def exact_ends(
    src,
    base,
    out,
    scale,
    increments,
    clock,
    first,
    nodes,
    poles,
    inputs,
    outputs,
    states,
    sample,
    forces,
    heads,
    past,
    history,
):
    """Add to one step, from the state `src`, the forces of all chains beyond.

    K4 is K rounded up to whole fours; what is beyond K there is zero.

    Parameters
    ----------
    src, base, out : ndarray
        Levels of the stage.
    scale : float
        Factor of the operator in this stage.
    increments : bool
    clock : ndarray of int, shape (1,)
        Number of the step; counted on.
    first : float
        Weight of the sample at step 0.
    nodes : ndarray of int, shape (ends, K)
        Drivers, from each end inwards.
    poles : ndarray, shape (ends, 2, P)
        Real and imaginary parts.
    inputs, outputs : ndarray, shape (ends, K4, 2 P)
        Real parts, then imaginary ones, of c_p, and of b_p with the sign of the latter turned, so that the force is a
        product with the states.
    states : ndarray, shape (ends, 2 P)
    sample : ndarray, shape (K4,)
        Work space.
    forces : ndarray, shape (ends, K4)
        Written: accelerations of the drivers.
    heads, past : ndarray, shapes (ends, B, K, K), (ends, B, K)
        Of convolutions in blocks of B steps; B = 0 without.
    history : ndarray, shape (ends, steps, K)
        Written: the drivers' values, at step 0 times `first`.
    """
    step = clock[0]
    clock[0] = step + 1
    share = first if step == 0 else 1.0
    reach = nodes.shape[1]
    for end in range(nodes.shape[0]):
        for m in range(reach):
            sample[m] = share * src[nodes[end, m]]
            history[end, step, m] = sample[m]
        force_of_states(end, outputs, states, forces)
        advance_states(end, poles, inputs, sample, states)
        if heads.shape[1]:
            convolve(step, heads[end], past[end], history[end], forces[end])
        for m in range(reach):
            node, gain = nodes[end, m], scale * forces[end, m]
            if increments:
                base[node] += gain
                out[node] = src[node] + base[node]
            else:
                out[node] += gain
