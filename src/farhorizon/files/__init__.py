"""What lies on disk, and knows no physics: results, checkpoints, the cache; written so that nothing is lost."""
