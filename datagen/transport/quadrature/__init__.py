"""Quadrature over surface elements: light of three and four bounces without noise."""
