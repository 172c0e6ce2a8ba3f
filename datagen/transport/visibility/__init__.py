"""What is visible from where: rays, the BVH, and proofs that nothing stands between."""
