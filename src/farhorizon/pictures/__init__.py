"""Pictures and films of arrays and results files."""
