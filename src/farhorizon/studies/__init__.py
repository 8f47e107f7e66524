"""Several runs side by side: against the infinite medium, over options, over horizons."""
