"""Solutions in the infinite medium, to compare with."""
