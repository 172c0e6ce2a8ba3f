"""The secondary as a convolution in time: light that arrives at a hidden vertex with light that leaves it."""
