"""BRDFs for the transport kernels, one model in each file; every model has `evaluate`, `at_most`, `pdf`, `sample` and
`widen` for compiled loops, and a row in the table of `table.py`.

The materials of a scene become one table (`MaterialTable`) with a kind and a row of numbers for each part. Directions
are unit vectors that point away from the surface, and `n` is the unit normal on the side of the incoming light.
Surfaces do not transmit: a direction below the surface gets no light.
"""

from datagen.transport.brdf.albedo import albedo
from datagen.transport.brdf.directions import Vector, cosine_directions, dot, in_frame_of, sample_cosine
from datagen.transport.brdf.models import evaluate, evaluate_at_most, pdf, sample, widen
from datagen.transport.brdf.table import LAMBERTIAN, MODELS, MaterialTable, lobe_width, model_of

__all__ = [
    "LAMBERTIAN",
    "MODELS",
    "MaterialTable",
    "Vector",
    "albedo",
    "cosine_directions",
    "dot",
    "evaluate",
    "evaluate_at_most",
    "in_frame_of",
    "lobe_width",
    "model_of",
    "pdf",
    "sample",
    "sample_cosine",
    "widen",
]
