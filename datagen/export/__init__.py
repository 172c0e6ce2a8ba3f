"""A dataset's scenes in the formats of other programs."""

from datagen.export.export import export

__all__ = ["export"]
