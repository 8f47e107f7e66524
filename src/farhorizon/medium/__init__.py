"""The operator of a medium: kernels, stencils, force states, materials, fracture energies and time integrators."""
