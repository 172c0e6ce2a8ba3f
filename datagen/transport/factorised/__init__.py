"""The secondary as a convolution in time of what arrives at a lookin and what leaves it."""
