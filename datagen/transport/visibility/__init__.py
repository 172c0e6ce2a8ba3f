"""Proofs that nothing stands between two points, so that no shadow ray need be sent."""
