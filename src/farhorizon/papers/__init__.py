"""Published tables and figures recomputed: one module per paper, with each result next to the printed one."""
