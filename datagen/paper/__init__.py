"""The paper the model starts from: its estimators, as printed and radiometric, its figures, and what of it holds."""

from datagen.paper.radiometric import secondary

__all__ = ["secondary"]
