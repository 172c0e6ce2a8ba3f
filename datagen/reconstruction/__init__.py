"""Reconstruction of the hidden part from a measurement: backprojection and f-k migration on grids of voxels."""
