"""What a measurement says of the places that light may have come from: grids of voxels, and backprojection."""
