"""What follows from the symbol: modes of the near field, their stability, and how far away a domain may end."""
