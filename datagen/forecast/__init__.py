"""Forecasts of the time, size and error of a build, from pilot scenes."""
