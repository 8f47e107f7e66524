"""What a user specifies, checked, and the near field that it describes."""
