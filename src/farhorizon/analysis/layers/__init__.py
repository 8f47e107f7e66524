"""What absorbing layers send back, and how thick they must be."""
