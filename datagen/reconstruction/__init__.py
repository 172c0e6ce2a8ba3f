"""Reconstruction of the hidden part from a measurement: backprojection on a grid of voxels."""
