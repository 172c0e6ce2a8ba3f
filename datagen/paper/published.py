"""What the paper and its authors' notebook state: Scholes & Leach, Sensors 24(20), 6522 (2024)."""

from __future__ import annotations

PEAKS_NS = {"walls, floor, ceiling": 25.6, "box": 24.9, "pillar": 35.3}
"""Where Fig. 7 has its peaks, since the light reached the laser point."""
PEAK_TOLERANCE_NS = 0.3

SIGMA_PS = 250.0
"""Sec. 4; the notebook has 600 ps FWHM, σ = 254.8 ps."""

SECONDS = {
    (10, "all"): "≈ 1 hour (paper, sec. 4)",
    (10, "strongest"): "< 30 s (paper, sec. 4)",
    (45, "all"): "3 h 34 min 16 s (notebook)",
    (45, "strongest"): "2 min 00 s (notebook)",
}
"""Rays a side and secondary scheme → computation time, on the authors' GPU server."""
