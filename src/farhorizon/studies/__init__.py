"""Studies of several runs: comparison with the infinite medium, variation of options, horizons."""
