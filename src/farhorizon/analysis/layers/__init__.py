"""What absorbing layers reflect, and how thick they must be."""
