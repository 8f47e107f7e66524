"""Solutions in the infinite medium, for comparison."""
