"""Gradients of what receivers record, and inversions that use them: the adjoint of a run is another run."""
