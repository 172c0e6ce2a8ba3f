"""Builds: one job a shard, run by any number of processes, resumed where they stopped."""
