"""The paper's figures from one command, as printed and with correct radiometry, and what of the paper holds."""

from datagen.report.reproduce.command import reproduce

__all__ = ["reproduce"]
