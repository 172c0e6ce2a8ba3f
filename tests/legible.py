"""Whether the letters of a picture can be read where pages of text show it."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.text import Text

PAGE_PX = 830
"""Width of a picture in README where it is on GitHub; wider ones are made smaller."""
LEAST_PX = 11.0
"""Size of letters, from the lowest to the highest, which people read without an effort."""


def too_small(figure: Figure) -> list[str]:
    """Texts of a figure whose letters are below `LEAST_PX` on a page. Exponents, which belong to a number, are not
    looked at."""
    px_per_pt = PAGE_PX / (72 * figure.get_figwidth())
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return sorted({text.get_text() for text in texts if text.get_fontsize() * px_per_pt < LEAST_PX})
