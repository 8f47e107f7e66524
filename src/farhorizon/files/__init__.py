"""Files independent of the physics: results, checkpoints, the cache; written so that nothing is lost."""
