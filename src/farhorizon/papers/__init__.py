"""Published tables and figures, computed anew: one module a paper, each result beside the printed one."""
