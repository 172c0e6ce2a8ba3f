"""Surfaces cut into cells as fine as a laser point and a pixel need: light of three bounces without noise."""
