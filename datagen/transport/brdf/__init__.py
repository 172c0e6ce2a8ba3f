"""BRDFs, each with evaluate, sample and pdf, compiled for the transport kernels: one model to a file.

A scene's materials become one table (`MaterialTable`): a kind and a row of numbers for each part. Directions are unit
vectors that point away from the surface; `n` is the unit normal on the side of the incoming light; a direction below
the surface receives nothing (no transmission).
"""

from datagen.transport.brdf.albedo import albedo
from datagen.transport.brdf.directions import Vector, cosine_directions, dot, in_frame_of, sample_cosine
from datagen.transport.brdf.models import evaluate, evaluate_at_most, pdf, sample
from datagen.transport.brdf.table import (
    GGX_LOBE,
    LAMBERTIAN,
    OREN_NAYAR,
    PHONG,
    RETROREFLECTOR,
    SIN_LOBE,
    Materials,
    MaterialTable,
)

__all__ = [
    "GGX_LOBE",
    "LAMBERTIAN",
    "OREN_NAYAR",
    "PHONG",
    "RETROREFLECTOR",
    "SIN_LOBE",
    "MaterialTable",
    "Materials",
    "Vector",
    "albedo",
    "cosine_directions",
    "dot",
    "evaluate",
    "evaluate_at_most",
    "in_frame_of",
    "pdf",
    "sample",
    "sample_cosine",
]
