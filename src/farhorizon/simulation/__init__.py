"""A set-up that runs."""
