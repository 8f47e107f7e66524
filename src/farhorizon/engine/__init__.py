"""The compiled loops, and the one place that knows Numba: plain arrays in, plain arrays out."""
