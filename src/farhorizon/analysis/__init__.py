"""What the symbol tells: the near field's modes, their stability, how far away an end must be."""
