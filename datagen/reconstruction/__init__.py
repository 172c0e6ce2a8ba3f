"""What a measurement says of the places that light may have come from: grids of voxels, and backprojection."""

from pathlib import Path

from datagen.compiled import drop_stale_kernels

drop_stale_kernels(Path(__file__).parent)
