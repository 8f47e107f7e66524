"""The operator and its time step: kernel, stencil, integrators, what it takes to part it."""
