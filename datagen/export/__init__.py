"""A dataset's scenes in the formats of other programs, and measurements of theirs as a dataset."""

from datagen.export.export import FORMATS, export

__all__ = ["FORMATS", "export"]
